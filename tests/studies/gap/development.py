"""The figures of gap discovery on worlds of known truth, in stages, each in the results file.

`development` worlds come from a public seed, `independent` ones from another solver (`tests.studies.gap.independent`).
"""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from fast.flows.challenge.hidden.panels import Panels
from fast.flows.challenge.hidden.worlds import Group, WorldKey, Worlds
from fast.models.design.space import numbered_design
from fast.models.gap.bank.bank import Bank
from fast.models.gap.evidence import REHEARSED
from fast.models.gap.grasps import Cells
from fast.models.records import GraspSetup, Record
from fast.models.simulation.version import SimulatorVersion
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.answers import Answer, answer, measure_twin, naming_code
from tests.studies.gap.judgement import Judged
from tests.studies.gap.tables import gap_tables
from tests.studies.gap.truth import Panel, read_panels, results_folder

if TYPE_CHECKING:
    from fast.models.gap.evidence.rehearsal import Rehearsal

N_WORLDS: dict[Group, int] = {"null": 40, "nasty null": 12, "single": 48, "alias": 6, "unlisted": 12, "pair": 20}
PUBLIC_SEED = 8
Stage = Literal["development", "independent"]


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
    panels, bank = read_small(PANEL) if options.results is None else open_panels(results_folder(options))
    return measure_worlds(Worlds(panels, bank, PUBLIC_SEED, has_other_laws=True), "development", N_WORLDS, options)


def measure_worlds(worlds: Worlds, stage: Stage, wanted: Mapping[Group, int], options: Options) -> Tables:
    """Answer so many worlds of each group, those with one effect also without it in the catalogue, and count."""
    outcomes, rehearsal = read_outcomes(options.results), rehearse_worlds(worlds, options)
    end = time.monotonic() + 60.0 * options.limit_minutes
    with RecordFile(options.results) as file:
        for group, number, is_left_out in interleave(wanted, options.worlds):
            place = (stage, group, number, is_left_out)
            known = outcomes.get(place)
            if known is not None and is_current(known.answer):
                continue
            if time.monotonic() > end:
                break
            key = worlds.draw(group, number)
            said = answer(worlds.problem(key), rehearsal, without=key.names if is_left_out else ())
            twin_n = None if is_left_out else measure_twin(worlds.problem(worlds.twin(key)), rehearsal)
            outcomes[place] = GapOutcome(stage=stage, key=key, answer=said, left_out=is_left_out, twin_n=twin_n)
            file.append(outcomes[place])
            options.tell(_line(outcomes[place]))
    shown = [o for o in outcomes.values() if o.stage == stage and is_current(o.answer)]
    return gap_tables([Judged(o.key, o.answer, o.left_out, o.twin_n) for o in shown])


def open_panels(folder: Path) -> tuple[Panels, Bank]:
    """True grasps, and the bank of the simulator's grasps of the same designs and objects."""
    from fast.lake.store import Lake
    from fast.tasks.gap.bank import read_bank

    panel = Panel.read(folder)
    panels = read_panels(folder / "truth.jsonl", panel)
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


def is_current(said: Answer) -> bool:
    """Whether the present code gave the answer."""
    return said.code == naming_code()


def rehearse_worlds(worlds: Worlds, options: Options) -> "Rehearsal":
    """One rehearsal for all worlds of a panel: that of the first, whose forces it never sees."""
    from fast.models.gap.evidence.rehearsal import rehearse_panel

    data = worlds.problem(worlds.draw("null", 0))
    return rehearse_panel(data, (), options.n or REHEARSED, options.workers or 1, options.tell)


def interleave(wanted: Mapping[Group, int], n_worlds: int | None) -> Iterator[tuple[Group, int, bool]]:
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
