"""The figures of gap discovery on worlds of known truth: probabilities fitted on some worlds, then others.

Stages, each in the results file: `calibration` worlds set the probabilities and are never counted; `development`
worlds come from a public seed, `independent` ones from another solver (`tests.studies.gap.independent`).
"""

import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from fast.models.design.space import numbered_design
from fast.models.gap.bank.bank import Bank
from fast.models.gap.grasps import Cells
from fast.models.records import GraspSetup, Record
from fast.models.simulation.version import SimulatorVersion
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.answers import Answer, answer, measure_twin, naming_code, thresholds_id
from tests.studies.gap.judgement import Judged, fit_probabilities
from tests.studies.gap.panels import Panels
from tests.studies.gap.tables import gap_tables
from tests.studies.gap.truth import Panel, results_folder
from tests.studies.gap.worlds import Group, WorldKey, Worlds

if TYPE_CHECKING:
    from fast.models.gap.naming.thresholds import Thresholds

N_CALIBRATION: dict[Group, int] = {"null": 24, "single": 48, "unlisted": 12, "pair": 12}
N_WORLDS: dict[Group, int] = {"null": 40, "nasty null": 12, "single": 48, "alias": 6, "unlisted": 12, "pair": 20}
PUBLIC_SEED = 8
Stage = Literal["calibration", "development", "independent"]


class GapOutcome(Record):
    """A world, what it hides, and the answer.

    `left_out`: the truth was taken out of the catalogue. `twin_n`: held-out error of the same world without its effect.
    """

    stage: Stage
    key: WorldKey
    answer: Answer
    left_out: bool = False
    twin_n: float | None = None

    @property
    def place(self) -> tuple[str, str, int, bool]:
        """What tells outcomes apart."""
        return self.stage, self.key.group, self.key.number, self.left_out


def measure_gap(options: Options) -> Tables:
    """False alarms, names, sets, unknowns and closed gaps of gap discovery, over development worlds of known truth."""
    folder = results_folder(options)
    panels, bank = open_panels(folder)
    outcomes = read_outcomes(options.results)
    thresholds = calibrated(Worlds(panels, bank, "calibration"), outcomes, options)
    (folder / "thresholds.json").write_text(json.dumps(thresholds_content(thresholds), indent=1) + "\n")
    return measure_worlds(Worlds(panels, bank, PUBLIC_SEED), "development", N_WORLDS, thresholds, options)


def measure_worlds(
    worlds: Worlds, stage: Stage, wanted: Mapping[Group, int], thresholds: "Thresholds", options: Options
) -> Tables:
    """Answer so many worlds of each group, those with one effect also without it in the catalogue, and count."""
    outcomes = read_outcomes(options.results)
    end = time.monotonic() + 60.0 * options.limit_minutes
    with RecordFile(options.results) as file:
        for group, number, is_left_out in _interleaved(wanted, options.worlds):
            place = (stage, group, number, is_left_out)
            known = outcomes.get(place)
            if known is not None and is_current(known.answer, thresholds):
                continue
            if time.monotonic() > end:
                break
            key = worlds.draw(group, number)
            said = answer(worlds.problem(key), thresholds, without=key.names if is_left_out else ())
            twin_n = None if is_left_out else measure_twin(worlds.problem(worlds.twin(key)), thresholds)
            outcomes[place] = GapOutcome(stage=stage, key=key, answer=said, left_out=is_left_out, twin_n=twin_n)
            file.append(outcomes[place])
            options.tell(_line(outcomes[place]))
    shown = [o for o in outcomes.values() if o.stage == stage and is_current(o.answer, thresholds)]
    return gap_tables([Judged(o.key, o.answer, o.left_out, o.twin_n) for o in shown])


def open_panels(folder: Path) -> tuple[Panels, Bank]:
    """True grasps, and the bank of the simulator's grasps of the same designs and objects."""
    from fast.lake.store import Lake
    from fast.tasks.gap.bank import read_bank

    panel = Panel.read(folder)
    panels = Panels.read(folder / "truth.jsonl", panel)
    own = [numbered_design(number) for number in panel.designs]
    bank = read_bank(Lake(str(folder / "lake")), SimulatorVersion(), Cells.full(own, panel.objects, GraspSetup()))
    return panels, with_known_fields(bank)


def with_known_fields(bank: Bank) -> Bank:
    """The bank without the effects that were not simulated in nine cells of ten: they cannot be named."""
    known = {
        name: field for name, field in bank.effects.items() if np.isfinite(field.steps_n).all(axis=(2, 3)).mean() > 0.9
    }
    changes = {name: getattr(bank, name) for name in Bank.__dataclass_fields__}
    return Bank(**{**changes, "effects": known})


def read_outcomes(path: Path | None) -> dict[tuple[str, str, int, bool], GapOutcome]:
    """Outcomes of a results file by place, the last of each."""
    return {found.place: found for found in read_records(path, GapOutcome, "answer to a world of a hidden effect")}


def is_current(said: Answer, thresholds: "Thresholds") -> bool:
    """Whether the present code gave the answer, with these lines."""
    return said.code == naming_code() and said.thresholds == thresholds_id(thresholds)


def calibrated(
    worlds: Worlds, outcomes: dict[tuple[str, str, int, bool], GapOutcome], options: Options
) -> "Thresholds":
    """Probabilities fitted on worlds none of which is counted later: closed and open ones."""
    from fast.models.gap.naming.thresholds import Thresholds

    provisional, made = Thresholds(), []
    with RecordFile(options.results) as file:
        for group, number, is_left_out in _interleaved(N_CALIBRATION, options.worlds):
            place = ("calibration", group, number, is_left_out)
            if place not in outcomes or outcomes[place].answer.code != naming_code():
                key = worlds.draw(group, number)
                without = key.names if is_left_out else ()
                said = answer(worlds.problem(key), provisional, without=without, max_rounds=1)
                outcomes[place] = GapOutcome(stage="calibration", key=key, answer=said, left_out=is_left_out)
                file.append(outcomes[place])
                options.tell(_line(outcomes[place]))
            made.append(outcomes[place])
    return fit_probabilities([Judged(one.key, one.answer, one.left_out) for one in made], provisional)


def thresholds_content(thresholds: "Thresholds") -> dict[str, object]:
    """Lines with the id of the code that they hold for."""
    return {"code": naming_code(), "lines": thresholds.model_dump(mode="json")}


def _interleaved(wanted: Mapping[Group, int], n_worlds: int | None) -> Iterator[tuple[Group, int, bool]]:
    """World after world, a bit of every group first: a run that is stopped has seen all of them.

    Worlds with one effect come twice, the second time with the effect taken out of the catalogue.
    """
    counts = {group: n if n_worlds is None else min(n, n_worlds) for group, n in wanted.items()}
    rounds = max(counts.values())
    for turn in range(rounds):
        for group, n in counts.items():
            for number in range(-(-turn * n // rounds), -(-(turn + 1) * n // rounds)):
                for is_left_out in (False, True) if group == "single" else (False,):
                    yield group, number, is_left_out


def _line(outcome: GapOutcome) -> str:
    hidden = ", ".join(f"{h.effect} {100 * h.visible_strength:.1f} %" for h in outcome.key.effects) or "nothing"
    said = "; ".join(f"{said.kind} {'+'.join(said.effects)}" for said in outcome.answer.rounds)
    left_out = " (not in the catalogue)" if outcome.left_out else ""
    return f"{outcome.key.group} {outcome.key.number}: {hidden}{left_out} -> {said}, {outcome.answer.cpu_s:.1f} s"
