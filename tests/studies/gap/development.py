"""The figures of gap discovery on worlds of known truth: lines fitted on null worlds, then worlds that hide effects.

Three stages, each in the results file: `calibration` worlds set the lines and the temperature and are never counted;
`development` worlds come from a public seed; `sealed` ones from a secret (`tests.studies.gap.sealed`).
"""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from flows.benchmarks.base import Options, Tables
from flows.benchmarks.outcomes import RecordFile, read_records
from models.design.space import numbered_design
from models.gap.bank.bank import Bank
from models.records import GraspSetup, Record, SimulatorVersion
from tests.studies.gap.answers import Answer, answer, naming_code, statistics_of, thresholds_id
from tests.studies.gap.panels import Panels
from tests.studies.gap.tables import gap_tables
from tests.studies.gap.truth import Panel, results_folder
from tests.studies.gap.worlds import Group, WorldKey, Worlds

if TYPE_CHECKING:
    from models.gap.naming.thresholds import Statistics, Thresholds

N_CALIBRATION_NULLS, N_CALIBRATION_SINGLES = 40, 20
N_WORLDS: dict[Group, int] = {"null": 60, "nasty null": 20, "single": 60, "alias": 12, "unlisted": 12, "pair": 20}
PUBLIC_SEED = 8
MARGIN_SD, LEAST_EFFECT_R2, LEAST_UPPER_BOUND_R2 = 3.0, 0.01, 0.005
LEAST_TEMPERATURE = 3.0  # twenty worlds do not tell small ones apart, and laws differ from the catalogue's
Stage = Literal["calibration", "development", "sealed"]


class GapOutcome(Record):
    """A world, what it hides, and the answer. `left_out`: the truth was taken out of the catalogue."""

    stage: Stage
    key: WorldKey
    answer: Answer
    left_out: bool = False

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
    worlds = Worlds(panels, bank, PUBLIC_SEED)
    end = time.monotonic() + 60.0 * options.limit_minutes
    with RecordFile(options.results) as file:
        for group, number in _interleaved(options.worlds):
            for left_out in (False, True) if group == "single" else (False,):
                place = ("development", group, number, left_out)
                known = outcomes.get(place)
                if known is not None and is_current(known.answer, thresholds):
                    continue
                if time.monotonic() > end:
                    break
                key = worlds.draw(group, number)
                without = key.names if left_out else ()
                said = answer(worlds.problem(key), thresholds, without=without, truth=key.names)
                outcomes[place] = GapOutcome(stage="development", key=key, answer=said, left_out=left_out)
                file.append(outcomes[place])
                options.tell(_line(outcomes[place]))
    shown = [o for o in outcomes.values() if o.stage == "development" and is_current(o.answer, thresholds)]
    return gap_tables([(o.key, o.answer, o.left_out) for o in shown])


def open_panels(folder: Path) -> tuple[Panels, Bank]:
    """True grasps, and the bank of the simulator's grasps of the same designs and objects."""
    from lake.store import Lake
    from tasks.gap.bank import read_bank

    panel = Panel.read(folder)
    panels = Panels.read(folder / "truth.jsonl", panel)
    own = [numbered_design(number) for number in panel.designs]
    bank = read_bank(Lake(str(folder / "lake")), SimulatorVersion(), own, panel.objects, GraspSetup())
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
    """Lines from null worlds and the temperature from worlds with an effect, none of which is counted later."""
    from models.gap.naming.thresholds import Thresholds, fit_temperature, fit_thresholds

    provisional = Thresholds()
    wanted: list[tuple[Group, int]] = [("null", number) for number in range(N_CALIBRATION_NULLS)]
    wanted += [("single", number) for number in range(N_CALIBRATION_SINGLES)]
    if options.worlds is not None:
        wanted = [(group, number) for group, number in wanted if number < 4 * options.worlds]
    made = []
    with RecordFile(options.results) as file:
        for group, number in wanted:
            place = ("calibration", group, number, False)
            if place not in outcomes or outcomes[place].answer.code != naming_code():
                key = worlds.draw(group, number)
                said = answer(
                    worlds.problem(key), provisional, truth=key.names, keep_evidence=group == "single", max_rounds=1
                )
                outcomes[place] = GapOutcome(stage="calibration", key=key, answer=said)
                file.append(outcomes[place])
                options.tell(_line(outcomes[place]))
            made.append(outcomes[place])
    nulls = [statistics_of(one.answer) for one in made if one.key.group == "null"]
    lines = with_margin(fit_thresholds(nulls, provisional), nulls)
    tried = [one for one in made if one.answer.evidence and one.key.names[0] in one.answer.rounds[0].candidates]
    if not tried:
        return lines
    temperature = fit_temperature(
        [[np.array(gain) for gain in one.answer.evidence] for one in tried],
        [one.answer.priors for one in tried],
        [list(one.answer.rounds[0].candidates).index(one.key.names[0]) for one in tried],
    )
    return lines.model_copy(update={"temperature": max(temperature, LEAST_TEMPERATURE)})


def with_margin(lines: "Thresholds", nulls: "Sequence[Statistics]") -> "Thresholds":
    """Lines no lower than `MARGIN_SD` standard deviations above the mean of null worlds.

    The largest of 40 worlds is crossed by one new world in 41, and there are four lines. An effect that predicts less
    than `LEAST_EFFECT_R2`, an upper bound less than `LEAST_UPPER_BOUND_R2`, is no gap, whatever null worlds give.
    """
    found = {name: np.array([getattr(one, name) for one in nulls]) for name in type(nulls[0]).model_fields}
    high = {name: float(values.mean() + MARGIN_SD * values.std()) for name, values in found.items()}
    high["effect_r2"] = max(high["effect_r2"], LEAST_EFFECT_R2)
    high["upper_bound_r2"] = max(high["upper_bound_r2"], LEAST_UPPER_BOUND_R2)
    return lines.model_copy(update={name: max(getattr(lines, name), value) for name, value in high.items()})


def thresholds_content(thresholds: "Thresholds") -> dict[str, object]:
    """Lines with the id of the code that they hold for."""
    return {"code": naming_code(), "lines": thresholds.model_dump(mode="json")}


def _interleaved(n_worlds: int | None) -> Iterator[tuple[Group, int]]:
    """World after world, a bit of every group first: a run that is stopped has seen all of them."""
    counts = {group: n if n_worlds is None else min(n, n_worlds) for group, n in N_WORLDS.items()}
    rounds = max(counts.values())
    for turn in range(rounds):
        for group, n in counts.items():
            for number in range(-(-turn * n // rounds), -(-(turn + 1) * n // rounds)):
                yield group, number


def _line(outcome: GapOutcome) -> str:
    hidden = ", ".join(f"{h.effect} {100 * h.visible_strength:.1f} %" for h in outcome.key.effects) or "nothing"
    said = "; ".join(f"{said.kind} {'+'.join(said.effects)}" for said in outcome.answer.rounds)
    left_out = " (not in the catalogue)" if outcome.left_out else ""
    return f"{outcome.key.group} {outcome.key.number}: {hidden}{left_out} -> {said}, {outcome.answer.cpu_s:.1f} s"
