"""Few cases that hold every pair of levels of every two factors: a covering array of strength two, found greedily."""

import random
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

Level = tuple[str, str]  # (factor, level)
Pair = frozenset[Level]
Case = dict[str, str]  # level by factor
N_TRIED = 60  # candidates for each case, of which the one with most new pairs is taken


def all_pairs(factors: Mapping[str, Sequence[str]]) -> set[Pair]:
    """Every pair of levels of two different factors."""
    return {
        frozenset(((first, one), (second, other)))
        for first, second in combinations(factors, 2)
        for one in factors[first]
        for other in factors[second]
    }


def pairs_of(case: Case) -> set[Pair]:
    """The pairs that a case holds."""
    return {frozenset(pair) for pair in combinations(case.items(), 2)}


def cover_pairs(factors: Mapping[str, Sequence[str]], refused: set[Pair], seed: int = 0) -> list[Case]:
    """Cases that hold every pair which is not refused, and none that is; the same ones for the same seed.

    Each case begins with a pair that is still missing. The other factors, in a random order, take the level that brings
    most new pairs. Of `N_TRIED` such cases the best is kept.

    Raises:
        ValueError: a pair is in no case, since what stands beside it is refused with one of its levels.
    """
    drawn = random.Random(seed)
    missing = all_pairs(factors) - refused
    cases: list[Case] = []
    while missing:
        tried = [case for case in _try_cases(factors, refused, missing, drawn) if case]
        if not tried:
            raise ValueError(f"no case holds {[sorted(pair) for pair in missing]}")
        best = max(tried, key=lambda case: len(pairs_of(case) & missing))
        cases.append({factor: best[factor] for factor in factors})
        missing -= pairs_of(best)
    return cases


def _try_cases(
    factors: Mapping[str, Sequence[str]], refused: set[Pair], missing: set[Pair], drawn: random.Random
) -> Iterator[Case]:
    begun = sorted(missing, key=sorted)
    for _ in range(N_TRIED):
        case = dict(drawn.choice(begun))
        others = [factor for factor in factors if factor not in case]
        drawn.shuffle(others)
        for factor in others:
            found = _choose(factor, factors[factor], case, refused, missing, drawn)
            if found is None:
                break
            case[factor] = found
        else:
            yield case


def _choose(
    factor: str, levels: Sequence[str], case: Case, refused: set[Pair], missing: set[Pair], drawn: random.Random
) -> str | None:
    """The level that brings most new pairs, by lot among equals; None where all are refused with what is there."""
    new = {level: {frozenset(((factor, level), other)) for other in case.items()} for level in levels}
    allowed = [level for level in levels if not new[level] & refused]
    if not allowed:
        return None
    drawn.shuffle(allowed)
    return max(allowed, key=lambda level: len(new[level] & missing))
