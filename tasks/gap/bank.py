"""The bank of gap discovery in the lake: what to simulate for it, and the simulations as arrays."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, SimTraceRow, SimulationRow
from fast.models.calibration.traces.theta_grid import ThetaGrid
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import (
    CLOSED_LESS,
    NUMERICAL,
    OTHER_SETUPS,
    VARIANTS,
    WIDE,
    Bank,
    BankPlan,
    EffectRuns,
    carry_changes,
    list_versions,
)
from fast.models.gap.bank.sensor_effects import N_LEAD, read_lead
from fast.models.gap.fit.theta import make_grid_bank
from fast.models.gap.grasps import Cells
from fast.models.records import Design, GraspSetup, Placement, Theta, Trace, find_setup_id
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.step_features import N_STEPS, is_usable, step_means
from fast.tasks.gap.trace_rows import read_traces
from fast.tasks.simulation.plan import SimulationPlan

BANK = "gap_bank"  # kind of the events that name banks around a fitted theta
# What a search simulates, in words.
WIDE_BANK, LOCAL_BANK, HELD_OUT = "the bank", "the bank around the fitted theta", "the set of held-out grasps"
_AT_ONCE = 4000  # traces held while they are averaged


def plan_bank(base: SimulatorVersion, cells: Cells, bank_plan: BankPlan = WIDE) -> tuple[SimulationPlan, ...]:
    """Plan the simulations of a bank, for `tasks.simulation.plan.simulate_plan`, which makes what the lake lacks.

    Version by version over all designs, the centre first: a bank that is not complete lacks effects, not designs.
    """
    bank_plan = bank_plan.leave_out_effects(cells.designs)
    versions = list_versions(base, bank_plan)
    centre = versions[len(bank_plan.grid.points)]
    order = tuple({version.version_id: version for version in (centre, *versions)}.values())
    picks = [pick for others in _list_other_setups(bank_plan).values() for pick in others]
    plans = []
    for block in _list_blocks(cells):
        plans.append(block.plan(order))
        plans += [replace(block, setup=pick(block.setup)).plan([centre]) for pick in picks]
    return tuple(plans)


def plan_centre(base: SimulatorVersion, cells: Cells) -> tuple[SimulationPlan, ...]:
    """Plan the simulations of the wide bank at its centre alone, a fortieth of it."""
    return plan_cells([base.model_copy(update={"theta": WIDE.centre})], cells)


def plan_cells(versions: Sequence[SimulatorVersion], cells: Cells) -> tuple[SimulationPlan, ...]:
    """Plan the simulations of cells by versions."""
    return tuple(block.plan(versions) for block in _list_blocks(cells))


def read_bank(
    lake: Lake, base: SimulatorVersion, cells: Cells, bank_plan: BankPlan = WIDE, wide: Bank | None = None
) -> Bank:
    """Read a bank of t designs on k targets, of what the lake has; NaN where a simulation failed or is missing.

    wide: the bank that a local one takes over from what is not simulated in it; it needs one.

    Raises:
        UsageError: no simulation at the centre of theta is there.
    """
    bank_plan = bank_plan.leave_out_effects(cells.designs)
    grid, versions = np.array(bank_plan.grid.points), list_versions(base, bank_plan)
    n_grid, steps_n = len(grid), read_simulated_steps(lake, versions, cells)
    at_centre, after = steps_n[:, :, n_grid], n_grid + 1
    if not np.isfinite(at_centre).any():
        raise UsageError(
            f"the lake {lake.address} has no simulation of the bank for these {len(cells.designs)} designs on "
            f"{len(cells.targets)} objects; `fast gap` makes them."
        )
    own = {
        name: np.concatenate(
            [read_simulated_steps(lake, versions[n_grid:after], cells, pick) for pick in picks], axis=2
        )
        for name, picks in _list_other_setups(bank_plan).items()
    }
    parts = [values[cells.is_wanted][..., 0] for values in (steps_n, *own.values())]
    if not bank_plan.is_local:
        after += len(NUMERICAL)
        own["numerical_steps_n"] = steps_n[:, :, n_grid + 1 : after]
    if wide is not None:
        carried = {name: carry_changes(getattr(wide, name), wide.centre_steps_n, at_centre) for name in VARIANTS}
        own = carried | own
    return Bank(
        targets=cells.targets,
        centre=bank_plan.centre,
        grid=grid,
        grid_steps_n=steps_n[:, :, :n_grid],
        grid_lead_n=read_simulated_steps(lake, versions[:n_grid], cells, of_trace=read_lead, n=N_LEAD),
        centre_steps_n=at_centre,
        effects=_part_effects(steps_n[:, :, after:], bank_plan),
        failed_share=float(sum(np.isnan(part).sum() for part in parts) / sum(part.size for part in parts)),
        **own,
    )


def _list_other_setups(bank_plan: BankPlan) -> dict[str, list[Callable[[GraspSetup], GraspSetup]]]:
    """List other setups in which the centre of a bank is simulated, by the array of `Bank` that they fill."""

    def pick(name: str, more: float) -> Callable[[GraspSetup], GraspSetup]:
        return lambda setup: setup.model_copy(update={name: getattr(setup, name) + more})

    is_made = {
        "placed_steps_n": not bank_plan.is_local,
        "wider_steps_n": bool(set(CLOSED_LESS) & set(bank_plan.effects)),
    }
    return {array: [pick(name, one) for one in more] for array, (name, more) in OTHER_SETUPS.items() if is_made[array]}


def note_bank(lake: Lake, gap_id: str, campaign_id: str | None, bank_plan: BankPlan) -> None:
    """Write down that a search simulates a bank of its own, so that its thetas are known for what they are."""
    thetas = [theta.model_dump(mode="json") for theta in (bank_plan.centre, *bank_plan.grid_thetas)]
    centre, grid = bank_plan.centre, bank_plan.grid
    message = (
        f"gap search {gap_id} simulates a bank around {centre.young_modulus_mpa:g} MPa, friction "
        f"{centre.friction:g} ({grid.friction[0]:g} to {grid.friction[1]:g}), Poisson ratio "
        f"{centre.poisson_ratio:g} ({grid.poisson_ratio[0]:g} to {grid.poisson_ratio[1]:g})"
    )
    row = EventRow.of([BANK, gap_id, thetas], BANK, message, {"gap_id": gap_id, "thetas": thetas}, campaign_id)
    if not lake.has(EventRow, row.event_id):
        lake.append([row], current_provenance())


def read_bank_thetas(lake: Lake) -> set[Theta]:
    """Read every theta that a bank of gap discovery in this lake was simulated at, the wide bank's too."""
    rows = lake.records(EventRow, kind=BANK)
    own = {Theta.model_validate(theta) for row in rows for theta in row.payload["thetas"]}
    return {WIDE.centre, *WIDE.grid_thetas} | own


