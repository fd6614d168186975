"""A panel by its evidence alone: nothing is held out, so one finger on two objects is enough.

So small a panel mostly says what cannot be told apart, and the grasp that would decide. A lab's own simulator may stand
beside ours: then the question is what that one lacks.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fast.flows.gap.search import GapRequest, Simulator, describe_cpu, probe_costs
from fast.flows.progress import ProgressReporter
from fast.flows.report.gap.sentences import describe_probability
from fast.flows.simulation.progress import n_missing
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.models.gap.ask.choose import ENOUGH_NATS
from fast.models.gap.data import GapData
from fast.models.gap.evidence.rehearsal import rehearse_panel
from fast.models.gap.evidence.trials import Trial
from fast.models.gap.findings import NextExperiment
from fast.models.gap.grasps import Grasps
from fast.models.gap.naming.name import NamingResult, name_effect
from fast.models.gap.simulated import Beside, stand_beside
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.models.units import STANDARD_GRAVITY_M_PER_S2, spell_count, spell_name, spell_number, typeset, unit_of
from fast.tasks.calibration.mean_data import TooLittleDataError, find_base_version
from fast.tasks.campaign.requests import GAP_LEASE
from fast.tasks.gap.ask import ask
from fast.tasks.gap.bank import plan_bank, read_bank
from fast.tasks.gap.calibrate import SearchInputs
from fast.tasks.gap.cost import estimate_cost
from fast.tasks.gap.data import MeasuredGrasps, check_prints, check_repeats, check_units, read_grasps
from fast.tasks.gap.panel import LEAST_DESIGNS, LEAST_OBJECTS, select_panel
from fast.tasks.gap.simulated import read_simulated
from fast.tasks.gap.split import MIN_DESIGNS, MIN_OBJECTS
from fast.tasks.gap.trace_rows import designs_of, measured_grasps
from fast.tasks.objects import own_objects
from fast.tasks.simulation.plan import SimulationPlan

_MOST_ROWS = 8
_UNIT_TOLERANCE = 0.1  # of the logarithm of a modulus
_FORCE_TOLERANCE = np.log(2.0)  # what is missing changes forces, too
_ALIKE = "These cannot be told apart here"


@dataclass(frozen=True, eq=False)
class Weighed:
    """What a panel says by its evidence. asked: what would decide; None if nothing is open, or nothing would.

    beside: the measured grasps beside another simulator, if there is one.
    """

    grasps: Grasps
    naming: NamingResult
    asked: NextExperiment | None
    warnings: tuple[str, ...]
    beside: Beside | None = None

    @property
    def alike(self) -> tuple[Trial, ...]:
        """Effects on trial that have as much evidence as the best, within odds of 20 to 1; none without an alarm."""
        tried = self.naming.trials.tried if self.naming.alarm.is_raised else ()
        return tuple(one for one in tried if one.nats > tried[0].nats - ENOUGH_NATS)

    @property
    def sentence(self) -> str:
        """What is said of the panel."""
        grasps, named = self.grasps, self.naming.named
        n_tools, n_objects = len(grasps.tools), len(grasps.objects)
        made = f"{len(grasps.grasp_ids)} grasps of {spell_count(n_tools, 'tool')} on {spell_count(n_objects, 'object')}"
        said = [f"{made}; nothing is held out, so no name is checked on grasps that it never saw.", named.sentence]
        said.append(f"Right with probability {describe_probability(named.probability)}.")
        if len(self.alike) > 1:
            titles = "; ".join(CATALOGUE[one.effect].title for one in self.alike)
            words = "Of the catalogue, these explain equally little" if named.kind == "unknown" else _ALIKE
            said.append(f"{words}: {titles}.")
        if self.asked is not None:
            said.append(self.asked.sentence)
        elif named.kind != "none":
            said.append("No grasp of this bench would tell more.")
        if self.beside is not None:
            said.append(self._describe_beside(self.beside))
        return " ".join(said)

    def list_rows(self) -> list[dict[str, Any]]:
        """List what was weighed, the most evidence first: effects on trial, and the best pattern without a name."""
        trials = self.naming.trials
        values = {one.effect: one.value for one in trials.tried}
        values |= {value.effect: value for value in self.naming.values}  # what is named is told once
        rows: list[dict[str, Any]] = [
            {
                "may be missing": one.effect,
                "evidence": _round(one.nats),
                "value": _spell_value(values[one.effect]),
            }
            for one in trials.tried
        ]
        known = {one.effect for one in trials.tried}
        for one in trials.weighed:
            if one.name not in known and len(rows) < _MOST_ROWS:
                known.add(one.name)  # patterns of several widths have one name: the best of them
                rows.append({"may be missing": one.name, "evidence": _round(one.nats), "value": ""})
        return sorted(rows, key=lambda row: -row["evidence"])

    def _describe_beside(self, beside: Beside) -> str:
        """Tell how far the other simulator is from this one, and where its constants would go."""
        theta = self.naming.trials.fit.theta
        modulus, friction, ratio = theta - beside.theta
        off = np.log(np.array([theta[0] / beside.theta[0], beside.factor]) / STANDARD_GRAVITY_M_PER_S2)
        is_in_kg = bool((np.abs(off) < (_UNIT_TOLERANCE, _FORCE_TOLERANCE)).all())
        return (
            f"Your simulator is {spell_number(100.0 * beside.apart)} % of the force from ours at its likeliest "
            f"constants; the measured grasps move it by {typeset(modulus, '+.2g')} MPa, "
            f"{typeset(friction, '+.2g')} of friction and "
            f"{typeset(ratio, '+.2g')} of Poisson's ratio."
            + (" The factor is about 9.81: check that its forces are in N, not in kg." if is_in_kg else "")
        )


def is_small(lake: Lake, request: GapRequest) -> bool:
    """Return whether a panel has too few designs or objects to hold some out.

    Raises:
        UsageError: nothing was measured, or on several benches; a design is unknown.
    """
    rows = measured_grasps(lake, request.campaign_id)
    designs = designs_of(lake, [row.design_id for row in rows])
    rows = select_panel(rows, designs, request.panel)
    n_designs = len({designs[row.design_id].design_id for row in rows})
    return n_designs < MIN_DESIGNS or len({row.object_id for row in rows}) < MIN_OBJECTS


def describe_cost(lake: Lake, request: GapRequest, reporter: ProgressReporter, simulated: Path | None = None) -> str:
    """Say what weighing a panel would simulate and how long that takes, in a sentence. simulated: as in `weigh_panel`.

    A lake that has never simulated such grasps makes a few of the bank's, which tell how long one takes.

    Raises:
        TooLittleDataError: a single object was gripped.
        UsageError: measurements are missing or not of one kind; the file of forces is of another form.
        FastError: another process searches in this lake.
    """
    with exclusive(lake.storage, GAP_LEASE, f"the lake {lake.address} is already being searched for a gap"):
        measured, _ = _read(lake, request, simulated)
        plans = plan_bank(_find_base(lake, measured), measured.grasps.cells)
        return _write_cost(lake, request, plans, reporter)


def weigh_panel(lake: Lake, request: GapRequest, reporter: ProgressReporter, simulated: Path | None = None) -> Weighed:
    """Weigh what may be missing, with all grasps. simulated: forces of a lab's own simulator, CSV.

    Raises:
        TooLittleDataError: a single object was gripped.
        UsageError: measurements are missing, not of one kind, or not in N; the file of forces is of another form.
        FastError: the budget ended before the bank was complete, or another process searches in this lake.
    """
    with exclusive(lake.storage, GAP_LEASE, f"the lake {lake.address} is already being searched for a gap"):
        return _weigh(lake, request, reporter, *_read(lake, request, simulated))


def _read(lake: Lake, request: GapRequest, simulated: Path | None) -> tuple[MeasuredGrasps, np.ndarray | None]:
    """Read what was measured, and another simulator's step means of it, if there is one."""
    measured = read_grasps(lake, request.campaign_id, request.panel)
    _check_size(measured)
    if simulated is None:
        return measured, None
    own_objects(lake.address)  # the file may have their names
    return measured, read_simulated(simulated, measured.grasps)


