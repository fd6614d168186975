"""Asking on made-up worlds: promised against spent grasps, chosen against random, and what nobody knows stays unknown.

`--results FILE` seals: worlds are drawn from a secret, a hash of every key is written before any world is asked, the
answers with their hashes after that, and only then the keys are read. Without it the worlds are of a public seed, for
development. The bench answers through `Bench` alone; whoever asks never sees its key.
"""

import hashlib
import secrets
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import get_args

import numpy as np

from fast.flows.challenge.keys import hash_key
from fast.flows.gap.search import MOST_ASKED
from fast.models.errors import UsageError
from fast.models.gap.ask.answers import believe, merge_forms
from fast.models.gap.ask.choose import ENOUGH_NATS, choose_experiments
from fast.models.gap.ask.forecast import weigh
from fast.models.gap.ask.hypotheses import Hypothesis, list_hypotheses
from fast.models.gap.ask.predict import Pair, forecast_pairs
from fast.models.gap.ask.settings import list_settings
from fast.models.gap.data import GapData
from fast.models.gap.findings import NONE, UNKNOWN
from fast.models.gap.naming.name import name_effect
from fast.models.records import Record
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.tasks.gap.ask import estimate_costs
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.ask_worlds import AskKey, Bench, Kind, Size, draw_key
from tests.synthetic.rehearsal import USUAL

N_MEMBERS, N_OTHERS = 40, 12  # of each size: worlds that hide a member, and of each other kind
CELLS = tuple((tool, obj) for tool in (0, 2, 4) for obj in (0, 2, 4))
MOST_PAIRS = 24
_PUBLIC = "development"


