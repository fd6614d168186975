"""What a calibration on traces compares, from the lake: measured traces, and the grid of simulations around them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lake.store import Lake
from lake.tables.campaign import GraspRow, SimTraceRow, SimulationRow, SimulatorVersionRow, TraceRow
from models.calibration.traces.assemble import Cell, GridPoint, trace_problem
from models.calibration.traces.problem import TraceProblem, n_terms
from models.calibration.traces.theta_grid import GRID_MODULUS_MPA, ThetaGrid
from models.errors import UsageError
from models.ids import canonical_json
from models.records import Design, GraspSetup, SimulatorVersion, Theta, Trace
from models.simulation.effects.catalogue import CATALOGUE, build_effects
from models.traces.step_features import is_usable
from models.traces.step_noise import SensorNoise, noise_of_readings
from tasks.calibration.trace_rows import designs_of, measured_grasps, read_traces
from tasks.simulation.plan import SimulationPlan

_Pair = tuple[str, int]  # (design, object)


@dataclass(frozen=True, eq=False)
class TraceData:
    """A problem for `calibrate_traces`, the rows it is of, and what was left out."""

    problem: TraceProblem
    grasp_ids: tuple[str, ...]
    simulation_ids: tuple[str, ...]
    warnings: tuple[str, ...]


def trace_data(
    lake: Lake,
    base: SimulatorVersion,
    campaign_id: str | None = None,
    grid: ThetaGrid = ThetaGrid(),  # noqa: B008 - frozen
    noise: SensorNoise | None = None,
) -> TraceData:
    """Everything that trace-level calibration of the simulator `base` needs, from a campaign or the whole lake.

    Measured: every repeat that ended well, the last attempt of each, of tools on objects whose designs are simulated on
    enough of the grid by versions that differ from `base` in theta alone; `grid_plan` are the ones to simulate.
    `noise` is estimated from the readings before the fingers touch unless given. Then
    `calibrate_traces(data.problem, settings, progress)` gives the result, whose calibration has `data = "trace"`.

    Raises:
        UsageError: forces of `base` do not scale with Young's modulus, nothing was measured or not in one way, a
            design is unknown, a measured trace cannot be used, or too little of the grid is simulated.
    """
    _require_scaling(base)
    grasps = measured_grasps(lake, campaign_id)
    setup = GraspSetup.model_validate_json(grasps[0].setup_json)
    known = designs_of(lake, [row.design_id for row in grasps])
    # Simulations name a design by its content, measurements perhaps as another lab does.
    pair_of = {row.grasp_id: (known[row.design_id].design_id, row.object_id) for row in grasps}
    pairs = set(pair_of.values())
    simulations = _grid_simulations(lake, base, grasps[0].setup_id, pairs, grid)
    enough = n_terms(np.array(grid.points)) + 1
    complete = {pair for pair, rows in simulations.items() if len(rows) >= enough}
    used = [row for row in grasps if pair_of[row.grasp_id] in complete]
    if not used:
        raise UsageError(
            f"none of the {len(pairs)} measured pairs of a design and an object has the {enough} simulations around it "
            f"that a calibration on traces needs; simulate the {len(grid.points)} points of the grid for them."
        )
    measured, grasp_ids = _measured_traces(lake, used)
    designs = {(row.tool_id, str(row.object_id)): pair_of[row.grasp_id] for row in used}
    made = _simulated_traces(lake, {pair: simulations[pair] for pair in complete})
    problem = trace_problem(
        measured,
        {cell: made[pair] for cell, pair in designs.items() if cell in measured},
        modulus_mpa=GRID_MODULUS_MPA,
        noise=noise or noise_of_readings([trace for traces in measured.values() for trace in traces]),
        lift_speed_mm_per_s=setup.lift_speed_mm_per_s,
    )
    simulation_ids = [row_id for pair in complete for row_id, _ in simulations[pair].values()]
    warnings = []
    if len(complete) < len(pairs):
        warnings.append(_left_out(len(pairs) - len(complete), len(pairs), enough))
    if len(grasp_ids) < len(used):
        n = len(used) - len(grasp_ids)
        warnings.append(f"{n} of {len(used)} grasps have no trace, or one without a lift of 3 mm; left out.")
    return TraceData(problem, tuple(grasp_ids), tuple(simulation_ids), tuple(warnings))


def grid_points(
    designs: Iterable[Design],
    base: SimulatorVersion,
    grid: ThetaGrid = ThetaGrid(),  # noqa: B008 - frozen
) -> tuple[tuple[Design, SimulatorVersion], ...]:
    """Designs with the simulator versions of the grid: what to simulate on the measured objects, in any order.

    Raises:
        UsageError: forces of `base` do not scale with Young's modulus.
    """
    _require_scaling(base)
    versions = [base.model_copy(update={"theta": theta}) for theta in grid.thetas]
    return tuple((design, version) for design in designs for version in versions)


def measured_campaigns(lake: Lake, campaign_id: str | None = None) -> list[str]:
    """Campaigns of the grasps that a calibration on traces compares.

    Raises:
        UsageError: nothing was measured, or not in one way.
    """
    return sorted({row.campaign_id for row in measured_grasps(lake, campaign_id)})


def measured_designs(lake: Lake, campaign_id: str | None = None) -> tuple[list[Design], list[int]]:
    """Designs and objects with a measured trace: what `grid_points` are to be simulated for.

    Raises:
        UsageError: nothing was measured, or a design is unknown.
    """
    grasps = measured_grasps(lake, campaign_id)
    known = designs_of(lake, [row.design_id for row in grasps])
    return list(known.values()), sorted({row.object_id for row in grasps})


def grid_plan(
    lake: Lake,
    base: SimulatorVersion,
    campaign_id: str | None = None,
    grid: ThetaGrid = ThetaGrid(),  # noqa: B008 - frozen
) -> SimulationPlan:
    """The grid of everything measured, for `tasks.simulation.plan.simulate_plan`, which makes what the lake lacks.

    Raises:
        UsageError: as `measured_designs` and `grid_points`.
    """
    designs, objects = measured_designs(lake, campaign_id)
    setup = GraspSetup.model_validate_json(measured_grasps(lake, campaign_id)[0].setup_json)
    return SimulationPlan(grid_points(designs, base, grid), tuple(objects), setup)


def _require_scaling(version: SimulatorVersion) -> None:
    build_effects(version.effects)  # names an effect that does not exist
    breaking = [value.effect for value in version.effects if not CATALOGUE[value.effect].scales_with_modulus]
    if breaking:
        raise UsageError(
            f"with `{breaking[0]}` forces do not scale with Young's modulus, which a calibration on traces takes for "
            "granted; calibrate on mean forces, or without the effect."
        )


def _grid_simulations(
    lake: Lake, base: SimulatorVersion, setup_id: str, pairs: set[_Pair], grid: ThetaGrid
) -> dict[_Pair, dict[GridPoint, tuple[str, float]]]:
    """Simulations (id, Young's modulus) at the points of the grid, by design and object."""
    family = canonical_json(base.model_dump(exclude={"theta"}))
    points = set(grid.points)
    thetas: dict[str, Theta] = {}
    for row in lake.records(SimulatorVersionRow, tier=base.tier):
        version = row.version
        on_grid = (version.theta.friction, version.theta.poisson_ratio) in points
        if on_grid and canonical_json(version.model_dump(exclude={"theta"})) == family:
            thetas[row.version_id] = version.theta
    found: dict[_Pair, dict[GridPoint, tuple[str, float]]] = {pair: {} for pair in pairs}
    designs = sorted({design for design, _ in pairs})
    simulations = lake.records(
        SimulationRow, version_id=sorted(thetas), design_id=designs, setup_id=setup_id, status="ok"
    )
    for done in simulations:
        theta, pair = thetas[done.version_id], (done.design_id, done.object_id)
        if pair in found:
            found[pair][theta.friction, theta.poisson_ratio] = (done.simulation_id, theta.young_modulus_mpa)
    return found


def _measured_traces(lake: Lake, grasps: Sequence[GraspRow]) -> tuple[dict[Cell, list[Trace]], list[str]]:
    """Traces that can be used, by cell, and the ids of their grasps."""
    found: dict[Cell, list[Trace]] = {}
    grasp_ids: list[str] = []
    by_tool: dict[str, dict[str, Cell]] = {}
    for row in grasps:
        by_tool.setdefault(row.tool_id, {})[row.grasp_id] = (row.tool_id, str(row.object_id))
    for cells in by_tool.values():
        for grasp_id, trace in read_traces(lake, TraceRow, list(cells)):
            if is_usable(trace):
                found.setdefault(cells[grasp_id], []).append(trace)
                grasp_ids.append(grasp_id)
    return found, grasp_ids


def _simulated_traces(
    lake: Lake, simulations: Mapping[_Pair, Mapping[GridPoint, tuple[str, float]]]
) -> dict[_Pair, dict[GridPoint, Trace]]:
    """Traces of simulations, their forces at `GRID_MODULUS_MPA`."""
    found: dict[_Pair, dict[GridPoint, Trace]] = {}
    for pair, rows in simulations.items():
        points = {row_id: (point, modulus_mpa) for point, (row_id, modulus_mpa) in rows.items()}
        for row_id, trace in read_traces(lake, SimTraceRow, list(points)):
            point, modulus_mpa = points[row_id]
            scaled = Trace(trace.time_s, trace.lift_mm, trace.force_n * GRID_MODULUS_MPA / modulus_mpa)
            found.setdefault(pair, {})[point] = scaled
    return found


def _left_out(n: int, n_all: int, enough: int) -> str:
    return f"{n} of {n_all} pairs of a design and an object have fewer than {enough} simulations of the grid; left out."
