"""Slopes of a grasp: against differences of the discrete force, exact ones, finite steps, and what has none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import EffectValue, GraspSetup, GraspSimulation, Placement
from fast.models.simulation import grasp as grasp_module
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.slopes import march, trace
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.simulation.solver.stepping import Step
from fast.models.simulation.version import SimulatorVersion
from tests.models.simulation.frozen_steps import problem_of, walk_frozen

INPUTS = GraspInputs(numbered_design(11), get_object(1), SimulatorVersion(), GraspSetup())
NAMES = (
    *("young_modulus_mpa", "friction", "nu", "length_mm", "rib_angle_deg", "wall_offset_mm", "closed_gap_mm"),
    *("static_kinetic_friction.kinetic_ratio", "stress_relaxation.relaxed_share"),
)


def simulate(along: tuple[str, ...], inputs: GraspInputs = INPUTS) -> GraspSimulation:
    return simulate_grasp(
        inputs.design, inputs.obj, inputs.version, inputs.setup, placement=inputs.placement, along=along
    )


def with_effect(effect: str, **parameters: float) -> GraspInputs:
    return replace(INPUTS, version=SimulatorVersion(effects=(EffectValue(effect=effect, parameters=parameters),)))


@pytest.fixture(scope="module")
def walked() -> tuple[GraspSimulation, list[Step], int]:
    """A grasp with its slopes, its steps, and how many of them close the jaws."""
    grasp_module.compile_simulator()  # by a grasp, whose steps would be noted, too
    steps: list[tuple[str, Step]] = []
    add = grasp_module._Observed.add

    def note(self, phase, time_s, travel_mm, step):
        steps.append((phase, step))
        add(self, phase, time_s, travel_mm, step)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grasp_module._Observed, "add", note)
        result = simulate(NAMES)
    return result, [step for _, step in steps], sum(phase == "closing" for phase, _ in steps)


def test_slopes_change_no_number_of_the_grasp(walked) -> None:
    plain = simulate(())
    assert np.array_equal(plain.trace.force_n, walked[0].trace.force_n)
    assert plain.n_newton == walked[0].n_newton


def test_the_slope_by_the_modulus_is_exact(walked) -> None:
    result = walked[0]
    by_modulus = result.slopes.by["young_modulus_mpa"]
    assert by_modulus.unit == "N/MPa"
    assert by_modulus.peak_n == pytest.approx(result.peak_force_n / 11.5, rel=1e-9)
    assert by_modulus.force_n == pytest.approx(result.trace.force_n / 11.5, abs=1e-9)


@pytest.mark.parametrize(
    "name", ["friction", "nu", "length_mm", "rib_angle_deg", "wall_offset_mm", "closed_gap_mm", NAMES[7]]
)
def test_slopes_are_those_of_the_discrete_force(walked, name: str) -> None:
    """Each step solved nearly to rounding, with the parameter moved and not; the grasp's own steps end 5 mN off."""
    result, steps, n_closing = walked
    actual = INPUTS.with_effects()
    mesh = build_mesh(INPUTS.design, INPUTS.version.mesh)
    like = grasp_module.FingerProblem(mesh, INPUTS.design, actual.theta, actual.setup)
    parameter = find_parameters(INPUTS, [name])[name]
    change = 3.0 * parameter.small
    moved = problem_of(parameter.put(parameter.value + change), like)
    further_mm = moved.stroke_mm - like.stroke_mm
    forces = [walk_frozen(INPUTS, one, steps, n_closing, mm) for one, mm in ((like, 0.0), (moved, further_mm))]
    by_difference = 4.0 * (forces[1] - forces[0])[n_closing:, 2] / change
    lift_mm = np.array([step.travel_mm for step in steps[n_closing:]])
    is_lift = result.trace.is_lift
    own = np.interp(lift_mm, result.trace.lift_mm[is_lift], result.slopes.by[name].force_n[is_lift])
    kept = lift_mm < result.slopes.trusted_mm
    assert np.sqrt(np.mean((own - by_difference)[kept] ** 2)) < 0.015 * np.sqrt(np.mean(own[kept] ** 2))


def test_a_slope_is_the_same_whatever_else_is_asked(walked) -> None:
    """To the last bit; a jaw that closes further is the one copy of `closed_gap_mm`."""
    for names in (("nu",), ("wall_offset_mm", "friction"), ("closed_gap_mm",)):
        for name, slope in simulate(names).slopes.by.items():
            assert np.array_equal(slope.force_n, walked[0].slopes.by[name].force_n, equal_nan=True)


