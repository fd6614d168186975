import pytest

from models.gap.evaluation.next_experiment import SETTINGS, choose_next_experiment, find_confounds
from models.gap.evaluation.power import LEAST_TOOLS, compute_smallest_share, count_tools_needed, write_power_sentence
from models.simulation.effects.catalogue import CATALOGUE


@pytest.mark.parametrize(
    ("effects", "setting"),
    [
        (("load_cell_lag", "object_post_compliance"), "fast lift"),
        (("mullins_softening", "friction_wear"), "rest"),
        (("force_limited_closing", "base_compliance"), "low supply"),
        (("load_cell_offset", "shear_adhesion"), "closed empty"),
        (("wall_thickness_offset", "print_anisotropy"), "callipers"),
    ],
)
def test_sets_fall_apart_by_the_experiment_of_the_notes(effects: tuple[str, ...], setting: str) -> None:
    parameters = {
        "load_cell_offset": {"offset_n": 0.3},
        "wall_thickness_offset": {"offset_mm": 0.1},
        "base_compliance": {"compliance_mm_per_n": 0.02},
    }
    found = choose_next_experiment(effects, parameters)
    assert found is not None
    assert found.setting == setting
    assert set(found.separates) == set(effects)


def test_relaxation_is_told_from_friction_by_waiting() -> None:
    found = choose_next_experiment(
        ("stress_relaxation", "static_kinetic_friction"), {"stress_relaxation": {"relaxed_share": 0.2}}
    )
    assert found is not None
    assert found.setting in {"dwell", "fast lift"}
    assert found.n_grasps >= 6


def test_a_weaker_effect_takes_more_grasps() -> None:
    pair = ("load_cell_lag", "object_post_compliance")
    lift = [s for s in SETTINGS if s.name == "fast lift"]
    few, many = (
        choose_next_experiment(pair, {"load_cell_lag": {"time_constant_s": t}}, settings=lift) for t in (0.2, 0.004)
    )
    assert few is not None
    assert many is not None
    assert many.n_grasps > 4 * few.n_grasps


def test_what_no_setting_tells_apart_gets_no_experiment() -> None:
    assert choose_next_experiment(("rib_imperfection", "hyperelastic_stiffening")) is None
    assert choose_next_experiment(("load_cell_lag",)) is None


def test_effects_at_neutral_change_nothing_under_any_setting() -> None:
    for setting in SETTINGS:
        for effect in setting.responses:
            spec = CATALOGUE[effect]
            if effect not in {"force_limited_closing"}:
                assert setting.respond(effect, spec.neutral.parameters) == pytest.approx(0.0, abs=1e-12), (
                    setting,
                    effect,
                )


def test_aliases_are_declared_with_what_tells() -> None:
    found = {a.effect: a for a in find_confounds({"print_anisotropy": 0.05, "load_cell_lag": 0.9})}
    assert "dead weight" in found["load_cell_gain"].experiment
    assert found["velocity_strengthening_friction"].of.startswith("friction")
    assert "95 %" in found["print_anisotropy"].of
    assert "load_cell_lag" not in found


def test_needs_agree_with_each_other() -> None:
    share = compute_smallest_share(20, 12)
    assert count_tools_needed(share, 12) == pytest.approx(20, abs=1)
    assert count_tools_needed(0.5, 12) == LEAST_TOOLS
    assert compute_smallest_share(8, 14) == pytest.approx(0.15, abs=0.01)  # as seen in made-up worlds
    assert "if it is 15 % of the force or more; one of 5 % takes 39 designs" in write_power_sentence(8, 14)
    assert "takes" not in write_power_sentence(60, 18)
