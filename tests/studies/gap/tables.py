"""Figures of gap discovery from answers to worlds of known truth, each with its number of worlds and an interval."""

from collections.abc import Callable, Sequence

import numpy as np

from fast.flows.challenge.grade import clopper_pearson
from fast.models.gap.findings import UNKNOWN
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.benchmarks.base import Rows, Tables
from tests.studies.gap.judgement import Judged

_SURE = 0.9
_BINS = (0.0, 0.5, 0.7, 0.9, 1.0)  # of stated probabilities
_LEVELS = (0.01, 0.02, 0.04, 0.1)  # of visible strength


def gap_tables(worlds: Sequence[Judged]) -> Tables:
    """Tables of figures, of every effect, of stated probabilities, and of the gap closed."""
    return {
        "figures": _figures(worlds),
        "by effect": _by_effect(worlds),
        "stated probability": _reliability(worlds),
        "gap closed": _closed(worlds),
    }


def _figures(worlds: Sequence[Judged]) -> Rows:
    own = [one for one in worlds if not one.left_out]
    singles = [one for one in own if one.key.group == "single"]
    visible = [one for one in singles if one.is_visible]
    alarmed = [one for one in visible if one.said.is_alarm]
    spoken = [one for one in alarmed if _kind(one) in ("effect", "set")]
    named = [one for one in alarmed if _kind(one) == "effect"]
    removed = [one for one in worlds if one.left_out and one.is_visible and one.said.is_alarm]
    unlisted = [one for one in own if one.key.group == "unlisted" and one.is_visible and one.said.is_alarm]
    open_worlds = [one for one in worlds if one.left_out or one.key.group == "unlisted"]
    hidden = [one for one in worlds if one.key.group in ("single", "unlisted")]
    aliases = [one for one in own if one.key.group == "alias"]
    pairs = [one for one in own if one.key.group == "pair" and one.is_visible]
    sure = [one for one in worlds if one.said.rounds[0].probability >= _SURE]
    right_alone = [one for one in named if _is_held(one)]
    rows = [
        _row("false alarms, null worlds", _of(own, "null"), lambda one: one.said.is_alarm, "<= 2.5 %"),
        _row("false alarms, nastier nuisance", _of(own, "nasty null"), lambda one: one.said.is_alarm, "<= 10 %"),
        *(
            _row(f"alarm, visible {low:.0%} or more", _above(singles, low), lambda one: one.said.is_alarm, ">= 90 %")
            for low in _LEVELS
        ),
        *(
            _row(
                f"alarm, {low:.0%} or more without the strongest cell",
                _spread_above(singles, low),
                lambda one: one.said.is_alarm,
                "",
            )
            for low in _LEVELS
        ),
        *(
            _row(f"alarm, cause in no catalogue, {low:.0%} or more", _spread_above(open_worlds, low), _is_alarm, "")
            for low in _LEVELS
        ),
        _row("none said at 10 % or more, all kinds", _spread_above(hidden, 0.1), lambda one: not _is_alarm(one), "0"),
        _row("family right first, given an alarm", alarmed, _is_top_family, ">= 90 %"),
        _row("member right, given a single name", named, _is_held, ">= 90 %"),
        _row("truth in the name or set, given one", spoken, _is_held, ">= 95 %"),
        _row("unknown though in the catalogue", alarmed, _is_unknown, ""),
        _row("truth not in the catalogue: unknown, or its family", [*removed, *unlisted], _is_open_right, ">= 80 %"),
        _row("wrong family, same worlds", [*removed, *unlisted], _is_forced, "<= 10 %"),
        _row("truth in the conformal set, in the catalogue", alarmed, _is_possible, ">= 90 %"),
        _row("truth in the conformal set, not in the catalogue", [*removed, *unlisted], _is_possible, ">= 90 %"),
        _row("aliases of theta not named", aliases, lambda one: _kind(one) in ("none", "unknown"), "100 %"),
        _row("unknown in a round after a right name", right_alone, _says_unknown_later, "<= 10 %"),
        _row("two effects, both families", pairs, _has_both, ">= 80 %"),
        _row("two effects, at least one", pairs, _has_one, ""),
        _row("stated probability of 0.9 or more is right", sure, lambda one: one.is_right, ">= 90 %"),
    ]
    sizes = [len(one.said.rounds[0].effects) for one in spoken]
    misses = [(one.said.rounds[0].probability - one.is_right) ** 2 for one in worlds]
    rows.append({"figure": "mean size of name or set", "worlds": len(sizes), "value": _mean(sizes), "target": "<= 2"})
    rows.append({"figure": "Brier score", "worlds": len(misses), "value": _mean(misses), "target": "<= 0.12"})
    possible = [_count_possible(one) for one in [*alarmed, *removed, *unlisted]]
    figure = "mean size of conformal set, families or unknown"
    rows.append({"figure": figure, "worlds": len(possible), "value": _mean(possible), "target": "<= 2"})
    seconds = [one.said.cpu_s for one in own]
    rows.append({"figure": "CPU seconds a world", "worlds": len(seconds), "value": _mean(seconds), "target": ""})
    return rows