def _weigh(
    lake: Lake,
    request: GapRequest,
    reporter: ProgressReporter,
    measured: MeasuredGrasps,
    simulated_n: np.ndarray | None,
) -> Weighed:
    base, cells = _find_base(lake, measured), measured.grasps.cells
    simulator = Simulator(lake, request, reporter, lambda: False)
    plans = plan_bank(base, cells)
    if n_missing(lake, plans):
        reporter.announce(_write_cost(lake, request, plans, reporter))
    simulator.fill_bank(base, measured)
    data = GapData.of_all(measured.grasps, read_bank(lake, base, cells), measured.facts)
    warnings = [*measured.warnings, *check_units(data), *check_repeats(data.grasps)]
    beside = None if simulated_n is None else stand_beside(data, simulated_n)
    data = data if beside is None else beside.data
    rehearsal = rehearse_panel(data, (), request.rehearsed, request.settings.workers or 1, reporter.progress)
    naming = name_effect(data, rehearsal)
    warnings += check_prints(naming.trials.fit)
    search = SearchInputs(
        lake=lake,
        gap_id="",
        data=data,
        base=base,
        campaign_id=request.campaign_id,
        settings=request.settings,
        simulate=simulator.simulate,
        rehearsal=rehearsal,
        progress=reporter.progress,
    )
    return Weighed(data.grasps, naming, ask(search, naming, request.most_asked), tuple(warnings), beside)


