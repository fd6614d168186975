"""One table of gap discovery for panels of three shapes, on worlds that are drawn from a secret and answered once.

`--panel FILE.npz` (of `gap-truth`; the public panel by default) has the true grasps and the bank, `--results
FOLDER/x.jsonl` keeps every answer with its key, and goes on from there; beside it are the secret and `table.json`.
Names and alarms are those of the wide bank: nothing is simulated. `--worlds` of a shape, `--n` rehearsed ones.
"""

import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fast.flows.challenge.grade import CLOSABLE, NAMEABLE, clopper_pearson
from fast.flows.challenge.hidden.bound import Bound
from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from fast.flows.challenge.hidden.worlds import Group, WorldKey, Worlds
from fast.models.gap.evidence.rehearsal import Rehearsal
from fast.models.gap.evidence.worlds import NOTHING
from fast.models.gap.findings import UNKNOWN
from fast.models.records import Record
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.answers import Answer, answer, measure_twin
from tests.studies.gap.development import interleave, rehearse_worlds
from tests.studies.gap.judgement import Judged
from tests.studies.gap.oracle import AtBest, measure_at_best
from tests.studies.gap.truth import results_folder

SHAPES = ((7, 5), (8, 6), (12, 10))  # designs and objects of a world; no more than the panel has
SHARES: Mapping[Group, float] = {"null": 0.33, "single": 0.33, "unlisted": 0.2, "pair": 0.14}
N_WORLDS, N_ROUNDS = 100, 2
_ORACLES = ("null", "single", "unlisted")  # worlds that are told apart by an oracle
_BINS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of stated probabilities
_FEWEST = 10  # answers in a bin, and worlds of a size, that are compared
_SIZES = (0.0, 0.01, 0.02, 0.04, 0.1, 1.0)
_POINTS = 0.15  # by which rehearsed and true power may differ


class ShapeOutcome(Record):
    """The answer to a world of a shape (designs, objects), with its key.

    bound: with what probability the likelihood ratio sees that something is hidden. seen_size: from which on the
    rehearsal says that nine in ten are seen. rehearsed: shares of alarms of rehearsed causes of `_SIZES`; None of few.
    at_best: what an oracle names; None for two causes, and without the truth in the catalogue.
    """

    shape: tuple[int, int]
    key: WorldKey
    answer: Answer
    left_out: bool = False
    twin_n: float | None = None
    bound: float = 0.0
    seen_size: float | None = None
    rehearsed: tuple[float | None, ...] = ()
    at_best: AtBest | None = None

    @property
    def judged(self) -> Judged:
        """The answer, to be judged."""
        return Judged(self.key, self.answer, self.left_out, self.twin_n)

    @property
    def visible(self) -> float:
        """Visible size without the cell that changes most, of the least of what is hidden."""
        return min((hidden.spread_strength for hidden in self.key.effects), default=0.0)

    @property
    def is_alarm(self) -> bool:
        """Whether anything is said to be missing."""
        return self.answer.is_alarm

    @property
    def closed(self) -> float | None:
        """Share that was closed of what can be; None where nothing can."""
        closing, twin_n = self.answer.closing, self.twin_n
        if closing is None or twin_n is None or closing.before_n - twin_n < CLOSABLE * closing.before_n:
            return None
        return (closing.before_n - closing.after_n) / (closing.before_n - twin_n)


