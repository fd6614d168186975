"""A small lake to calibrate: made-up forces of tools at a hidden theta and of a hypercube, no physics run."""

from pathlib import Path

import numpy as np

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, DesignRow, GraspRow, SimulationRow, ToolRow
from fast.lake.tables.catalogue_rows import version_rows
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.row import Row
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.hypercube import HypercubePlan, draw_hypercube
from fast.models.design.space import numbered_design, to_unit
from fast.models.records import Design, GraspSetup, Theta
from fast.models.simulation.version import SimulatorVersion
from tests.synthetic.calibration import force_n

TRUTH = Theta(young_modulus_mpa=9.0, friction=0.6, poisson_ratio=0.4)
OBJECTS = (2, 14, 24)
SETUP = GraspSetup()
SETTINGS = CalibrationSettings(chains=2, draws=200, tune=50)
PROVENANCE = Provenance(code_version="test", code_dirty=False)
CONFIG = """
name = "{name}"
[objects]
ids = [2, 14, 24]
repeats = 2
[simulator]
tier = "{tier}"
[bench]
world = "world.toml"
"""


def made_up_force_n(design: Design, object_id: int, theta: Theta) -> float:
    """Force on an object, N, in exact proportion to Young's modulus."""
    point, values = to_unit([design]), np.array([list(theta.model_dump().values())])
    return float(force_n(point, values, scales_with_modulus=True)[0]) * (0.8 + 0.1 * (object_id % 5))


def measured_rows(n: int, name: str = "small", first: int = 0, tier: str = "production") -> list[Row]:
    """A campaign with n measured tools of designs `first`, `first` + 1, ..., two grasps on each object."""
    rng = np.random.default_rng([first, n])
    rows: list[Row] = [CampaignRow(campaign_id=name, name=name, config_toml=CONFIG.format(name=name, tier=tier))]
    for number in range(first, first + n):
        design = numbered_design(number)
        tool_id = ToolRow.make_id(name, 1 + number // 10, number % 10)
        rows.append(DesignRow.of(design))
        rows.append(
            ToolRow(
                tool_id=tool_id,
                campaign_id=name,
                batch=1 + number // 10,
                slot=number % 10,
                design_id=design.design_id,
                status="printed",
                confirmed_by="auto",
            )
        )
        for object_id in OBJECTS:
            rows += [grasp_row(name, tool_id, design, object_id, repeat, rng) for repeat in range(2)]
    return rows


def grasp_row(
    name: str, tool_id: str, design: Design, object_id: int, repeat: int, rng: np.random.Generator
) -> GraspRow:
    """A measured grasp at the hidden theta."""
    return GraspRow(
        grasp_id=GraspRow.make_id(tool_id, object_id, repeat),
        campaign_id=name,
        tool_id=tool_id,
        design_id=design.design_id,
        object_id=object_id,
        repeat=repeat,
        status="ok",
        peak_force_n=made_up_force_n(design, object_id, TRUTH) + rng.normal(0.0, 0.1),
        bench="virtual",
        world_hash="W1",
        **setup_columns(SETUP),
    )


def simulated_rows(n: int, base: SimulatorVersion | None = None, seed: int = 0) -> list[Row]:
    """A hypercube of n points on all objects."""
    rows: list[Row] = []
    for point in draw_hypercube(HypercubePlan(n=n, seed=seed)):
        version = (base or SimulatorVersion()).model_copy(update={"theta": point.theta})
        rows += [DesignRow.of(point.design), *version_rows(version)]
        rows += [simulation_row(point.design, object_id, version) for object_id in OBJECTS]
    return rows


def simulation_row(design: Design, object_id: int, version: SimulatorVersion) -> SimulationRow:
    """A simulated grasp; the simulator is right in all but theta."""
    return SimulationRow(
        simulation_id=SimulationRow.make_id(design.design_id, object_id, version.version_id, SETUP.setup_id),
        design_id=design.design_id,
        object_id=object_id,
        version_id=version.version_id,
        status="ok",
        peak_force_n=made_up_force_n(design, object_id, version.theta),
        **setup_columns(SETUP),
    )


def calibration_lake(root: Path, n_tools: int = 15, n_points: int = 40) -> Lake:
    """A lake with one campaign and one hypercube."""
    lake = Lake.open(root, create=True)
    lake.append(measured_rows(n_tools), PROVENANCE)
    if n_points:
        lake.append(simulated_rows(n_points), PROVENANCE)
    return lake


def made_up_result(problem, settings: CalibrationSettings, theta: Theta = TRUTH, **changes) -> CalibrationResult:
    """Draws around a theta, as a calibration might find them."""
    from fast.models.calibration.means.parameters import Parameters
    from fast.models.calibration.means.problem import Standardised

    names = Parameters.of(Standardised.of(problem), settings).names
    rng = np.random.default_rng(settings.seed)
    draws = rng.lognormal(0.0, 0.1, (settings.chains, settings.draws, len(names)))
    centers = dict(theta.model_dump(), nugget=0.02, noise_sd_n=0.1, sd_e_n=0.3, sd_h=1.5)
    for place, name in enumerate(names):
        draws[:, :, place] *= centers.get(name, 1.5)
    fields = {
        "method": "factorised",
        "r_hat": dict.fromkeys(names, 1.002),
        "ess_bulk": dict.fromkeys(names, 1500.0),
        "ess_tail": dict.fromkeys(names, 1200.0),
        "n_divergences": 0,
        "k_hat": 0.3,
        "cpu_s": 2.0,
    }
    return CalibrationResult(names, draws, settings, **(fields | changes))