def _write_cost(lake: Lake, request: GapRequest, plans: Sequence[SimulationPlan], reporter: ProgressReporter) -> str:
    n_workers = request.settings.workers
    cost = estimate_cost(lake, plans, probe_costs(lake, plans, n_workers, reporter))
    n_all = sum(plan.n_grasps for plan in plans)
    words = f"; {describe_cpu(cost.cpu_s, n_workers)}" if cost.n_grasps else ""
    return f"To simulate: {cost.n_grasps} of the {n_all} grasps of the bank{words}."


def _find_base(lake: Lake, measured: MeasuredGrasps) -> SimulatorVersion:
    """Find the simulator of the campaigns, without effects."""
    return find_base_version(lake, measured.campaigns, None).model_copy(update={"effects": ()})


def _check_size(measured: MeasuredGrasps) -> None:
    """Refuse a panel that tells nothing, before anything is simulated.

    Raises:
        TooLittleDataError: a single object was gripped.
    """
    grasps = measured.grasps
    n = len(np.unique(grasps.obj))
    if n < LEAST_OBJECTS or len(np.unique(grasps.tool)) < LEAST_DESIGNS:
        raise TooLittleDataError(
            f"{spell_count(n, 'object')} was gripped: whatever is missing there is as well friction or a modulus, so "
            f"nothing can be told. {LEAST_OBJECTS} objects are the least, which mostly leaves open what it is; "
            f"{MIN_DESIGNS} designs on {MIN_OBJECTS} objects let a name be checked. `fast gap plan` says what a panel "
            f"would tell. {' '.join(measured.trace_warnings)}".rstrip()
        )


def _round(nats: float) -> float:
    return round(nats, 1) + 0.0  # not -0


def _spell_value(value: EffectValue) -> str:
    known: Sequence[tuple[str, float]] = list(value.parameters.items())
    return ", ".join(f"{spell_name(name)} {value:.3g} {unit_of(name) or ''}".rstrip() for name, value in known)