def measure_gap_shapes(options: Options) -> Tables:
    """The sealed table of gap discovery for panels of 7 x 5, 8 x 6 and 12 x 10, each figure with interval and bound."""
    folder = results_folder(options)
    folder.mkdir(parents=True, exist_ok=True)
    panels, bank = read_small(options.panel or PANEL)
    seed = _keep_secret(folder / "secret.txt")
    known = {_place(one): one for one in read_records(options.results, ShapeOutcome, "answer to a world of a shape")}
    n = options.worlds or N_WORLDS
    found: list[ShapeOutcome] = []
    with RecordFile(options.results) as file:
        for shape in SHAPES:
            size = min(shape[0], len(panels.designs)), min(shape[1], len(panels.objects))
            worlds = Worlds(panels, bank, f"{seed} {size}", has_other_laws=True, n_designs=size[0], n_objects=size[1])
            rehearsal: Rehearsal | None = None
            bound = Bound.of(worlds)
            counts: dict[Group, int] = {group: round(n * share) for group, share in SHARES.items()}
            for group, number, is_left_out in interleave(counts, None):
                place = (size, group, number, is_left_out)
                if place not in known:
                    rehearsal = rehearsal or rehearse_worlds(worlds, options)
                    known[place] = _answer(worlds, rehearsal, bound, place)
                    file.append(known[place])
                    options.tell(f"{size[0]} x {size[1]}: {group} {number}, {known[place].answer.rounds[0].kind}")
                if known[place].at_best is None and group in _ORACLES and not is_left_out:
                    known[place] = _ask_oracle(bound, known[place])
                    file.append(known[place])
                found.append(known[place])
    tables = make_tables(found)
    (folder / "table.json").write_text(json.dumps({"worlds": n, "rows": tables["figures"]}, indent=1) + "\n")
    return tables


def _keep_secret(path: Path) -> str:
    """The secret of a study's folder, drawn when it begins."""
    if not path.exists():
        path.write_text(secrets.token_hex(16) + "\n")
    return path.read_text().strip()


def _place(one: ShapeOutcome) -> tuple[tuple[int, int], Group, int, bool]:
    return one.shape, one.key.group, one.key.number, one.left_out


def _answer(
    worlds: Worlds, rehearsal: Rehearsal, bound: Bound, place: tuple[tuple[int, int], Group, int, bool]
) -> ShapeOutcome:
    shape, group, number, is_left_out = place
    key = worlds.draw(group, number)
    problem = worlds.problem(key)
    without, n_rounds = (key.names, 1) if is_left_out else ((), N_ROUNDS)
    needs_twin = group == "single" and not is_left_out
    return ShapeOutcome(
        shape=shape,
        key=key,
        answer=answer(problem, rehearsal, without=without, max_rounds=n_rounds),
        left_out=is_left_out,
        twin_n=measure_twin(worlds.problem(worlds.twin(key)), rehearsal) if needs_twin else None,
        bound=round(bound.measure_power(key, problem.grasps), 4),
        seen_size=rehearsal.find_seen_size(),
        rehearsed=_list_rehearsed(rehearsal),
    )


def _ask_oracle(bound: Bound, known: ShapeOutcome) -> ShapeOutcome:
    grasps = bound.worlds.problem(known.key).grasps
    return known.model_copy(update={"at_best": measure_at_best(bound, known.key, grasps, SHARES)})


def _list_rehearsed(rehearsal: Rehearsal) -> tuple[float | None, ...]:
    hidden = [one for one in rehearsal.worlds if one.group != NOTHING]
    alarms = [(one.size, rehearsal.is_alarm(one.signs)) for one in hidden]
    return tuple(_share(alarms, low, high) for low, high in zip(_SIZES, _SIZES[1:], strict=False))


def _share(alarms: Sequence[tuple[float, bool]], low: float, high: float) -> float | None:
    """Share of alarms from one size to another; None of few."""
    own = [is_alarm for size, is_alarm in alarms if low <= size < high]
    return float(np.mean(own)) if len(own) >= _FEWEST else None


def make_tables(outcomes: Sequence[ShapeOutcome]) -> Tables:
    """All figures of every shape; and one row a figure with the shapes beside each other."""
    shapes = list(dict.fromkeys(one.shape for one in outcomes))
    figures = [
        {"shape": f"{shape[0]} x {shape[1]}"} | row
        for shape in shapes
        for row in _list_figures([one for one in outcomes if one.shape == shape])
    ]
    names = list(dict.fromkeys(row["figure"] for row in figures))
    beside: Rows = []
    for name in names:
        own = [row for row in figures if row["figure"] == name]
        beside.append({"figure": name} | {row["shape"]: _tell(row) for row in own} | {"asked": own[0]["asked"]})
    return {"table": beside, "figures": figures}