def test_a_parameter_that_is_asked_for_twice_has_one_slope() -> None:
    """By the first of its names."""
    assert list(find_parameters(INPUTS, ("poisson_ratio", "nu", "friction", "friction"))) == [
        "poisson_ratio",
        "friction",
    ]
    assert list(find_parameters(INPUTS, ("nu", "all")))[0] == "nu"
    assert len(find_parameters(INPUTS, ("nu", "all", "poisson_ratio"))) == 14


def test_a_parameter_that_changes_nothing_has_the_slope_0() -> None:
    """Kinetic friction is that at rest, and no grasp came before that would wear."""
    names = "static_kinetic_friction.slip_scale_mm", "friction_wear.loss", "pressure_dependent_friction.reference_mpa"
    diamond = replace(INPUTS, obj=get_object(14), setup=GraspSetup(max_lift_mm=20.0))
    slopes = simulate((*names, "friction"), diamond).slopes
    for name in names:
        assert np.unique(np.nan_to_num(slopes.by[name].force_n)).tolist() == [0.0]
    assert slopes.by["friction"].peak_n > 1.0
    stalled = simulate(("closed_gap_mm",), with_effect("force_limited_closing", max_force_n=1.2)).slopes
    assert str(stalled.by["closed_gap_mm"].peak_n) == "0.0"


def test_slopes_are_trusted_up_to_the_first_jump(walked) -> None:
    """The sphere slides out of this finger without one; a made-up finger lets go of 6 % and then of all."""
    assert walked[0].slopes.trusted_mm == walked[0].trace.lift_mm[-1]
    lift_mm = np.array([0.0, 0.0, 2.0, 4.0, 4.05, 6.0, 6.04, 8.0])
    pull_n = np.array([0.0, 0.0, 9.0, 10.0, 9.4, 9.0, 0.0, 0.0])
    made_up = SimpleNamespace(lift_mm=lift_mm, force_n=np.outer(pull_n, [0.0, 0.0, 1.0]), n_closing=2)
    assert trace.first_jump_mm(made_up, event_mm=0.04) == 4.05
    pull_n[4] = 9.6
    made_up.force_n = np.outer(pull_n, [0.0, 0.0, 1.0])
    assert trace.first_jump_mm(made_up, event_mm=0.04) == 6.04


def test_copies_stop_where_slopes_are_good_no_longer() -> None:
    """The diamond lets go with a jump; the modulus needs no copy."""
    diamond = replace(INPUTS, obj=get_object(14), setup=GraspSetup(max_lift_mm=60.0))
    result = simulate(("friction", "young_modulus_mpa"), diamond)
    slopes, lift_mm = result.slopes, result.trace.lift_mm
    assert 0.0 < slopes.trusted_mm < lift_mm[-1] - 1.0
    known = np.isfinite(slopes.by["friction"].force_n)
    assert known[lift_mm <= slopes.trusted_mm].all()
    assert not known[lift_mm > slopes.trusted_mm + 1.0].any()
    assert np.isfinite(slopes.by["young_modulus_mpa"].force_n).all()


def test_a_slope_holds_from_its_sample_to_the_next() -> None:
    one, two = np.ones(3), np.full(3, 2.0)
    placed = march._place([(1, {"a": one}), (2, {"a": two, "b": one}), (4, {"a": one, "b": two})], 6)
    assert placed["a"][:5, 0].tolist() == [0.0, 1.0, 2.0, 2.0, 1.0]
    assert placed["b"][:5, 0].tolist() == [0.0, 0.0, 1.0, 1.0, 2.0]
    assert np.isnan(placed["a"][5]).all()
    assert np.isnan(placed["b"][5]).all()


def test_a_trace_effect_has_the_slope_of_what_it_does(walked) -> None:
    by_share = walked[0].slopes.by["stress_relaxation.relaxed_share"]
    relaxed = simulate((), with_effect("stress_relaxation", relaxed_share=0.02))
    assert (relaxed.trace.force_n - walked[0].trace.force_n) / 0.02 == pytest.approx(by_share.force_n, abs=1e-6)


def test_a_peak_that_comes_later_is_as_high_and_a_lag_costs_what_the_load_cell_loses() -> None:
    """The tube's peak is a corner, after which 15 N are lost in a millimetre: its force at one time says nothing."""
    tube = replace(INPUTS, design=BEST_PUBLISHED, obj=get_object(14))
    lag, step_s = "load_cell_lag", 0.02
    slopes = simulate(("lift_misalignment.shift_mm", f"{lag}.time_constant_s"), tube).slopes.by
    assert slopes["lift_misalignment.shift_mm"].peak_n == pytest.approx(0.0, abs=1e-6)
    effect = CATALOGUE[lag].kind(time_constant_s=step_s)
    plain = simulate((), tube)
    seen = effect.modify_trace(plain.trace)
    lost_n = plain.peak_force_n - float(seen.force_n[seen.is_lift].max())
    assert slopes[f"{lag}.time_constant_s"].peak_n == pytest.approx(-lost_n / step_s, rel=0.6)


