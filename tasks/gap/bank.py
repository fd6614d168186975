"""The bank of gap discovery in the lake: what to simulate for it, and the simulations as arrays."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from lake.store import Lake
from lake.tables.campaign import SimTraceRow, SimulationRow
from models.calibration.traces.theta_grid import ThetaGrid
from models.errors import UsageError
from models.gap.bank.bank import (
    AMPLITUDES,
    CENTRE,
    NUMERICAL_MESHES,
    WIDER_MM,
    Bank,
    EffectRuns,
    list_placed_setups,
    list_versions,
    list_wider_setups,
)
from models.gap.bank.sensor_effects import N_LEAD, read_lead
from models.gap.fit.theta import make_grid_bank
from models.records import Design, GraspSetup, SimulatorVersion, Trace
from models.traces.step_features import N_STEPS, is_usable, step_means
from tasks.gap.trace_rows import read_traces
from tasks.simulation.plan import SimulationPlan

_AT_ONCE = 4000  # traces held while they are averaged


def plan_bank(
    base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> tuple[SimulationPlan, ...]:
    """Simulations of the bank, for `tasks.simulation.plan.simulate_plan`, which makes what the lake lacks.

    Version by version over all designs, the centre first: a bank that is not complete lacks effects, not designs.
    """
    unique, versions = list(dict.fromkeys(designs)), list_versions(base)
    n_grid = len(ThetaGrid().points)
    centre = versions[n_grid]
    order = [centre, *versions[:n_grid], *versions[n_grid + 1 :]]
    points = tuple((design, version) for version in order for design in unique)
    at_centre = tuple((design, centre) for design in unique)
    others = (*list_placed_setups(setup), *list_wider_setups(setup))
    plans = [SimulationPlan(points, tuple(objects), setup)]
    return (*plans, *(SimulationPlan(at_centre, tuple(objects), other) for other in others))


def read_bank(
    lake: Lake, base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> Bank:
    """The bank of t designs on o objects, of what the lake has; NaN where a simulation failed or is missing.

    Raises:
        UsageError: no simulation at the centre of theta is there.
    """
    grid, versions = ThetaGrid(), list_versions(base)
    n_grid = len(grid.points)
    steps_n = read_simulated_steps(lake, versions, designs, objects, setup)
    placed_steps_n, wider_steps_n = (
        np.concatenate(
            [read_simulated_steps(lake, versions[n_grid : n_grid + 1], designs, objects, other) for other in others],
            axis=2,
        )
        for others in (list_placed_setups(setup), list_wider_setups(setup))
    )
    at_centre = steps_n[:, :, n_grid]
    if not np.isfinite(at_centre).any():
        raise UsageError(
            f"the lake {lake.address} has no simulation of the bank for these {len(designs)} designs on "
            f"{len(objects)} objects; `fast gap` makes them."
        )
    after = n_grid + 1 + len(NUMERICAL_MESHES)
    of_lead = partial(read_lead, setup=setup)
    lead_n = read_simulated_steps(lake, versions[:n_grid], designs, objects, setup, of_trace=of_lead, n=N_LEAD)
    parts = [values[..., 0] for values in (steps_n, placed_steps_n, wider_steps_n)]
    return Bank(
        centre=CENTRE,
        grid=np.array(grid.points),
        grid_steps_n=steps_n[:, :, :n_grid],
        grid_lead_n=lead_n,
        centre_steps_n=at_centre,
        numerical_steps_n=steps_n[:, :, n_grid + 1 : after],
        placed_steps_n=placed_steps_n,
        wider_mm=np.array(WIDER_MM),
        wider_steps_n=wider_steps_n,
        effects=_part_effects(steps_n[:, :, after:]),
        failed_share=float(sum(np.isnan(part).sum() for part in parts) / sum(part.size for part in parts)),
    )


def list_bank_ids(
    base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> list[str]:
    """Ids of all simulations of the bank."""
    return list_plan_ids(plan_bank(base, designs, objects, setup))


def list_plan_ids(plans: Sequence[SimulationPlan]) -> list[str]:
    """Ids of all simulations of plans."""
    return [
        SimulationRow.make_id(design.design_id, object_id, version.version_id, plan.setup.setup_id)
        for plan in plans
        for design, version in plan.points
        for object_id in plan.object_ids
    ]


def plan_theta_grid(
    base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> SimulationPlan:
    """The part of the bank that theta alone needs: the grid of friction and Poisson ratio."""
    versions = list_versions(base)[: len(ThetaGrid().points)]
    points = tuple((design, version) for design in dict.fromkeys(designs) for version in versions)
    return SimulationPlan(points, tuple(objects), setup)


def read_grid_bank(
    lake: Lake, base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> Bank:
    """The bank for theta alone: the grid of t designs on o objects, of what the lake has.

    Raises:
        UsageError: no cell has enough of the grid.
    """
    versions = list_versions(base)[: len(ThetaGrid().points)]
    of_lead = partial(read_lead, setup=setup)
    return make_grid_bank(
        read_simulated_steps(lake, versions, designs, objects, setup),
        read_simulated_steps(lake, versions, designs, objects, setup, of_trace=of_lead, n=N_LEAD),
    )


def _part_effects(steps_n: np.ndarray) -> dict[str, EffectRuns]:
    """Effects of the bank from their simulations (t x o x n x 120) in the order of `AMPLITUDES`."""
    found, start = {}, 0
    for effect, parameters in AMPLITUDES.items():
        end = start + len(parameters)
        found[effect] = EffectRuns(effect, parameters, steps_n[:, :, start:end])
        start = end
    return found


def read_simulated_steps(
    lake: Lake,
    versions: Sequence[SimulatorVersion],
    designs: Sequence[Design],
    objects: Sequence[int],
    setup: GraspSetup,
    *,
    of_trace: Callable[[Trace], np.ndarray] = step_means,
    n: int = N_STEPS,
) -> np.ndarray:
    """Step means of simulations, t x o x v x 120; NaN where there is no usable trace.

    of_trace: another reading of a trace instead, of `n` numbers.
    """
    version_ids, setup_id = [version.version_id for version in versions], setup.setup_id
    places: dict[str, tuple[list[int], int, int]] = {}
    for design in dict.fromkeys(designs):
        rows = [t for t, other in enumerate(designs) if other == design]
        for o, object_id in enumerate(objects):
            for v, version_id in enumerate(version_ids):
                places[SimulationRow.make_id(design.design_id, object_id, version_id, setup_id)] = rows, o, v
    steps_n = np.full((len(designs), len(objects), len(versions), n), np.nan)
    ids = list(places)
    for start in range(0, len(ids), _AT_ONCE):
        for simulation_id, trace in read_traces(lake, SimTraceRow, ids[start : start + _AT_ONCE]):
            if is_usable(trace):
                rows, o, v = places[simulation_id]
                steps_n[rows, o, v] = of_trace(trace)
    return steps_n