def _list_figures(outcomes: Sequence[ShapeOutcome]) -> Rows:
    def of(*groups: Group, left_out: bool = False, least: float = 0.0) -> list[ShapeOutcome]:
        return [
            one for one in outcomes if one.key.group in groups and one.left_out is left_out and one.visible >= least
        ]

    hidden = of("single", "unlisted", "pair", least=0.1)
    alarmed = [one for one in of("single", least=NAMEABLE) if one.is_alarm]
    unlisted = [one for one in of("unlisted", least=NAMEABLE) if one.is_alarm]
    left_out = [one for one in of("single", left_out=True, least=NAMEABLE) if one.is_alarm]
    rows = [_count("false alarms", of("null"), _is_alarm, "2 %")]
    listed = of("single", least=0.02)
    rows.append(_count("alarm, catalogued, visible 2 %", listed, _is_alarm, "96 %", bound=_see_at_best))
    for least, asked in ((0.02, "95 %"), (0.04, "98 %"), (0.1, "100 %")):
        of_none = of("unlisted", least=least)
        both = [*of_none, *of("single", left_out=True, least=least)]
        for words, own in (("alarm, in no catalogue, visible", of_none), ("the same with left-out effects,", both)):
            rows.append(_count(f"{words} {least:.0%}", own, _is_alarm, asked, bound=_see_at_best))
    missed = _count("“none” said at 10 % or more", hidden, lambda one: not one.is_alarm, "0")
    rows.append(missed | ({"bound": round(1.0 - _see_at_best(hidden), 3)} if hidden else {}))
    rows.append(_count("family right, given an alarm", alarmed, _is_family_right, "92 %", bound=_name_at_best))
    rows.append(_count("wrong family, in no catalogue", unlisted, _is_wrong, "8 %", bound=_err_at_best))
    rows.append(_count("wrong family, left out of the catalogue", left_out, _is_wrong, "8 %"))
    rows.append(_count("two effects, both families", of("pair", least=NAMEABLE), _has_both, "75 %"))
    rows.append(_count("truth still possible, catalogued", alarmed, _is_possible, "90 %"))
    rows.append(_count("truth still possible, others", [*unlisted, *left_out], _is_possible, "90 %"))
    misses = [(one.answer.rounds[0].probability - one.judged.is_right) ** 2 for one in outcomes]
    brier = [one.at_best.brier for one in outcomes if one.at_best is not None]
    rows.append(
        _summarise("Brier score", misses, np.mean, "0.10")
        | ({"bound": round(float(np.mean(brier)), 3)} if brier else {})
    )
    rows.append(_summarise("largest difference of stated and true probability", *_compare_bins(outcomes), "0.07"))
    size = outcomes[0].seen_size
    large = (
        [] if size is None else [one for one in of("single", "unlisted") if one.key.effects[0].visible_strength >= size]
    )
    rows.append(_count("what could still hide: larger ones that are seen", large, _is_alarm, "90 %"))
    rows.append({"figure": "the size that was stated, %", "worlds": len(large), "asked": ""})
    rows[-1]["value"] = None if size is None else round(100.0 * size, 2)
    rows.append(_compare_power(of("single", "unlisted"), outcomes[0].rehearsed))
    closed = [one.closed for one in of("single", least=NAMEABLE) if one.closed is not None]
    rows.append(_summarise("gap closed of what can be closed, median", closed, np.median, "85 %"))
    rows.append(_summarise("gap closed, worst quarter", closed, lambda values: np.quantile(values, 0.25), "50 %"))
    rows.append(_summarise("CPU seconds a world", [one.answer.cpu_s for one in outcomes], np.mean, "0.3"))
    return rows


def _is_alarm(one: ShapeOutcome) -> bool:
    return one.is_alarm


def _is_family_right(one: ShapeOutcome) -> bool:
    first = one.answer.rounds[0]
    return bool(first.effects) and one.judged.is_family_right(first.effects[0])


def _is_wrong(one: ShapeOutcome) -> bool:
    return bool(one.answer.rounds[0].effects) and not _is_family_right(one)


def _has_both(one: ShapeOutcome) -> bool:
    return one.judged.families <= {CATALOGUE[name].family for said in one.answer.rounds for name in said.effects}