def test_placement_gets_a_finite_step_that_is_marked(walked) -> None:
    by_height = simulate(("offset_z_mm",)).slopes.by["offset_z_mm"]
    peaks = [simulate((), replace(INPUTS, placement=Placement(offset_z_mm=z_mm))).peak_force_n for z_mm in (-0.5, 0.5)]
    assert by_height.step == 0.5
    assert by_height.peak_n == pytest.approx(peaks[1] - peaks[0])
    assert walked[0].slopes.by["friction"].step is None


def test_two_whole_fingers_have_the_slopes_of_half_a_one(walked) -> None:
    shifted = simulate(("friction", "closed_gap_mm"), replace(INPUTS, placement=Placement(offset_x_mm=1e-5)))
    for name, slope in shifted.slopes.by.items():
        assert slope.peak_n == pytest.approx(walked[0].slopes.by[name].peak_n, rel=0.03)


def test_where_a_jaw_stalls_its_force_counts_and_not_its_stroke() -> None:
    limit = "force_limited_closing.max_force_n"
    stalled = simulate((limit, "closed_gap_mm"), with_effect("force_limited_closing", max_force_n=1.2))
    low, high = (simulate((), with_effect("force_limited_closing", max_force_n=n)) for n in (1.05, 1.38))
    assert stalled.slopes.by["closed_gap_mm"].peak_n == 0.0
    assert stalled.slopes.by[limit].peak_n == pytest.approx((high.peak_force_n - low.peak_force_n) / 0.33, rel=0.05)


def test_a_copy_that_does_not_converge_loses_its_column_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(march, "LOOSE", 0.0)
    result = simulate(("friction", "young_modulus_mpa"))
    assert result.peak_force_n > 1.0
    assert list(result.slopes.by) == ["young_modulus_mpa"]
    assert "does not converge" in result.slopes.lost["friction"]


def test_where_the_mesh_changes_a_finite_step_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace, "build_moved_mesh", lambda *_: None)
    result = simulate(("length_mm", "friction"))
    assert result.slopes.by["length_mm"].step == pytest.approx(0.48)
    assert result.slopes.by["friction"].step is None


def test_a_mesh_of_ones_own_has_no_slopes_of_its_shape() -> None:
    mesh = build_mesh(INPUTS.design, INPUTS.version.mesh)
    result = simulate_grasp(INPUTS.design, INPUTS.obj, mesh=mesh, along=("length_mm", "friction"))
    assert list(result.slopes.by) == ["friction"]
    assert "mesh that was given" in result.slopes.lost["length_mm"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nope", "there is no parameter `nope`; slopes are by material .young_modulus_mpa, friction, .*EFFECT.PARAM"),
        (
            "gap",
            "there is no parameter `gap`; slopes are by .* closing .closed_gap_mm, tip_below_mm., .*wall_offset_mm",
        ),
        ("rib_count", "`rib_count` has no slope; slopes are by .*rib_angle_deg"),
        ("force_limited_closing.max_force_n", "has no slope"),
    ],
)
def test_a_parameter_without_a_slope_is_named_with_those_that_have_one(name: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as refused:
        simulate((name,))
    assert str(refused.value).count("friction") == 1


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("FRICTION", "`friction`"),
        ("frictoin", "`friction`"),
        ("kinetic_ratio", "`static_kinetic_friction.kinetic_ratio`"),
        ("kinetic_ration", "`static_kinetic_friction.kinetic_ratio`"),
        ("friction_wear", "`friction_wear.loss` or `friction_wear.scale_grasps`"),
        ("Offset_mm", "`wall_thickness_offset.offset_mm`"),
    ],
)
def test_a_name_that_is_nearly_right_is_told_the_right_one(name: str, meant: str) -> None:
    with pytest.raises(UsageError) as refused:
        find_parameters(INPUTS, (name,))
    page = "docs/how-to/use-slopes.md has all names."
    assert str(refused.value) == f"there is no parameter `{name}`; did you mean {meant}? {page}"


def test_all_means_the_finger_its_material_and_the_closing() -> None:
    found = find_parameters(INPUTS, ["all"])
    assert {"friction", "nu", "young_modulus_mpa", "width_mm", "closed_gap_mm", "offset_z_mm"} <= set(found)
    assert "wall_offset_mm" in found
    assert len(found) == 14