def list_plan_ids(plans: Sequence[SimulationPlan]) -> list[str]:
    """List the ids of all simulations of plans."""
    return [
        SimulationRow.make_id(design.design_id, object_id, version.version_id, plan.setup_id)
        for plan in plans
        for design, version in plan.points
        for object_id in plan.object_ids
    ]


def plan_theta_grid(base: SimulatorVersion, cells: Cells) -> tuple[SimulationPlan, ...]:
    """Plan the part of the bank that theta alone needs: the grid of friction and Poisson ratio, design by design."""
    versions = list_versions(base)[: len(ThetaGrid().points)]
    return tuple(block.plan(versions, by_design=True) for block in _list_blocks(cells))


def read_grid_bank(lake: Lake, base: SimulatorVersion, cells: Cells) -> Bank:
    """Read the bank for theta alone: the grid of t designs on k targets, of what the lake has.

    Raises:
        UsageError: no cell has enough of the grid.
    """
    versions = list_versions(base)[: len(ThetaGrid().points)]
    return make_grid_bank(
        cells,
        read_simulated_steps(lake, versions, cells),
        read_simulated_steps(lake, versions, cells, of_trace=read_lead, n=N_LEAD),
    )


def _part_effects(steps_n: np.ndarray, bank_plan: BankPlan) -> dict[str, EffectRuns]:
    """Return the effects of a bank from their simulations (t x k x n x 120), in order."""
    found, start = {}, 0
    for effect in (name for name in bank_plan.effects if CATALOGUE[name].bank_runs):
        parameters = bank_plan.list_amplitudes(effect)
        end = start + len(parameters)
        found[effect] = EffectRuns(effect, parameters, steps_n[:, :, start:end])
        start = end
    return found


