import numpy as np
import pytest
from pydantic import ValidationError

from fast.hardware.bench import open_virtual_bench
from fast.hardware.cell.diagnostics import NO_OBJECT, DiagnosticPlan, DiagnosticRun
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import Sensor, World
from fast.hardware.virtual.world.state import at_pressure
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.records import EffectValue, GraspSetup
from fast.models.units import force_n_from_kg
from tests.hardware.cell.grasp_stub import holds_to_the_top

WORLD = World(seed=7, sensor=Sensor(noise_sd_n=0.12))
TOOLS = {0: MountedTool("a/B01T0", BEST_PUBLISHED)}
SETUP = GraspSetup()
FLAT = 8  # the flattest object but one, 14 mm: short lifts


def run(kind, repeat=0, **knobs):
    has_object = kind not in ("closed_empty", "dead_weight")
    return DiagnosticRun(kind=kind, object_id=FLAT if has_object else NO_OBJECT, repeat=repeat, **knobs)


def measure(items, hang=True):
    made = []
    with open_virtual_bench(WORLD, TOOLS, holds_to_the_top, wires="memory") as bench:

        def put(mass_kg):
            bench.virtual.state.hung_kg = mass_kg
            bench.clock.sleep(1.0)

        bench.cell.measure_tool(0, items, SETUP, made.append, lambda: False, put if hang else None)
    return made


def closing_s(grasp):
    return grasp.trace.time_s[grasp.trace.lift_mm == 0].max()


def speed_mm_per_s(grasp):
    is_middle = (grasp.trace.lift_mm > 3) & (grasp.trace.lift_mm < 15)
    return np.polyfit(grasp.trace.time_s[is_middle], grasp.trace.lift_mm[is_middle], 1)[0]


def test_every_knob_is_turned_on_the_bench_and_recorded_with_the_grasp():
    items = [
        (FLAT, 0), run("dwell", dwell_s=10.0), run("lift_speed", lift_speed_mm_per_s=20.0),
        run("supply_pressure", supply_pressure_psi=20.0), run("supply_pressure", supply_pressure_psi=40.0),
        run("reference"), run("closed_empty"), run("dead_weight", mass_kg=2.0), (FLAT, 1),
    ]  # fmt: skip
    made = measure(items)
    assert [grasp.status for grasp in made] == ["ok"] * len(items), [grasp.reason for grasp in made]
    first, dwell, fast, low, high, reference, empty, weight, last = made
    assert [grasp.diagnostic for grasp in made] == [None, *items[1:-1], None]
    assert closing_s(dwell) - closing_s(first) == pytest.approx(10.0, abs=0.2)
    assert speed_mm_per_s(fast) == pytest.approx(20.0, rel=0.05)
    assert speed_mm_per_s(last) == pytest.approx(5.0, rel=0.02), "the next grasp is an ordinary one again"
    assert (fast.setup.lift_speed_mm_per_s, last.setup) == (20.0, SETUP)
    assert [grasp.details["supply_pressure_psi"] for grasp in (low, high, reference)] == [20.0, 40.0, 30.0]
    assert [grasp.details["pressure_psi"] for grasp in (low, high, last)] == pytest.approx([20.0, 40.0, 30.0], abs=0.5)
    assert empty.object_id == NO_OBJECT
    assert np.abs(empty.trace.force_n).max() < 1.0
    assert weight.details["dead_weight_n"] == pytest.approx(force_n_from_kg(2.0), abs=0.2)
    is_off = weight.trace.time_s > weight.trace.time_s[-1] - 1.5
    assert weight.trace.force_n[is_off].mean() == pytest.approx(0.0, abs=0.2), "also after it was taken off"


def test_dead_weights_need_somebody_who_hangs_them():
    with pytest.raises(UsageError, match="dead weights, which a person hangs on the gripper"):
        measure([run("dead_weight", mass_kg=2.0)], hang=False)


def test_the_protocol_makes_every_setting_and_shuffles_what_wears():
    plan = DiagnosticPlan(dead_weights_kg=(1.0, 5.0), objects=(2, 14))
    runs = plan.runs(3)
    assert [r.mass_kg for r in runs[:4]] == [1.0, 5.0, 5.0, 1.0], "up and down"
    assert [r.kind for r in runs[4:7]] == ["closed_empty"] * 3
    assert len(runs) == 4 + 3 + 2 * 2 * (4 + 3 + 3)
    assert len({r.model_dump_json() for r in runs}) == len(runs)
    assert plan.runs(3) == runs
    assert plan.runs(4) != runs
    assert sorted(plan.runs(4), key=str) == sorted(runs, key=str)


def test_reference_grasps_keep_their_places_when_a_plan_is_resumed():
    plan = DiagnosticPlan(reference_every=3, reference_object=14)
    cells = [(object_id, 0) for object_id in range(7)]
    items = plan.with_references(cells)
    assert [i for i, item in enumerate(items) if isinstance(item, DiagnosticRun)] == [0, 4, 8]
    assert [item.repeat for item in items if isinstance(item, DiagnosticRun)] == [0, 1, 2]
    assert plan.with_references(cells[4:], 4) == items[items.index((4, 0)) :]
    assert DiagnosticPlan().with_references(cells) == cells


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "dwell"}, "a dwell run needs an object"),
        ({"kind": "closed_empty", "object_id": 3}, "a closed_empty run needs no object"),
        ({"kind": "dead_weight"}, "only a dead weight has a mass"),
        ({"kind": "dwell", "object_id": 3, "mass_kg": 1.0}, "only a dead weight has a mass"),
    ],
)
def test_runs_that_make_no_sense_are_refused(values, message):
    with pytest.raises(ValidationError, match=message):
        DiagnosticRun(**values)


def test_less_pressure_weakens_the_jaws_of_a_world_that_limits_them():
    limited = WORLD.model_copy(
        update={"hidden": (EffectValue(effect="force_limited_closing", parameters={"max_force_n": 60.0}),)}
    )
    assert at_pressure(limited, 2 / 3).hidden[0].parameters["max_force_n"] == pytest.approx(40.0)
    assert at_pressure(limited, 1.0) is limited
    assert at_pressure(WORLD, 0.5) == WORLD
