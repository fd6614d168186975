"""A small lake to calibrate on traces: closed forms for tools at a hidden theta and for the grid, no physics run."""

from pathlib import Path
from typing import Any

import numpy as np

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    DesignRow,
    GraspRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    TraceRow,
)
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.row import Row
from fast.models.calibration.inference.optimise import approximate_at_mode
from fast.models.calibration.inference.parallel_chains import Samples
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.design.space import numbered_design
from fast.models.gap.fit.posterior import PosteriorDensity
from fast.models.gap.grasps import Cells
from fast.models.records import Design, GraspSetup, Theta, Trace
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import plan_theta_grid
from tests.synthetic.gap import made_up_trace

BASE, SETUP, OBJECTS, N_REPEATS = SimulatorVersion(), GraspSetup(), (4, 7, 30), 2
DESIGNS = [numbered_design(number) for number in range(4)]
TRUTH = Theta(young_modulus_mpa=9.0, friction=0.55, poisson_ratio=0.4)
PROVENANCE = Provenance(code_version="0", code_dirty=False, config_hash="c", seed=0, parents=())


def shape(design: Design, object_id: int) -> np.ndarray:
    return np.random.default_rng([int(1000 * design.length_mm), object_id]).uniform(size=4)


def measured_trace(design: Design, object_id: int, rng: np.random.Generator) -> Trace:
    """Closing and holding for a second, then the lift, with white noise of 0.05 N at 80 readings a second."""
    lift = made_up_trace(shape(design, object_id), TRUTH)
    time_s = np.arange(0.0, 13.0, 1 / 80.0)
    lift_mm = 5.0 * np.clip(time_s - 1.0, 0.0, None)
    force_n = np.where(time_s > 0.35, np.interp(lift_mm, lift.lift_mm, lift.force_n), 0.0)
    return Trace(time_s, lift_mm, force_n + 0.05 * rng.standard_normal(len(time_s)))


def measured_rows(design: Design, tool_id: str, object_id: int, repeat: int, attempt: int = 0) -> list[Row]:
    trace = measured_trace(design, object_id, np.random.default_rng([object_id, repeat]))
    return grasp_rows(design, tool_id, object_id, repeat, attempt, trace)


def grasp_rows(design: Design, tool_id: str, object_id: int, repeat: int, attempt: int, trace: Trace) -> list[Row]:
    """A grasp of the virtual bench that went well, and its trace."""
    grasp_id = GraspRow.make_id(tool_id, object_id, repeat, attempt)
    grasp = GraspRow(
        grasp_id=grasp_id,
        campaign_id="demo",
        tool_id=tool_id,
        design_id=design.design_id,
        object_id=object_id,
        repeat=repeat,
        attempt=attempt,
        status="ok",
        bench="virtual",
        **setup_columns(SETUP),
    )
    return [TraceRow.of(grasp_id, trace), grasp]


def simulated_trace(design: Design, version: SimulatorVersion, object_id: int) -> Trace:
    """What the simulator answers, which is right in all but theta."""
    return made_up_trace(shape(design, object_id), version.theta)


def simulated_rows(design: Design, version: SimulatorVersion, object_id: int) -> list[Row]:
    simulation_id = SimulationRow.make_id(design.design_id, object_id, version.version_id, SETUP.setup_id)
    row = SimulationRow(
        simulation_id=simulation_id,
        design_id=design.design_id,
        object_id=object_id,
        version_id=version.version_id,
        status="ok",
        **setup_columns(SETUP),
    )
    return [SimTraceRow.of(simulation_id, simulated_trace(design, version, object_id)), row]


def normal_draws(density: PosteriorDensity, start: np.ndarray, settings: CalibrationSettings, **_: Any) -> Samples:
    """The normal distribution at the mode, in the place of NUTS, which takes half a minute."""
    mode, covariance = approximate_at_mode(density, density.start)
    rng = np.random.default_rng(settings.seed)
    draws = rng.multivariate_normal(mode, covariance, size=(len(start), settings.draws))
    return Samples(draws, np.zeros(draws.shape[:2], dtype=int), 0, 0, 0, 0.0)


def trace_lake(root: Path, n_simulated: int = len(DESIGNS)) -> Lake:
    """A lake with four tools measured on three objects, and the whole grid around the first designs."""
    lake = Lake.open(root, create=True)
    rows: list[Row] = [DesignRow.of(design) for design in DESIGNS]
    plans = plan_theta_grid(BASE, Cells.full(DESIGNS[:n_simulated], OBJECTS, SETUP))
    points = [point for plan in plans for point in plan.points]
    rows += {version.version_id: SimulatorVersionRow.of(version) for _, version in points}.values()
    for design, version in points:
        rows += [row for object_id in OBJECTS for row in simulated_rows(design, version, object_id)]
    for number, design in enumerate(DESIGNS):
        for object_id in OBJECTS:
            for repeat in range(N_REPEATS):
                rows += measured_rows(design, f"demo/B01T{number}", object_id, repeat)
    lake.append(rows, PROVENANCE)
    return lake