def read_simulated_steps(
    lake: Lake,
    versions: Sequence[SimulatorVersion],
    cells: Cells,
    vary: Callable[[GraspSetup], GraspSetup] = lambda setup: setup,
    *,
    of_trace: Callable[[Trace, GraspSetup], np.ndarray] = lambda trace, setup: step_means(trace),
    n: int = N_STEPS,
) -> np.ndarray:
    """Read the step means of simulations, t x k x v x 120; NaN where there is no usable trace.

    vary: another setup than a target's. of_trace: another reading of a trace instead, of `n` numbers.
    """
    columns_of = defaultdict[str, list[int]](list)
    for v, version in enumerate(versions):
        columns_of[version.version_id].append(v)
    places: dict[str, tuple[list[int], int, list[int]]] = {}
    setups = [vary(target.setup) for target in cells.targets]
    for design in dict.fromkeys(cells.designs):
        rows = [t for t, other in enumerate(cells.designs) if other == design]
        for k, target in enumerate(cells.targets):
            setup_id = find_setup_id(setups[k], target.placement)
            for version_id, columns in columns_of.items():
                simulation_id = SimulationRow.make_id(design.design_id, target.object_id, version_id, setup_id)
                places[simulation_id] = rows, k, columns
    steps_n = np.full((len(cells.designs), len(cells.targets), len(versions), n), np.nan)
    ids = list(places)
    for start in range(0, len(ids), _AT_ONCE):
        for simulation_id, trace in read_traces(lake, SimTraceRow, ids[start : start + _AT_ONCE]):
            if is_usable(trace):
                rows, k, columns = places[simulation_id]
                steps_n[np.ix_(rows, [k], columns)] = of_trace(trace, setups[k])
    return steps_n


@dataclass(frozen=True)
class _Block:
    """Cells that are grasped in one way: every design on every object."""

    designs: tuple[Design, ...]
    objects: tuple[int, ...]
    setup: GraspSetup
    placement: Placement

    def plan(self, versions: Sequence[SimulatorVersion], *, by_design: bool = False) -> SimulationPlan:
        """Plan its simulations, version by version, or design by design."""
        points = [(design, version) for version in versions for design in self.designs]
        if by_design:
            points = [(design, version) for design in self.designs for version in versions]
        return SimulationPlan(tuple(points), self.objects, self.setup, placement=self.placement)


def _list_blocks(cells: Cells) -> list[_Block]:
    """List the cells as blocks: by setup and placement, and by the designs that an object is wanted for."""
    objects = defaultdict[tuple[GraspSetup, Placement, tuple[Design, ...]], list[int]](list)
    for target, is_wanted in zip(cells.targets, cells.is_wanted.T, strict=True):
        designs = tuple(
            dict.fromkeys(design for design, wanted in zip(cells.designs, is_wanted, strict=True) if wanted)
        )
        if designs:
            objects[target.setup, target.placement, designs].append(target.object_id)
    return [_Block(designs, tuple(ids), setup, placement) for (setup, placement, designs), ids in objects.items()]
