"""Cells by name: where most of the gap lies, and where the simulator itself is unsure."""

import dataclasses

import numpy as np
import pytest

from fast.models.gap.data import GapData
from fast.models.gap.where.cells import find_heaviest_cells, find_unsure_cells
from fast.models.gap.where.locate import describe_silence, locate
from fast.models.gap.where.residuals import Residuals
from fast.models.objects.catalogue import get_object
from tests.synthetic.gap import GapTruth, made_up_gap

TRUTH = GapTruth()


@pytest.fixture(scope="module")
def data() -> GapData:
    return made_up_gap(8, 6, 0, TRUTH)


@pytest.fixture(scope="module")
def residuals(data: GapData) -> Residuals:
    theta = np.array(list(TRUTH.theta.model_dump().values()))
    return Residuals.of(data.training, data.training.predict_steps(theta), TRUTH.theta.young_modulus_mpa)


def test_the_cell_with_the_gap_is_named(residuals: Residuals) -> None:
    is_there = (residuals.tool == 3) & (residuals.obj == 2)
    moved = dataclasses.replace(residuals, measured_n=residuals.measured_n + 2.0 * is_there[:, None])
    first, *others = find_heaviest_cells(moved)
    assert (first.tool, first.object_name) == ("T3", get_object(residuals.objects[2]).name)
    assert first.share > 0.5
    assert first.gap_n == pytest.approx(2.0, rel=0.2)
    assert len(others) == 4
    assert sum(cell.share for cell in (first, *others)) <= 1.0


@pytest.mark.parametrize(("field", "cause"), [("numerical_steps_n", "mesh"), ("placed_steps_n", "height")])
def test_a_cell_that_depends_on_mesh_or_height_is_unsure(data: GapData, field: str, cause: str) -> None:
    centre_n = data.bank.centre_steps_n[:, :, None]
    quiet = {name: np.repeat(centre_n, getattr(data.bank, name).shape[2], axis=2) for name in
             ("numerical_steps_n", "placed_steps_n")}  # fmt: skip
    quiet[field][5, 1, 0] *= 0.7
    bank = dataclasses.replace(data.bank, **quiet)
    (cell,) = find_unsure_cells(bank, data.grasps.tools)
    assert (cell.tool, cell.cause) == ("T5", cause)
    assert cell.object_name == get_object(data.grasps.objects[1]).name
    assert 0.1 < cell.spread_n / cell.peak_n < 0.3


def test_what_was_not_found_is_said(residuals: Residuals) -> None:
    everywhere = dataclasses.replace(residuals, measured_n=residuals.measured_n + 0.2 * residuals.amplitude_n[:, None])
    said = describe_silence(locate(everywhere).tests)
    assert said.startswith("No larger than chance makes it with these tools and objects: ")
    assert "the repeat" in said
    assert "rib thickness" in said
    assert "a gap in" not in said  # it is in every phase
