"""The search of the lab-world study on forces that are known, and its tables."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, LOWER, UPPER, to_unit
from fast.models.records import Design
from tests.studies.benchmarks.base import Options
from tests.studies.scientist.lab_world import (
    LabGrasp,
    best_of,
    best_row,
    class_rows,
    compass,
    corners,
    cost_row,
    design_row,
    on_bounds,
    search,
    transfer_row,
)


class MadeUpGrasps:
    """Mean peaks that fall with the distance from an optimum in the unit cube; thick fingers of one rib fail."""

    options = Options()

    def __init__(self, optimum: np.ndarray) -> None:
        self.optimum = optimum

    def mean_peak_n(self, bench: str, design: Design, objects: tuple[int, ...]) -> float:
        if design.rib_count == 1 and design.front_thickness_mm == 3.0:
            return float("nan")
        return 30.0 - 10.0 * float(np.linalg.norm(to_unit([design])[0] - self.optimum))


def test_the_search_finds_an_optimum_inside_the_box_and_one_in_a_corner():
    inside = search(MadeUpGrasps(np.full(9, 0.45)), "simulator", 20)
    best = best_of(inside)
    assert on_bounds(best) == []
    assert inside[best] > max(inside[BEST_PUBLISHED], 26.0)
    corner = np.array([1, 1, 0, 0, 1, 1, 1, 1, 0.5])
    found = search(MadeUpGrasps(corner), "simulator", 20)
    row = best_row("simulator", found)
    assert row["bounds"] >= 7
    assert row["best_inside_n"] < row["best_n"]
    assert row["designs"] == len(found)


def test_a_step_of_the_compass_changes_one_parameter_and_stays_in_the_box():
    moves = compass(BEST_PUBLISHED, 0.3)
    middle = to_unit([BEST_PUBLISHED])[0]
    assert len(moves) == 18
    for design, move in moves.items():
        assert np.count_nonzero(move) == 1
        np.testing.assert_allclose(to_unit([design])[0], middle + move, atol=1e-6)
    values = np.array([list(design.model_dump().values()) for design in moves])
    assert (values >= LOWER).all()
    assert (values <= UPPER).all()
    assert len(compass(corners()[0], 0.1)) < 18, "no step leads out of the box"


def test_corners_lie_on_bounds_and_the_published_best_does_not():
    assert on_bounds(BEST_PUBLISHED) == []
    assert all(len(on_bounds(design)) >= 7 for design in corners())


def grasp(bench: str, number: int, object_id: int, peak_n: float | None) -> LabGrasp:
    design = BEST_PUBLISHED.model_copy(update={"height_mm": 100.0 + number})
    return LabGrasp(key="B", bench=bench, design=design, object_id=object_id, peak_force_n=peak_n, cpu_s=1.0)


def test_tables_leave_failures_out_and_count_them():
    measured_n = {2: (10.0, 20.0, 30.0), 14: (9.0, 7.0, None)}
    pairs = [
        (grasp("simulator", n, o, 10.0 * (n + 1)), grasp("lab", n, o, measured_n[o][n]))
        for n in range(3)
        for o in (2, 14)
    ]
    sphere, tube = class_rows(pairs)
    assert (sphere["object_class"], sphere["n"], sphere["correlation"]) == ("sphere", 3, pytest.approx(1.0))
    assert (tube["n"], tube["correlation"]) == (2, pytest.approx(-1.0))
    means = design_row(pairs)
    assert (means["n"], means["designs_left_out"], means["measured_mean_n"]) == (2, 1, pytest.approx(11.5))
    assert cost_row(pairs)["failed_lab"] == 1
    designs = [grasp("lab", n, 2, None).design for n in range(3)]
    found = {
        "simulator": dict(zip(designs, (1.0, 2.0, 3.0), strict=True)),
        "lab without scatter": dict(zip(designs, (5.0, 7.0, 6.0), strict=True)),
    }
    transfer = transfer_row(found)
    assert (transfer["measured_of_best_simulated_n"], transfer["best_measured_n"]) == (6.0, 7.0)
