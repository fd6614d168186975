"""Calibration on traces of what the lake has: theta alone, of every measured design.

Two thetas come of it. What is quoted, Table 2 and the draws, is theta of the bench. The simulator version gets the
medians of theta of the simulator: with it this simulator, on its own mesh, answers like the bench.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import SimulationRow
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.traces.theta_grid import GRID_MODULUS_MPA, ThetaGrid
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import list_versions
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.data import GapData
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.calibrate import CalibrationData, Progress, make_version
from fast.tasks.gap.bank import list_plan_ids, plan_cells, plan_theta_grid, read_grid_bank, read_simulated_steps
from fast.tasks.gap.data import MeasuredGrasps, check_forces, check_units
from fast.tasks.simulation.plan import SimulationPlan


@dataclass(frozen=True, eq=False)
class TraceData(CalibrationData):
    """Traces by tool and object with the simulations around them; nothing is held out."""

    kind = "trace"

    training: Surrogate

    @property
    def summary(self) -> str:
        """How much there is to learn from."""
        grasps = self.training.grasps
        return (
            f"{len(grasps.grasp_ids)} traces of {len(np.unique(grasps.tool))} tools on {len(np.unique(grasps.obj))} "
            f"objects, {len(self.simulation_ids)} simulated grasps around them"
        )

    def learn(
        self, settings: CalibrationSettings, progress: Progress | None
    ) -> tuple[CalibrationResult, SimulatorVersion | None, dict[str, Any]]:
        """Infer theta.

        Raises:
            UsageError: there are too few tools.
        """
        from fast.models.gap.fit.theta import calibrate_theta, of_bench

        result = calibrate_theta(self.training, settings, progress)
        columns = count_training(self.training) | {"n_simulations": len(self.simulation_ids), "n_held_out": 0}
        return of_bench(result, self.training.bank.grid), make_version(self.base, result), columns


def count_training(training: Surrogate) -> dict[str, int]:
    """Count the designs and objects a calibration learns from, as columns of its row."""
    grasps = training.grasps
    return {"n_designs": len(np.unique(grasps.tool)), "n_objects": len(np.unique(grasps.obj))}


def plan_grid(measured: MeasuredGrasps, base: SimulatorVersion) -> tuple[SimulationPlan, ...]:
    """List everything that a calibration of `base` on these traces wants simulated, whether or not the lake has it.

    Raises:
        UsageError: forces of `base` do not scale with Young's modulus.
    """
    build_effects(base.effects)  # names an effect that does not exist
    breaking = [value.effect for value in base.effects if not CATALOGUE[value.effect].scales_with_modulus]
    if breaking:
        raise UsageError(
            f"with `{breaking[0]}` forces do not scale with Young's modulus, which a calibration on traces takes for "
            "granted; calibrate on mean forces, or without the effect."
        )
    grasps = measured.grasps
    return plan_theta_grid(base, grasps.cells)


def plan_middle(measured: MeasuredGrasps, base: SimulatorVersion) -> tuple[SimulationPlan, ...]:
    """Plan the point of the grid that is simulated first: it says whether the measured forces are in N."""
    return plan_cells([_find_middle(base)], measured.grasps.cells)


def check_middle(lake: Lake, measured: MeasuredGrasps, base: SimulatorVersion) -> None:
    """Hold the measured grasps against `plan_middle`, before the whole grid is simulated.

    Raises:
        UsageError: the forces are not in N, or have the other sign.
    """
    grasps, cells = measured.grasps, measured.grasps.cells
    steps_n = read_simulated_steps(lake, [_find_middle(base)], cells)[:, :, 0]
    columns = [cells.targets.index(target) for target in grasps.target]
    check_forces(grasps.steps_n, steps_n[grasps.tool, columns], GRID_MODULUS_MPA)


def _find_middle(base: SimulatorVersion) -> SimulatorVersion:
    grid = ThetaGrid()
    return list_versions(base)[grid.points.index(grid.middle)]


def gather_traces(lake: Lake, measured: MeasuredGrasps, base: SimulatorVersion, campaign_id: str | None) -> TraceData:
    """Gather what a calibration on traces compares: measured grasps with what the lake has of their simulations.

    Raises:
        UsageError: nothing around them is simulated, or the forces are not in N.
    """
    grasps = measured.grasps
    bank = read_grid_bank(lake, base, grasps.cells)
    data = GapData.of_all(grasps, bank)
    kept = data.training
    plans = plan_theta_grid(base, grasps.cells)
    known = tuple(sorted(lake.ids(SimulationRow, simulation_id=list_plan_ids(plans), status="ok")))
    sentences = [*measured.trace_warnings, *check_units(data)]
    if n_lost := len(grasps.grasp_ids) - len(kept.grasps.grasp_ids):
        sentences.append(f"{n_lost} of {len(grasps.grasp_ids)} grasps have too few simulations around them; left out.")
    return TraceData(campaign_id, base, kept.grasps.grasp_ids, known, tuple(sentences), training=kept)