def _is_possible(one: ShapeOutcome) -> bool:
    possible = one.answer.rounds[0].possible
    is_open = one.left_out or not one.judged.families
    return any(one.judged.is_family_right(name) for name in possible) or (is_open and UNKNOWN in possible)


def _compare_bins(outcomes: Sequence[ShapeOutcome]) -> tuple[list[float], Callable[[Any], Any]]:
    """Differences of stated and true probability of bins with enough answers, and their largest."""
    stated = np.array([one.answer.rounds[0].probability for one in outcomes])
    right = np.array([one.judged.is_right for one in outcomes], dtype=float)
    bins = np.clip(np.digitize(stated, _BINS) - 1, 0, len(_BINS) - 2)
    kept = [bins == one for one in np.unique(bins) if (bins == one).sum() >= _FEWEST]
    return [abs(float(stated[own].mean() - right[own].mean())) for own in kept], np.max


def _compare_power(outcomes: Sequence[ShapeOutcome], rehearsed: Sequence[float | None]) -> dict[str, object]:
    """Of how many sizes rehearsed and true shares of alarms are alike."""
    alarms = [(one.key.effects[0].visible_strength, one.is_alarm) for one in outcomes]
    pairs = [
        (share, true)
        for share, low, high in zip(rehearsed, _SIZES, _SIZES[1:], strict=False)
        if share is not None and (true := _share(alarms, low, high)) is not None
    ]
    k = sum(abs(share - true) <= _POINTS for share, true in pairs)
    return _row("sizes at which rehearsed and true power are within 15 points", k, len(pairs), "9 in 10")


def _count(
    figure: str,
    worlds: Sequence[ShapeOutcome],
    counts: Callable[[ShapeOutcome], bool],
    asked: str,
    *,
    bound: Callable[[Sequence[ShapeOutcome]], float | None] | None = None,
) -> dict[str, object]:
    """A share of worlds. bound: what nobody can beat; None: not known."""
    row = _row(figure, sum(map(counts, worlds)), len(worlds), asked)
    best = bound(worlds) if bound is not None and worlds else None
    return row if best is None else row | {"bound": round(best, 3)}


def _see_at_best(worlds: Sequence[ShapeOutcome]) -> float:
    """Share of these worlds in which the likelihood ratio sees something."""
    return float(np.mean([one.bound for one in worlds]))


def _ask_of_oracle(worlds: Sequence[ShapeOutcome], name: str) -> float | None:
    """The mean of what the oracle reaches in these worlds, a field of `AtBest`; None of none that it was asked of."""
    known = [getattr(one.at_best, name) for one in worlds if one.at_best is not None]
    return float(np.mean(known)) if known else None


def _name_at_best(worlds: Sequence[ShapeOutcome]) -> float | None:
    return _ask_of_oracle(worlds, "names")


def _err_at_best(worlds: Sequence[ShapeOutcome]) -> float | None:
    return _ask_of_oracle(worlds, "is_wrong")


def _row(figure: str, k: int, n: int, asked: str) -> dict[str, object]:
    row: dict[str, object] = {"figure": figure, "worlds": n, "asked": asked, "value": None}
    if n:
        low, high = clopper_pearson(k, n)
        row |= {"seen": k, "value": round(k / n, 3), "low95": round(low, 3), "high95": round(high, 3)}
    return row


def _summarise(figure: str, values: Sequence[float], of: Callable[[Any], Any], asked: str) -> dict[str, object]:
    row: dict[str, object] = {"figure": figure, "worlds": len(values), "asked": asked, "value": None}
    if len(values):
        row["value"] = round(float(of(np.array(values))), 3)
    return row


def _tell(row: Mapping[str, object]) -> str:
    if row["value"] is None:
        return "-"
    if "seen" not in row:
        bound = f", bound {row['bound']:.3f}" if "bound" in row else ""
        return f"{row['value']} ({row['worlds']}){bound}"
    bound = f", bound {row['bound']:.0%}" if "bound" in row else ""
    return f"{row['seen']} of {row['worlds']} [{row['low95']:.0%}, {row['high95']:.0%}]{bound}"