class Asking(Record):
    """What came of asking one world. `before`, `says`: the answer before and after; empty where it cannot tell.

    possible: effects that the search left; left: those that are still alike. promised, spent: grasps of the first
    request, and of all. at_random: grasps at random settings until an answer; `says_at_random`: which. minutes: of
    bench time.
    """

    world: str
    before: str
    possible: tuple[str, ...]
    left: tuple[str, ...] = ()
    promised: int = 0
    spent: int = 0
    minutes: float = 0.0
    says: str = ""
    at_random: int = 0
    says_at_random: str = ""

    @property
    def answer_hash(self) -> str:
        """SHA-256 of all that was said."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


class SealedAsking(Record):
    """What came of asking a sealed world, with the hash that was written with it."""

    asking: Asking
    answer_hash: str


class SealedAskKey(Record):
    """The key of a world, with the salt of its hash."""

    world: str
    salt: str
    key: AskKey


class SealedWorld(Record):
    """What anybody may see of a world before it is judged."""

    world: str
    key_hash: str


def measure_asking(options: Options) -> Tables:
    """How many grasps an answer takes, as promised, chosen and at random; what stays unknown, and what nobody hid."""
    n_members = N_MEMBERS if options.worlds is None else options.worlds
    n_others = -(-n_members * N_OTHERS // N_MEMBERS)
    sizes: tuple[Size, ...] = ("small", "large")
    of_each: tuple[tuple[Kind, int], ...] = (("member", n_members), ("unknown", n_others), ("nothing", n_others))
    drawn = [(kind, size, number) for size in sizes for kind, n in of_each for number in range(n)]
    if options.results is None:
        keys = [draw_key(_PUBLIC, *one) for one in drawn]
        judged = [(key, ask_world(str(place), Bench.of(key))) for place, key in enumerate(keys)]
    else:
        judged = _ask_sealed(options.results, drawn, options)
    rows = [_report(key, asking) for key, asking in judged]
    return {
        "asking": [_summarise(size, [row for row in rows if row["size"] == size]) for size in sizes],
        "worlds": rows,
    }


def ask_world(name: str, bench: Bench) -> Asking:
    """Search a world, ask its bench in whole requests as a campaign does, and once more at random settings."""
    naming = name_effect(bench.data, USUAL, catalogue=bench.catalogue)
    before = naming.named.effects[0] if naming.named.kind == "effect" else _PLAIN.get(naming.named.kind, "")
    hypotheses = list_hypotheses(naming)
    effects = tuple(dict.fromkeys(one.name for one in hypotheses if one.own))
    asked = _Questioner(bench.data, hypotheses).ask(bench) if hypotheses else _Asked()
    if not asked.spent:
        return Asking(world=name, before=before, possible=effects, left=naming.named.effects, says=before)
    at_random, says_at_random = _Questioner(bench.data, hypotheses).ask_at_random(bench)
    return Asking(
        world=name,
        before=before,
        possible=effects,
        left=asked.left,
        promised=2 * asked.promised,
        spent=2 * asked.spent,
        minutes=round(asked.minutes, 2),
        says=asked.says,
        at_random=2 * at_random,
        says_at_random=says_at_random,
    )


_PLAIN = {"none": NONE, "unknown": UNKNOWN}


@dataclass
class _Asked:
    """Pairs of the first request and of all, minutes of the bench, the answer, and the effects that it leaves alike."""

    promised: int = 0
    spent: int = 0
    minutes: float = 0.0
    says: str = ""
    left: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Questioner:
    """Asks a bench what would tell the hypotheses of a search apart; only timings."""

    data: GapData
    hypotheses: tuple[Hypothesis, ...]

    @cached_property
    def pairs(self) -> list[Pair]:
        """Pairs that could be made."""
        timings = [one for one in list_settings(self.data.grasps.base_setup) if one.is_timing]
        return [Pair(*cell, one) for cell in CELLS for one in timings]

    def ask(self, bench: Bench) -> _Asked:
        """Whole requests, one after the other, until the hypotheses are told apart or nothing is worth asking."""
        forecast = forecast_pairs(self.hypotheses, self.pairs)
        costs = estimate_costs(self.data.grasps, self.pairs)
        made: Counter[Pair] = Counter()
        now, asked = self.hypotheses, _Asked()
        while not asked.says and asked.spent < MOST_PAIRS:
            probability = np.array([one.probability for one in now])
            most = min(MOST_ASKED // 2, MOST_PAIRS - asked.spent)
            choice = choose_experiments(replace(forecast, probability=probability), costs, most)
            if not choice.n:
                break
            asked.promised = asked.promised or choice.n
            asked.spent += choice.n
            asked.minutes += choice.minutes
            made.update({self.pairs[place]: int(choice.counts[place]) for place in np.flatnonzero(choice.counts)})
            now = believe(self.hypotheses, bench.answer(made).weigh(self.hypotheses))
            asked.left = list_alike(now)
            asked.says = say(now)
        return asked

    def ask_at_random(self, bench: Bench) -> tuple[int, str]:
        """Pairs at random settings until the answer is given, looked at after each, and the answer."""
        rng = np.random.default_rng(7)
        order = [self.pairs[int(place)] for place in rng.integers(len(self.pairs), size=MOST_PAIRS)]
        counts = Counter(order)
        outcomes, pairs = bench.answer(counts).experiments, list(counts)
        forecast = forecast_pairs(self.hypotheses, pairs)
        for n in range(1, MOST_PAIRS + 1):
            seen = [outcomes[pair][: order[:n].count(pair)] for pair in pairs]
            says = say(believe(self.hypotheses, weigh(forecast, seen)))
            if says:
                return n, says
        return MOST_PAIRS, ""


def say(believed: Sequence[Hypothesis]) -> str:
    """The one answer that is left by the rules of `models.gap.ask.settle`; empty where effects are still alike."""
    chance = merge_forms(believed)
    effects = [name for name in chance if name not in (NONE, UNKNOWN)]
    if chance.get(NONE, 0.0) > 0.5:
        return NONE
    if not effects or chance.get(UNKNOWN, 0.0) > sum(chance[name] for name in effects):
        return UNKNOWN
    alike = list_alike(believed)
    return alike[0] if len(alike) == 1 else ""


def list_alike(believed: Sequence[Hypothesis]) -> tuple[str, ...]:
    """The effects that are still alike, the most probable first."""
    chance = merge_forms(believed)
    effects = sorted((name for name in chance if name not in (NONE, UNKNOWN)), key=lambda name: -chance[name])
    return tuple(name for name in effects if chance[name] > chance[effects[0]] * np.exp(-ENOUGH_NATS))


def _ask_sealed(path: Path, numbers: Sequence[tuple[Kind, Size, int]], options: Options) -> list[tuple[AskKey, Asking]]:
    """Seal worlds if there are none, ask each once, and open the keys when every answer is in the file.

    Raises:
        UsageError: a key or an answer was changed after its hash was written.
    """
    keys_path, answers_path = (path.with_name(f"{path.stem}-{what}.jsonl") for what in ("keys", "answers"))
    if not path.exists():
        _seal(path, keys_path, numbers)
    keys = {one.world: one for one in read_records(keys_path, SealedAskKey, "key of a sealed world")}
    known = {one.asking.world for one in read_records(answers_path, SealedAsking, "answer to a sealed world")}
    worlds = list(read_records(path, SealedWorld, "sealed world"))
    with RecordFile(answers_path) as file:
        for one in worlds:
            if one.world not in known:
                asking = ask_world(one.world, Bench.of(keys[one.world].key))
                file.append(SealedAsking(asking=asking, answer_hash=asking.answer_hash))
                options.tell(f"{one.world}: {asking.spent} grasps, {asking.says or 'no answer'}")
    answers = {one.asking.world: one for one in read_records(answers_path, SealedAsking, "answer to a sealed world")}
    for one in worlds:
        key, said = keys[one.world], answers[one.world]
        if hash_key(key.salt, key.key) != one.key_hash or said.asking.answer_hash != said.answer_hash:
            raise UsageError(f"the key of {one.world}, or the answer to it, does not fit its hash; this run is void.")
    return [(keys[one.world].key, answers[one.world].asking) for one in worlds]


def _seal(path: Path, keys_path: Path, numbers: Sequence[tuple[Kind, Size, int]]) -> None:
    """Draw worlds from a secret in an order that tells nothing, and write keys and their hashes."""
    secret = secrets.token_hex(16)
    order = np.random.default_rng(secrets.randbits(64)).permutation(len(numbers))
    with RecordFile(keys_path) as hidden, RecordFile(path) as public:
        for place, at in enumerate(order):
            key = SealedAskKey(
                world=f"world-{place:03d}", salt=secrets.token_hex(16), key=draw_key(secret, *numbers[int(at)])
            )
            hidden.append(key)
            public.append(SealedWorld(world=key.world, key_hash=hash_key(key.salt, key.key)))


def _report(key: AskKey, asking: Asking) -> dict[str, object]:
    """A row of the table of worlds."""
    names = [asking.says] if asking.says else list(asking.left)
    families = {CATALOGUE[name].family for name in names if name in CATALOGUE}
    return {
        "kind": key.kind,
        "size": key.size,
        "law": key.law,
        "amplitude": key.amplitude,
        **asking.model_dump(exclude={"world"}),
        "is_possible": key.law in asking.possible,
        "is_right": asking.says == key.answer,
        "is_in_set": not asking.says and key.law in asking.left,
        "is_of_family": key.kind == "member" and families == {CATALOGUE[key.law].family},
        "is_wrong": asking.says not in ("", NONE, UNKNOWN, key.answer),
    }


def _summarise(size: Size, rows: Rows) -> dict[str, object]:
    """Counts and medians (none of nothing) of the worlds of a size; asked: of which a grasp was made."""
    members, unknown, nothing = ([row for row in rows if row["kind"] == kind] for kind in get_args(Kind))
    asked = [row for row in members if row["spent"]]
    answered = [row for row in asked if row["says"]]
    spent, promised, random = (
        np.array([row[name] for row in asked], dtype=float) for name in ("spent", "promised", "at_random")
    )
    is_answered = np.array([bool(row["says"]) for row in asked], dtype=bool)
    return {
        "size": size,
        "members": len(members),
        "right_of_all": _count(members, "is_right"),
        "wrong_of_all": _count(members, "is_wrong"),
        "family_of_all": _count(members, "is_of_family"),
        "asked": len(asked),
        "right": _count(asked, "is_right"),
        "in_set": _count(asked, "is_in_set"),
        "of_family": _count(asked, "is_of_family"),
        "wrong": _count(asked, "is_wrong"),
        "wrong_by_law": dict(Counter(str(row["law"]) for row in asked if row["is_wrong"])),
        "median_spent_grasps": _median(spent),
        "median_promised_grasps": _median(promised),
        "answered_within_1.5_of_promised": int((is_answered & (spent <= 1.5 * promised)).sum()),
        "median_minutes_per_answer": _median([float(row["minutes"]) for row in answered]),
        "right_at_random": sum(row["says_at_random"] == row["law"] for row in asked),
        "wrong_at_random": sum(bool(row["says_at_random"]) and row["says_at_random"] != row["law"] for row in asked),
        "chosen_over_random": float(spent.sum() / random.sum()) if len(random) else None,
        "unknown_truths": len(unknown),
        "unknown_named": _count(unknown, "is_wrong"),
        "unknown_said": _count(unknown, "is_right"),
        "nothing": len(nothing),
        "nothing_named": _count(nothing, "is_wrong"),
        "nothing_grasps": sum(int(str(row["spent"])) for row in nothing),
    }


def _count(rows: Rows, name: str) -> int:
    return sum(bool(row[name]) for row in rows)


def _median(values: Sequence[float] | np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
