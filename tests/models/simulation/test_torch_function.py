"""The peak as a function for torch: what it refuses, and what its gradient is; `test_slopes` has the numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, Slope, Slopes
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.slopes import torch_function
from fast.models.simulation.slopes.torch_function import PeakFunction
from fast.models.simulation.version import SimulatorVersion

INPUTS = GraspInputs(BEST_PUBLISHED, get_object(30), SimulatorVersion(), GraspSetup())


@pytest.fixture(autouse=True)
def _simulate_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """A peak of 1.5 N with a slope of 2."""

    def simulate(inputs, along):
        slopes = Slopes(1.0, {name: Slope("N", np.zeros(1), 2.0, 1.0) for name in along}, {}) if along else None
        return SimpleNamespace(peak_force_n=1.5, slopes=slopes)

    monkeypatch.setattr(torch_function, "simulate_inputs", simulate)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("friction", 9.0, "`theta.friction` is 9.0, it must be at most 2.0; change it."),
        ("friction", -1.0, "`theta.friction` is -1.0, it must be at least 0.0; change it."),
        ("young_modulus_mpa", -1.0, "`theta.young_modulus_mpa` is -1.0 MPa, it must be at least 0.5 MPa; change it."),
        ("nu", 0.5, "`theta.poisson_ratio` is 0.5, it must be below 0.5; change it."),
        ("closed_gap_mm", 200.0, "`closed_gap_mm` is 200.0 mm, it must be at most 150.0 mm; change it."),
        ("length_mm", 36.0, "`length_mm` is 36.0 mm, it must be at most 35.0 mm; change it."),
        ("offset_z_mm", float("nan"), "`offset_z_mm` is nan, it must be a finite number; change it."),
    ],
)
def test_a_value_that_no_grasp_has_is_refused(name: str, value: float, sentence: str) -> None:
    with pytest.raises(UsageError) as refused:
        PeakFunction(INPUTS, [name])(torch.tensor([[value]], dtype=torch.float64))
    assert str(refused.value) == f"grasp_function: {sentence}"


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (torch.tensor([[1]]), "values are torch.int64; give a torch tensor of dtype torch.float64"),  # would cut peaks
        (np.array([[0.5]]), "values are ndarray; give a torch tensor"),
        (torch.tensor([[0.5, 0.5]]), r"have the shape \(1, 2\), the last axis must be the 1 parameters friction"),
    ],
)
def test_what_is_no_tensor_of_values_is_refused(values, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        PeakFunction(INPUTS, ["friction"])(values)


@pytest.mark.parametrize("names", [("length_mm", "length_mm"), ("nu", "poisson_ratio"), ("all", "friction")])
def test_a_parameter_that_is_named_twice_is_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="twice; leave one out"):
        PeakFunction(INPUTS, names)


def test_a_name_alone_and_all_stand_for_lists() -> None:
    assert PeakFunction(INPUTS, "friction").names == ["friction"]
    assert {"young_modulus_mpa", "nu", "length_mm", "offset_z_mm"} < set(PeakFunction(INPUTS, "all").names)


def test_a_whole_number_is_rounded_without_names_and_refused_among_them() -> None:
    function = PeakFunction(INPUTS)
    place = function.names.index("rib_count")
    values = torch.tensor([getattr(BEST_PUBLISHED, name) for name in function.names], dtype=torch.float64)
    slopes = torch.autograd.grad(function(values.requires_grad_()), values)[0].tolist()
    assert (slopes[place], set(slopes)) == (0.0, {0.0, 2.0})
    with pytest.raises(UsageError, match="`rib_count` is inf, it must be a finite number; change it"):
        function(torch.where(torch.arange(len(values)) == place, torch.inf, values))
    for names in ("rib_count", ("friction", "rib_count")):
        with pytest.raises(UsageError, match="^`rib_count` has no slope; slopes are by material .*rib_angle_deg"):
            PeakFunction(INPUTS, names)


def test_a_gradient_is_the_slope_and_has_none_itself() -> None:
    values = torch.tensor([[0.5, 30.0]], dtype=torch.float64, requires_grad=True)
    peaks = PeakFunction(INPUTS, ["friction", "length_mm"])(values)
    assert torch.autograd.grad(peaks.sum(), values, retain_graph=True)[0].tolist() == [[2.0, 2.0]]
    with pytest.raises(UsageError, match="it has no second derivatives; leave out `create_graph`"):
        torch.autograd.functional.hessian(lambda x: PeakFunction(INPUTS, ["friction"])(x).sum(), values[:, :1])


@pytest.mark.parametrize("transform", [torch.func.vmap, torch.func.jacrev, torch.func.grad])
def test_transforms_of_torch_func_are_refused(transform) -> None:
    function = PeakFunction(INPUTS, ("friction",))
    values = torch.full((2, 1) if transform is torch.func.vmap else (1,), 0.5, dtype=torch.float64)
    with pytest.raises(UsageError, match="grasp_function: torch.func .* cannot look into a simulation; give all rows"):
        transform(function)(values)
