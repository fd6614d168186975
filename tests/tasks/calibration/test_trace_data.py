"""From rows of the lake to a problem of trace-level calibration."""

from pathlib import Path

import numpy as np
import pytest

from lake.store import Lake
from lake.tables.campaign import DesignRow, GraspRow, SimulatorVersionRow, TraceRow, setup_columns
from lake.tables.row import Row
from models.calibration.inference.settings import ThetaPriors
from models.calibration.traces.calibrate import laplace, trace_density
from models.errors import UsageError
from models.records import EffectValue, GraspSetup, SimulatorVersion, Theta
from tasks.calibration.trace_data import grid_plan, grid_points, measured_designs, trace_data
from tasks.simulation.plan import missing_objects
from tests.tasks.calibration.trace_lake import (
    BASE,
    DESIGNS,
    N_REPEATS,
    OBJECTS,
    PROVENANCE,
    SETUP,
    TRUTH,
    measured_rows,
    simulated_rows,
)


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Four tools on three objects; one design is not simulated on object 30, one grasp was made twice."""
    lake = Lake.open(tmp_path_factory.mktemp("trace") / "lake", create=True)
    points = grid_points(DESIGNS, BASE)
    rows: list[Row] = [DesignRow.of(design) for design in DESIGNS]
    rows += {version.version_id: SimulatorVersionRow.of(version) for _, version in points}.values()
    # A coarser mesh and another friction belong to no grid of the base.
    others = BASE.model_copy(update={"tier": "screening"}), BASE.model_copy(update={"theta": Theta(friction=0.111)})
    rows += [SimulatorVersionRow.of(version) for version in others]
    points = (*points, *((DESIGNS[0], version) for version in others))
    for design, version in points:
        objects = OBJECTS[:2] if design == DESIGNS[3] else OBJECTS
        rows += [row for object_id in objects for row in simulated_rows(design, version, object_id)]
    for number, design in enumerate(DESIGNS):
        for object_id in OBJECTS:
            for repeat in range(N_REPEATS):
                rows += measured_rows(design, f"demo/B01T{number}", object_id, repeat)
    rows += measured_rows(DESIGNS[0], "demo/B01T0", 4, 0, attempt=1)
    trace, stuck = measured_rows(DESIGNS[1], "demo/B01T1", 7, N_REPEATS)
    assert isinstance(trace, TraceRow)
    rows += [trace.model_copy(update={"lift_mm": 0.0 * trace.lift_mm}), stuck]
    lake.append(rows, PROVENANCE)
    return lake


def test_the_lake_gives_the_problem_and_theta_is_found(lake: Lake) -> None:
    data = trace_data(lake, BASE, "demo")
    problem = data.problem
    assert problem.tools == tuple(f"demo/B01T{number}" for number in range(4))
    assert problem.objects == ("4", "7", "30")
    assert problem.simulated.shape == (4, 3, 12, 14)
    np.testing.assert_array_equal(problem.n_repeats, [[2, 2, 2]] * 3 + [[2, 2, 0]])
    assert len(data.grasp_ids) == 22
    assert len(data.simulation_ids) == 11 * 12
    assert [sentence.partition(" have ")[0] for sentence in data.warnings] == [
        "1 of 12 pairs of a design and an object",
        "1 of 23 grasps",
    ]
    assert GraspRow.make_id("demo/B01T0", 4, 0, 1) in data.grasp_ids
    density = trace_density(problem, ThetaPriors())
    best, covariance = laplace(density)
    theta = density.constrained(np.random.default_rng(0).multivariate_normal(best, covariance, size=500))[:, 3:]
    assert (np.abs(theta.mean(axis=0) - TRUTH) < 3.5 * theta.std(axis=0)).all()
    np.testing.assert_allclose(theta.mean(axis=0), TRUTH, rtol=0.12)


def test_what_to_simulate_follows_from_what_was_measured(lake: Lake) -> None:
    designs, objects = measured_designs(lake, "demo")
    assert sorted(d.design_id for d in designs) == sorted(d.design_id for d in DESIGNS)
    assert objects == [4, 7, 30]
    plan = grid_plan(lake, BASE, "demo")
    assert plan.n_grasps == 4 * 12 * 3
    assert len({version.version_id for _, version in plan.points}) == 12
    missing = missing_objects(lake, plan)
    assert {design.design_id for (design, _), _ in missing} == {DESIGNS[3].design_id}
    assert [objects for _, objects in missing] == [[30]] * 12


def test_what_cannot_be_calibrated_is_refused_in_one_sentence(lake: Lake, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="campaign other has no measured grasps; measure tools, or import data"):
        trace_data(lake, BASE, "other")
    with pytest.raises(UsageError, match="none of the 12 measured pairs .* simulate the 12 points of the grid"):
        trace_data(lake, SimulatorVersion(tier="reference"), "demo")
    stalling = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 40.0})
    with pytest.raises(UsageError, match="with `force_limited_closing` forces do not scale with Young's modulus"):
        trace_data(lake, SimulatorVersion(effects=(stalling,)), "demo")
    mixed = Lake.open(tmp_path / "mixed", create=True)
    rows = [*measured_rows(DESIGNS[0], "demo/B01T0", 4, 0), *measured_rows(DESIGNS[1], "demo/B01T1", 4, 0)]
    rows[-1] = rows[-1].model_copy(update=setup_columns(GraspSetup(lift_speed_mm_per_s=7)))
    mixed.append(rows, PROVENANCE)
    with pytest.raises(UsageError, match="has grasps of 2 setups"):
        trace_data(mixed, BASE, "demo")
    others = {"world_hash": "W2"}, setup_columns(SETUP)
    mixed.append([row.model_copy(update=new) for row, new in zip(rows[1::2], others, strict=True)], PROVENANCE)
    with pytest.raises(UsageError, match=r"has grasps of 2 benches \(virtual, virtual W2\)"):
        trace_data(mixed, BASE, "demo")
