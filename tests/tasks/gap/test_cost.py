"""What a search costs before it starts, and smaller panels."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, SimulationRow
from fast.models.design.space import numbered_design, to_unit
from fast.models.gap.bank.bank import NUMERICAL, WIDE, list_versions
from fast.models.gap.grasps import Cells
from fast.models.gap.local_bank import MOST_EFFECTS, MOST_RUNS
from fast.models.objects.catalogue import get_object
from fast.models.records import Design
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import plan_bank
from fast.tasks.gap.cost import GraspCosts, choose_largest_bank, estimate_cost, plan_probe
from fast.tasks.gap.data import read_grasps, split_measurements
from fast.tasks.gap.findings import make_gap_id
from fast.tasks.gap.panel import PanelSize, spread_designs, spread_objects
from fast.tasks.gap.split import Split
from fast.tasks.gap.trace_rows import measured_grasps
from fast.tasks.simulation.plan import SimulationPlan
from tests.tasks.calibration.trace_lake import PROVENANCE
from tests.tasks.gap.gap_lake import BASE, DESIGNS, OBJECTS, SETUP, gap_lake, measured_rows, plan_rows

PLANS = plan_bank(BASE, Cells.full(DESIGNS[:3], OBJECTS[:2], SETUP))
N_VERSIONS = len(list_versions(BASE)) + 4  # two placements, two wider gaps


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake", create=True)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return gap_lake(tmp_path_factory.mktemp("measured") / "lake", has_bank=False)


def simulate(lake: Lake, plans: Sequence[SimulationPlan], cpu_s: float, fine_s: float) -> None:
    """Grasps that took so long, on the finer mesh `fine_s`."""
    fine = {version.version_id for version in list_versions(BASE) if version.mesh == NUMERICAL[0]["mesh"]}
    rows = plan_rows(plans)
    lake.append(
        [
            row.model_copy(update={"cpu_s": fine_s if row.version_id in fine else cpu_s})
            if isinstance(row, SimulationRow)
            else row
            for row in rows
        ],
        PROVENANCE,
    )


def test_the_cost_of_a_cold_bank_is_not_known_until_a_few_grasps_of_each_variant_are_made(lake: Lake) -> None:
    n_all = 3 * 2 * N_VERSIONS
    cold = estimate_cost(lake, PLANS, GraspCosts.read(lake))
    assert (cold.n_grasps, cold.cpu_s) == (n_all, None)
    probe = plan_probe(lake, PLANS, GraspCosts.read(lake))
    assert len(probe) == 1 + len(NUMERICAL)
    assert [plan.n_grasps for plan in probe] == [4] * len(probe)
    simulate(lake, probe, 2.0, 10.0)
    costs = GraspCosts.read(lake)
    assert plan_probe(lake, PLANS, costs) == ()
    left = estimate_cost(lake, PLANS, costs)
    assert left.n_grasps == n_all - 4 * len(probe)  # what was tried is of the bank
    assert left.cpu_s == pytest.approx(2.0 * (6 * (N_VERSIONS - 1) - 4 * (len(probe) - 1)) + 10.0 * (6 - 4))


def test_the_largest_bank_around_a_theta_has_nothing_of_the_wide_one() -> None:
    plan = choose_largest_bank()
    assert not {*plan.grid_thetas, plan.centre} & {*WIDE.grid_thetas, WIDE.centre}
    most = sorted((len(spec.bank_runs) for spec in CATALOGUE.values()), reverse=True)[:MOST_EFFECTS]
    assert sum(len(CATALOGUE[name].bank_runs) for name in plan.effects) == sum(most)
    versions = {version.version_id for version in list_versions(SimulatorVersion(), plan)}
    assert len(versions) == 5 + sum(most) + MOST_RUNS, "a named effect is simulated where it was fitted"


def test_a_panel_is_spread_and_a_larger_one_holds_a_smaller_one() -> None:
    designs = [numbered_design(number) for number in range(40)]
    order = spread_designs(designs[::-1])
    assert order == spread_designs(designs)  # whatever the order of the rows
    assert len(order) == 40

    def nearest(some: list[Design]) -> float:
        unit = to_unit(some)
        return min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(unit, 2))

    assert nearest(order[:8]) > nearest(designs[:8])
    objects = spread_objects(set(range(36)))
    n_classes = len({get_object(number).object_class for number in range(36)})
    assert len({get_object(number).object_class for number in objects[:n_classes]}) == n_classes


def test_a_search_takes_the_panel_that_is_asked_for(measured: Lake) -> None:
    size = PanelSize(7, 5)
    split, found = split_measurements(measured, "demo", 1, size), read_grasps(measured, "demo", size)
    assert len(split.designs) == len(found.grasps.tools) == 7
    assert tuple(sorted(split.objects)) == found.grasps.objects
    assert len(found.grasps.objects) == 5
    assert sum(split.designs.values()) == 2


def test_replaced_samples_and_measured_walls_make_another_search(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    lake.append([DesignRow.of(DESIGNS[0]), *rows], PROVENANCE)
    split = Split({DESIGNS[0].design_id: False}, {OBJECTS[0]: False})

    def make_id() -> str:
        return make_gap_id(read_grasps(lake, None), BASE, split, {})

    before = make_id()
    assert make_id() == before
    ids = [row.grasp_id for row in measured_grasps(lake, None)]
    other = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[1], repeat)]
    traces = [
        row.model_copy(update={"grasp_id": grasp_id})
        for grasp_id, row in zip(ids, (row for row in other if row.table == "traces"), strict=True)
    ]
    lake.append(traces, PROVENANCE)
    assert [row.grasp_id for row in measured_grasps(lake, None)] == ids
    replaced = make_id()
    assert replaced != before
    measured = read_grasps(lake, None)
    thicker = DESIGNS[0].model_copy(update={"front_thickness_mm": DESIGNS[0].front_thickness_mm + 0.01})
    printed = replace(measured, grasps=replace(measured.grasps, designs=(thicker,)))
    assert make_gap_id(printed, BASE, split, {}) != replaced
