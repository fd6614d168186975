from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon, box

from fast.hardware.virtual.world.file import World, load_world
from fast.hardware.virtual.world.hidden import HIDDEN_LAWS, build_hidden
from fast.models.design.fin_ray import FinRay
from fast.models.errors import ConfigError
from fast.models.objects.catalogue import OBJECTS
from fast.models.records import EffectValue, Trace

EXAMPLE = """
seed = 7
[theta]                    # hidden truth
young_modulus_mpa = 9.2
friction = 0.62
poisson_ratio = 0.43
[mesh]
edge_mm = 5.0
[scatter]
tool_modulus_sd = 0.04
placement_sd_mm = 0.2
repeat_sd = 0.01
[sensor]
rate_hz = 80
noise_sd_n = 0.12
noise_correlation_s = 0.05
[[hidden]]
effect = "static_kinetic_friction"
kinetic_ratio = 0.7
slip_scale_mm = 1.0
"""
DESIGN = FinRay(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip


def test_the_world_file_of_the_design_document_loads():
    world = load_world(EXAMPLE, "world.toml")
    assert world.theta.young_modulus_mpa == 9.2
    assert world.sensor.noise_sd_n == 0.12
    effect = EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.7, "slip_scale_mm": 1.0})
    assert world.hidden == (effect,)
    assert World.model_validate_json(world.model_dump_json()) == world
    assert load_world("", "empty.toml").hidden == ()


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[3] / "worlds").glob("*.toml")), ids=lambda p: p.stem)
def test_the_worlds_that_ship_load(path):
    world = load_world(path.read_text(), path.name)
    assert build_hidden(world.hidden, tool_seed=1) or path.stem == "plain"


def test_the_world_hash_follows_the_content():
    world = load_world(EXAMPLE, "world.toml")
    assert world.world_hash == load_world(EXAMPLE.replace("# hidden truth", ""), "other.toml").world_hash
    assert world.world_hash != load_world(EXAMPLE.replace("seed = 7", "seed = 8"), "world.toml").world_hash


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("static_kinetic_friction", "static_kinetic_fricton", "fricton`; did you mean `static_kinetic_friction`"),
        ("kinetic_ratio", "kinetik_ratio", "no parameter `kinetik_ratio`; did you mean `kinetic_ratio`"),
        ("kinetic_ratio = 0.7", "", "needs `kinetic_ratio`; add it"),
        ("kinetic_ratio = 0.7", "kinetic_ratio = 70", "is 70, it must be from 0.05 to 5"),
        ("kinetic_ratio = 0.7", "kinetic_ratio = nan", "must be a finite number"),
        ("kinetic_ratio = 0.7", 'kinetic_ratio = "much"', "must be a finite number"),
        ('effect = "static_kinetic_friction"', "", "has no effect"),
        ("[[hidden]]", "[hidden]", "write it as"),
        ("friction = 0.62", "frictoin = 0.62", "did you mean `friction`"),
        ("rate_hz = 80", "rate_hz = -1", "`sensor.rate_hz` is -1 Hz, it must be at least 5"),
        ("seed = 7", "seed = ", "is not TOML"),
    ],
)
def test_a_wrong_world_file_is_one_sentence(old, new, message):
    assert old in EXAMPLE
    with pytest.raises(ConfigError, match=f"^(world.toml|world file `world.toml`).*{message}"):
        load_world(EXAMPLE.replace(old, new, 1), "world.toml")


def test_a_world_built_in_code_checks_its_hidden_effects_too():
    with pytest.raises(ConfigError, match="unknown hidden effect"):
        World(hidden=(EffectValue(effect="magic"),))


def build(effect, **parameters):
    return build_hidden([EffectValue(effect=effect, parameters=parameters)], tool_seed=3)[0]


def test_friction_starts_static_and_ends_kinetic():
    law = build("static_kinetic_friction", kinetic_ratio=0.7, slip_scale_mm=2.0)
    factor = law.friction_factor(np.array([0.0, 2.0, 1e6]), np.zeros(3))
    assert factor == pytest.approx([1.0, 0.85, 0.7])
    neutral = build("static_kinetic_friction", kinetic_ratio=1.0, slip_scale_mm=2.0)
    assert neutral.friction_factor(np.array([0.0, 5.0]), np.zeros(2)) == pytest.approx([1.0, 1.0])