def _row(figure: str, worlds: Sequence[Judged], counts: Callable[[Judged], bool], target: str) -> dict[str, object]:
    k, n = sum(counts(one) for one in worlds), len(worlds)
    row: dict[str, object] = {"figure": figure, "worlds": n, "target": target}
    if n:
        low, high = clopper_pearson(k, n)
        row |= {"seen": k, "value": k / n, "low95": round(low, 3), "high95": round(high, 3)}
    return row


def _of(worlds: Sequence[Judged], group: str) -> list[Judged]:
    return [one for one in worlds if one.key.group == group]


def _above(worlds: Sequence[Judged], strength: float) -> list[Judged]:
    return [one for one in worlds if one.key.effects[0].visible_strength >= strength]


def _spread_above(worlds: Sequence[Judged], strength: float) -> list[Judged]:
    return [one for one in worlds if one.key.effects[0].spread_strength >= strength]


def _is_alarm(one: Judged) -> bool:
    return one.said.is_alarm


def _kind(one: Judged) -> str:
    return one.said.rounds[0].kind


def _is_top_family(one: Judged) -> bool:
    """The first of a name or set is of a hidden family."""
    first = one.said.rounds[0]
    return bool(first.effects) and one.is_family_right(first.effects[0])


def _is_held(one: Judged) -> bool:
    return bool(set(one.said.rounds[0].effects) & set(one.key.names))


def _is_unknown(one: Judged) -> bool:
    return _kind(one) == "unknown"


def _is_open_right(one: Judged) -> bool:
    return _is_unknown(one) or _is_top_family(one)


def _is_forced(one: Judged) -> bool:
    return not _is_open_right(one)


def _is_possible(one: Judged) -> bool:
    """Whether the conformal set holds a hidden family, or *unknown* where there is none in the catalogue."""
    possible = one.said.rounds[0].possible
    is_open = one.left_out or not one.families
    return any(one.is_family_right(name) for name in possible) or (is_open and UNKNOWN in possible)


def _count_possible(one: Judged) -> int:
    return len({CATALOGUE[name].family if name in CATALOGUE else name for name in one.said.rounds[0].possible})


def _says_unknown_later(one: Judged) -> bool:
    return any(said.kind == "unknown" for said in one.said.rounds[1:])


def _heard(one: Judged) -> set[str]:
    """Families that were said in any round."""
    return {CATALOGUE[name].family for said in one.said.rounds for name in said.effects}


def _has_both(one: Judged) -> bool:
    return one.families <= _heard(one)


def _has_one(one: Judged) -> bool:
    return bool(one.families & _heard(one))


def _by_effect(worlds: Sequence[Judged]) -> Rows:
    """Every hidden effect: how visible it was, and what was said."""
    rows: Rows = []
    for one in worlds:
        if one.key.group in ("single", "unlisted", "alias"):
            hidden, first = one.key.effects[0], one.said.rounds[0]
            rows.append(
                {
                    "effect": hidden.effect,
                    "in_catalogue": not one.left_out,
                    "raw_percent": round(100.0 * hidden.raw_strength, 1),
                    "visible_percent": round(100.0 * hidden.visible_strength, 1),
                    "said": first.kind,
                    "effects": "+".join(first.effects),
                    "probability": round(first.probability, 2),
                    "right": one.is_right,
                }
            )
    return sorted(rows, key=lambda row: (row["effect"], row["in_catalogue"], row["raw_percent"]))


def _reliability(worlds: Sequence[Judged]) -> Rows:
    """How often answers of a stated probability are right."""
    rows: Rows = []
    for low, high in zip(_BINS, _BINS[1:], strict=False):
        found = [one for one in worlds if low <= one.said.rounds[0].probability < high + (high == 1.0)]
        if found:
            stated = _mean([one.said.rounds[0].probability for one in found])
            rows.append({"from": low, "to": high, "answers": len(found), "stated": stated})
            rows[-1]["right"] = _mean([float(one.is_right) for one in found])
    return rows


def _closed(worlds: Sequence[Judged]) -> Rows:
    """Held-out errors of visible worlds with one effect, by whether the name was right; N, medians.

    closed: (before - after) / (before - twin), the twin being the same world without the effect.
    """
    rows: Rows = []
    for label, is_right in (("right name", True), ("other answers", False)):
        found = [
            (one.said.closing, one.twin_n)
            for one in _of(worlds, "single")
            if one.said.closing is not None and one.twin_n is not None and one.is_visible
            if any(_family_named(one)) is is_right
        ]
        if not found:
            continue
        shares = [(c.before_n - c.after_n) / max(c.before_n - twin_n, 0.02 * c.before_n) for c, twin_n in found]
        rows.append(
            {
                "worlds": label,
                "n": len(found),
                "before_n": _median([c.before_n for c, _ in found]),
                "after_n": _median([c.after_n for c, _ in found]),
                "twin_n": _median([twin_n for _, twin_n in found]),
                "closed": _median(shares),
                "closed_worst_quarter": round(float(np.quantile(shares, 0.25)), 3),
                "least": round(min(shares), 3),
            }
        )
    return rows


def _family_named(one: Judged) -> list[bool]:
    return [one.is_family_right(name) for name in one.said.named]


def _mean(values: Sequence[float]) -> float | None:
    return round(float(np.mean(values)), 3) if values else None


def _median(values: Sequence[float]) -> float | None:
    return round(float(np.median(values)), 3) if values else None