def test_dilation_thickens_walls_into_the_cavity_and_keeps_the_outside():
    profile = Polygon(box(0, 3, 30, 113).exterior, [box(3, 10, 27, 50).exterior, box(3, 52, 27, 90).exterior])
    law = build("wall_thickness_offset", offset_mm=0.1)
    thick = law.modify_profile(profile, DESIGN)
    thin = build("wall_thickness_offset", offset_mm=-0.1).modify_profile(profile, DESIGN)
    assert thick.exterior.equals(profile.exterior)
    assert thick.area > profile.area > thin.area
    x_low, z_low, x_high, z_high = Polygon(thick.interiors[0]).bounds
    assert x_low - 3 == pytest.approx(27 - x_high)
    assert 0.05 < x_low - 3 < 0.15, "0.1 mm with a tool's scatter"
    assert z_low - 10 == pytest.approx(0.3 * (x_low - 3)), "ribs grow less"
    assert build("wall_thickness_offset", offset_mm=0.0).modify_profile(profile, DESIGN) is profile


def ramp(n=401):
    time_s = np.linspace(0, 4, n)
    return Trace(time_s, 5 * time_s, 3.0 * time_s)


def test_lag_delays_a_ramp_by_its_time_constant_and_keeps_a_constant():
    trace = ramp()
    lagged = build("load_cell_lag", time_constant_s=0.4).modify_trace(trace)
    late = trace.time_s > 1.0
    assert lagged.force_n[late] == pytest.approx(trace.force_n[late] - 3.0 * 0.4, abs=1e-9)
    flat = Trace(trace.time_s, trace.lift_mm, np.full(401, 2.0))
    assert build("load_cell_lag", time_constant_s=0.4).modify_trace(flat).force_n == pytest.approx(flat.force_n)
    assert build("load_cell_lag", time_constant_s=0.0).modify_trace(trace) is trace


def test_lag_clips_a_narrow_peak():
    time_s = np.linspace(0, 4, 401)
    peak = Trace(time_s, time_s, np.exp(-(((time_s - 2) / 0.1) ** 2)))
    assert build("load_cell_lag", time_constant_s=0.3).modify_trace(peak).force_n.max() < 0.5


def test_a_post_tilts_more_under_a_taller_object_and_stiffens():
    low, tall = (min(OBJECTS, key=lambda o: o.height_mm), max(OBJECTS, key=lambda o: o.height_mm))
    yielding_mm = {}
    for obj in (low, tall):
        law = build("object_post_compliance", compliance_mm_per_n=0.05)
        assert law.modify_object(obj) is obj
        trace = ramp()
        seen = law.modify_trace(trace)
        assert np.array_equal(seen.force_n, trace.force_n)
        yielding_mm[obj.object_id] = (seen.lift_mm - trace.lift_mm) / obj.height_mm
        assert seen.time_s - trace.time_s == pytest.approx((seen.lift_mm - trace.lift_mm) / 5.0)
    np.testing.assert_allclose(yielding_mm[low.object_id], yielding_mm[tall.object_id], atol=1e-12)
    assert yielding_mm[tall.object_id][-1] * tall.height_mm == pytest.approx(0.05 * tall.height_mm / 40 * 12 / 1.3)
    rigid = build("object_post_compliance", compliance_mm_per_n=0.0)
    assert rigid.modify_trace(trace) is trace


def test_an_object_on_a_post_springs_past_a_fall_of_the_force():
    lift_mm = np.linspace(0.0, 20.0, 201)
    falling = Trace(lift_mm / 5, lift_mm, np.where(lift_mm < 10.0, lift_mm, np.maximum(110.0 - 10.0 * lift_mm, 0.0)))
    seen = build("object_post_compliance", compliance_mm_per_n=0.4).modify_trace(falling)
    assert np.all(np.diff(seen.lift_mm) > 0)
    assert np.all(np.diff(seen.time_s) > 0)
    assert len(seen.lift_mm) < len(falling.lift_mm)
    assert seen.force_n.max() == falling.force_n.max(), "the peak stays"


def test_gain_error_is_largest_at_low_load():
    law = build("load_cell_gain", gain=1.05)
    trace = ramp()
    ratio = law.modify_trace(trace).force_n[1:] / trace.force_n[1:]
    assert ratio[0] == pytest.approx(1.05, abs=1e-3)
    assert np.all(np.diff(ratio) < 0)
    assert build("load_cell_gain", gain=1.0).modify_trace(trace).force_n == pytest.approx(trace.force_n)


def test_hidden_laws_share_the_parameter_names_of_the_world_file():
    assert set(HIDDEN_LAWS["static_kinetic_friction"].limits) == {"kinetic_ratio", "slip_scale_mm"}
    assert set(HIDDEN_LAWS["wall_thickness_offset"].limits) == {"offset_mm"}
    assert set(HIDDEN_LAWS["load_cell_gain"].limits) == {"gain"}
    assert set(HIDDEN_LAWS["load_cell_lag"].limits) == {"time_constant_s"}
