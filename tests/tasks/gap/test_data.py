"""From rows of the lake to what gap discovery works on."""

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, EventRow, GraspRow, TraceRow
from fast.lake.tables.row import Row
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import CENTRE, NUMERICAL, BankPlan, list_versions
from fast.models.gap.data import GapData
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.grasps import Cells
from fast.models.records import Trace
from fast.tasks.gap.bank import list_plan_ids, plan_bank, read_bank
from fast.tasks.gap.data import (
    check_prints,
    check_repeats,
    check_units,
    make_data,
    read_grasps,
    rebuild_contexts,
    split_measurements,
)
from fast.tasks.gap.split import KIND, Split, freeze_split
from tests.synthetic.gap import made_up_gap
from tests.tasks.calibration.trace_lake import PROVENANCE
from tests.tasks.gap.gap_lake import BASE, DESIGNS, OBJECTS, SETUP, bank_rows, gap_lake, measured_rows, plan_rows

CAMPAIGN = "demo"


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return gap_lake(tmp_path_factory.mktemp("gap") / "lake")


def read_data(lake: Lake) -> GapData:
    """The data of a search as it reads them: split first."""
    split, measured = split_measurements(lake, CAMPAIGN, 0), read_grasps(lake, CAMPAIGN)
    return make_data(measured, read_bank(lake, BASE, measured.grasps.cells), split)


def test_the_data_hold_every_grasp_with_its_bank(lake: Lake) -> None:
    data = read_data(lake)
    grasps, bank = data.grasps, data.bank
    assert grasps.tools == tuple(f"demo/B01T{number}" for number in range(len(DESIGNS)))
    assert grasps.objects == OBJECTS
    assert grasps.steps_n.shape == (len(DESIGNS) * len(OBJECTS) * 2, 120)
    assert bank.grid_steps_n.shape == (len(DESIGNS), len(OBJECTS), 12, 120)
    assert bank.numerical_steps_n.shape[2] == len(NUMERICAL)
    assert bank.wider_steps_n.shape[2] == 2
    assert bank.effects["static_kinetic_friction"].steps_n.shape[2] == 4
    assert bank.failed_share == 0.0
    assert check_units(data) == []
    assert 0.03 < grasps.noise.sd_n < 0.07  # 0.05 in the traces
    assert data.held_out_tools.sum() == 2
    assert data.held_out_objects.sum() == 1
    held = data.held_out_tools[grasps.tool] | data.held_out_objects[grasps.obj]
    np.testing.assert_array_equal(data.is_held_out, held)


def test_repeats_that_tell_nothing_of_what_is_slow_are_pointed_out() -> None:
    in_a_row = made_up_gap(3, 3, 0, n_repeats=2).grasps
    (sentence,) = check_repeats(in_a_row)
    assert sentence.startswith("Repeats were made one right after the other")
    rounds = [
        context.model_copy(update={"batch_grasps": 6 * int(tool) + 3 * context.repeat + int(obj)})
        for tool, obj, context in zip(in_a_row.tool, in_a_row.obj, in_a_row.contexts, strict=True)
    ]
    assert check_repeats(replace(in_a_row, contexts=tuple(rounds))) == []
    first = in_a_row.select(np.flatnonzero([context.repeat == 0 for context in in_a_row.contexts]))
    (sentence,) = check_repeats(first)
    assert sentence.startswith("No tool gripped an object twice")


def test_forces_of_the_bank_are_those_of_its_versions(lake: Lake) -> None:
    one = read_bank(lake, BASE, Cells.full(DESIGNS[1:2], OBJECTS, SETUP))
    every = read_bank(lake, BASE, Cells.full(DESIGNS, OBJECTS, SETUP))
    np.testing.assert_array_equal(one.centre_steps_n[0], every.centre_steps_n[1])
    assert one.centre == CENTRE
    assert not np.allclose(
        one.effects["shear_adhesion"].steps_n[0, 0, 0], one.effects["shear_adhesion"].steps_n[0, 0, 1]
    )
    with pytest.raises(UsageError, match="no simulation of the bank"):
        read_bank(lake, BASE, Cells.full(DESIGNS[:1], OBJECTS, SETUP.model_copy(update={"tip_below_mm": 9.0})))


def test_a_failed_simulation_is_missing_and_said(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    versions = list_versions(BASE)
    lake.append(bank_rows(DESIGNS[:1], OBJECTS, fail={(OBJECTS[1], versions[3].version_id)}), PROVENANCE)
    bank = read_bank(lake, BASE, Cells.full(DESIGNS[:1], OBJECTS, SETUP))
    assert np.isnan(bank.grid_steps_n[0, 1, 3]).all()
    assert np.isfinite(bank.grid_steps_n[0, 0]).all()
    n_all = len(OBJECTS) * (len(versions) + 4)  # two placements, two wider gaps
    assert bank.failed_share == pytest.approx(1 / n_all)
    assert len(list_plan_ids(plan_bank(BASE, Cells.full(DESIGNS[:1], OBJECTS, SETUP)))) == n_all
    assert sum(plan.n_grasps for plan in plan_bank(BASE, Cells.full(DESIGNS[:1], OBJECTS, SETUP))) == n_all


def test_a_local_bank_takes_over_what_it_does_not_simulate(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    lake.append(bank_rows(DESIGNS[:1], OBJECTS), PROVENANCE)
    of = (BASE, Cells.full(DESIGNS[:1], OBJECTS, SETUP))
    wide = read_bank(lake, *of)
    at = np.array([9.0, 0.5, 0.4])
    plan, closing = (BankPlan.around(at, at[None, 1:], names) for names in ((), ("pressure_droop",)))
    counts = [sum(one.n_grasps for one in plan_bank(*of, each)) / len(OBJECTS) for each in (plan, closing)]
    assert counts == [5, 7]
    lake.append(plan_rows(plan_bank(*of, closing)), PROVENANCE)
    bank, with_closings = (read_bank(lake, *of, each, wide) for each in (plan, closing))
    assert bank.grid_steps_n.shape[2] == 5
    grows = np.sqrt((bank.centre_steps_n**2).mean(axis=-1) / (wide.centre_steps_n**2).mean(axis=-1))
    change_n = wide.numerical_steps_n - wide.centre_steps_n[:, :, None]
    own_n = bank.numerical_steps_n - bank.centre_steps_n[:, :, None]
    np.testing.assert_allclose(own_n, grows[..., None, None] * change_n, atol=1e-12)
    np.testing.assert_array_equal(with_closings.placed_steps_n, bank.placed_steps_n)
    assert not np.allclose(with_closings.wider_steps_n, bank.wider_steps_n)
    assert bank.failed_share == 0.0


def test_the_split_is_written_once_and_grows_without_changing_sides(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    designs = [f"D{number:02d}" for number in range(20)]
    first = freeze_split(lake, None, designs[:14], range(30), seed=3)
    assert sum(first.designs.values()) == 4
    assert sum(first.objects.values()) == 7
    assert freeze_split(lake, None, designs[:14], range(30), seed=3) == first
    assert freeze_split(lake, None, designs[:14], range(30), seed=4) != first
    more = freeze_split(lake, None, designs, range(36), seed=3)
    assert {key: more.designs[key] for key in first.designs} == first.designs
    assert {key: more.objects[key] for key in first.objects} == first.objects
    assert (sum(more.designs.values()), sum(more.objects.values())) == (6, 8)
    assert len(lake.rows(EventRow, kind=KIND)) == 3
    assert more.split_id != first.split_id == Split(first.designs, first.objects).split_id


def test_held_out_objects_are_of_many_classes(tmp_path: Path) -> None:
    from fast.models.objects.catalogue import get_object

    lake = Lake.open(tmp_path / "lake", create=True)
    split = freeze_split(lake, None, [f"D{number}" for number in range(7)], range(36), seed=0)
    classes = [get_object(object_id).object_class for object_id, held in split.objects.items() if held]
    assert len(set(classes)) >= 6


def test_contexts_follow_the_clock_and_count_failures(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    began = datetime(2026, 1, 5, 9, tzinfo=UTC)
    keys = [("T1", 4, 0, 0), ("T1", 4, 0, 1), ("T0", 4, 0, 0), ("T1", 7, 0, 0), ("T1", 4, 1, 0)]
    rows: list[Row] = []
    for number, (tool, object_id, repeat, attempt) in enumerate(keys):
        row = measured_rows(DESIGNS[0], tool, object_id, repeat, attempt)[1]
        update = {"started_at": began + timedelta(seconds=20 * number), "status": "failed" if number == 0 else "ok"}
        rows.append(row.model_copy(update=update))
    lake.append(rows, PROVENANCE)
    contexts = rebuild_contexts(lake, None)
    last = contexts.of[GraspRow.make_id("T1", 4, 1, 0)]
    assert (last.repeat, last.tool_grasps, last.batch_grasps, last.clock_s) == (2, 3, 4, 80.0)
    assert contexts.warnings == ()


def test_without_times_and_order_a_place_is_guessed_and_said(lake: Lake) -> None:
    contexts = rebuild_contexts(lake, CAMPAIGN)
    assert [sentence.partition(" have ")[0] for sentence in contexts.warnings] == [f"{8 * 6 * 2} grasps"] * 2
    assert contexts.of[GraspRow.make_id("demo/B01T1", OBJECTS[0], 1)].repeat == 1


def _lake_of(root: Path, rows: list[Row]) -> Lake:
    lake = Lake.open(root / "lake", create=True)
    lake.append([*(DesignRow.of(design) for design in DESIGNS), *rows], PROVENANCE)
    return lake


def test_copied_traces_count_once(tmp_path: Path) -> None:
    rows = [row for repeat in range(4) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    trace = rows[0]
    assert isinstance(trace, TraceRow)
    rows[2] = TraceRow.of(GraspRow.make_id("T0", OBJECTS[0], 1), trace.trace)
    measured = read_grasps(_lake_of(tmp_path, rows), None)
    assert len(measured.grasps.grasp_ids) == 3
    assert "1 of 4 grasps have the samples of another grasp; the copies are left out." in measured.warnings


def test_a_trace_that_was_cut_short_is_left_out_and_said(tmp_path: Path) -> None:
    rows = [row for repeat in range(3) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    trace = rows[0]
    assert isinstance(trace, TraceRow)
    whole = trace.trace
    until = whole.lift_mm < 15.0  # of 27
    rows[0] = TraceRow.of(trace.grasp_id, Trace(whole.time_s[until], whole.lift_mm[until], whole.force_n[until]))
    measured = read_grasps(_lake_of(tmp_path, rows), None)
    assert len(measured.grasps.grasp_ids) == 2
    assert "1 of 3 grasps end while the fingers still hold the object; left out." in measured.warnings


def test_readings_far_apart_are_said(tmp_path: Path) -> None:
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    spacing_mm = 2.5
    trace = rows[0]
    assert isinstance(trace, TraceRow)
    whole = trace.trace
    at_mm = np.arange(0.0, whole.lift_mm.max(), spacing_mm)
    lift = whole.is_lift
    sparse = Trace(
        np.interp(at_mm, whole.lift_mm[lift], whole.time_s[lift]),
        at_mm,
        np.interp(at_mm, whole.lift_mm[lift], whole.force_n[lift]),
    )
    rows[0] = TraceRow.of(trace.grasp_id, sparse)
    measured = read_grasps(_lake_of(tmp_path, rows), None)
    assert len(measured.grasps.grasp_ids) == 2
    assert any("1 of 2 grasps have readings more than 1 mm of lift apart" in said for said in measured.warnings)


def test_a_trace_that_begins_within_the_lift_is_left_out_and_said(tmp_path: Path) -> None:
    rows = [row for repeat in range(3) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    for place, first_mm in ((0, 3.0), (2, 0.5)):
        trace = rows[place]
        assert isinstance(trace, TraceRow)
        whole = trace.trace
        kept = whole.lift_mm > first_mm
        late = Trace(whole.time_s[kept], whole.lift_mm[kept], whole.force_n[kept])
        rows[place] = TraceRow.of(trace.grasp_id, late)
    measured = read_grasps(_lake_of(tmp_path, rows), None)
    assert len(measured.grasps.grasp_ids) == 2
    assert "1 of 3 grasps begin after 1 mm of lift; left out." in measured.warnings


def _change_traces(rows: list[Row], change: Callable[[Trace], Trace]) -> list[Row]:
    return [TraceRow.of(row.grasp_id, change(row.trace)) if isinstance(row, TraceRow) else row for row in rows]


def test_a_lift_that_ended_early_or_a_dead_load_cell_is_called_so(tmp_path: Path) -> None:
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    short = _change_traces(
        rows, lambda t: Trace(*(values[t.lift_mm < 5.0] for values in (t.time_s, t.lift_mm, t.force_n)))
    )
    with pytest.raises(
        UsageError, match="none of the 2 .*: 2 of 2 grasps end while .* record the whole lift, until the fingers let go"
    ):
        read_grasps(_lake_of(tmp_path / "short", short), None)
    dead = _change_traces(rows, lambda t: Trace(t.time_s, t.lift_mm, 0.0 * t.force_n))
    with pytest.raises(UsageError, match="2 of 2 grasps have the same force in every reading"):
        read_grasps(_lake_of(tmp_path / "dead", dead), None)


def test_lifts_at_another_speed_than_said_are_pointed_out(tmp_path: Path) -> None:
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    assert not any("speed" in sentence for sentence in read_grasps(_lake_of(tmp_path / "usual", rows), None).warnings)
    fast = _change_traces(rows[:2], lambda t: Trace(t.time_s / 2.0, t.lift_mm, t.force_n))
    sentences = read_grasps(_lake_of(tmp_path / "fast", [*fast, *rows[2:]]), None).warnings
    (sentence,) = (sentence for sentence in sentences if "speed" in sentence)
    assert sentence.startswith("1 of 2 grasps were lifted at another speed than their setup says")
    assert "at 10 mm/s instead of 5" in sentence


def test_a_scale_that_rounds_its_noise_away_takes_it_from_repeats(tmp_path: Path) -> None:
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    rounded = _change_traces(rows, lambda t: Trace(t.time_s, t.lift_mm, np.where(t.lift_mm > 0, t.force_n, 0.3)))
    measured = read_grasps(_lake_of(tmp_path / "rounded", rounded), None)
    assert 0.01 < measured.grasps.noise.sd_n < 0.03
    assert any("or all the same: the noise" in sentence for sentence in measured.warnings)
    without = _change_traces(rows, lambda t: Trace(t.time_s, t.lift_mm, np.sin(t.lift_mm / 20.0)))
    for number, row in enumerate(without):  # copies would be left out
        if isinstance(row, TraceRow):
            trace = row.trace
            without[number] = TraceRow.of(row.grasp_id, Trace(trace.time_s, trace.lift_mm, trace.force_n + number))
    with pytest.raises(UsageError, match="readings have no noise: .* import forces as the load cell reads them"):
        read_grasps(_lake_of(tmp_path / "without", without), None)


def test_traces_that_begin_with_the_lift_take_their_noise_from_repeats(tmp_path: Path) -> None:
    rows: list[Row] = []
    for repeat in range(3):
        trace, row = measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)
        assert isinstance(trace, TraceRow)
        lift = trace.lift_mm > 0
        rows += [TraceRow.of(trace.grasp_id, Trace(trace.time_s[lift], trace.lift_mm[lift], trace.force_n[lift])), row]
    measured = read_grasps(_lake_of(tmp_path, rows), None)
    assert 0.01 < measured.grasps.noise.sd_n < 0.03  # 0.05 N over the square root of 8 readings
    assert any("is taken from repeats" in sentence for sentence in measured.warnings)


def test_a_print_that_is_no_print_of_the_lot_is_said() -> None:
    """A tool of another material is no gap to the search: its modulus is fitted, and was told to nobody."""
    data = made_up_gap(5, 5, 0, n_repeats=2).usable
    grasps = data.grasps
    stiffer_n = grasps.steps_n * np.where(grasps.tool == 2, 1.6, 1.0)[:, None]
    fits = (fit_evidence(Problem.of(data).measured(steps_n)) for steps_n in (grasps.steps_n, stiffer_n))
    alike, odd = (check_prints(fit) for fit in fits)
    assert alike == []
    (sentence,) = odd
    found = re.match(rf"Tool {grasps.tools[2]} is fitted (1\.\d+) times as stiff as the others, ", sentence)
    assert found is not None
    assert 1.3 < float(found[1]) < 1.65


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bench": "real"}, "grasps of 2 benches"),
        ({"design_id": "Dunknown"}, "measured design Dunknown is not in the table"),
        ({"repeat": 0}, "has 1 repeats twice, first repeat 0 of tool T0"),
    ],
)
def test_what_cannot_be_compared_is_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    rows[3] = rows[3].model_copy(update=change)
    with pytest.raises(UsageError, match=message):
        read_grasps(_lake_of(tmp_path, rows), None)


def test_benches_of_two_labs_are_fitted_jointly(tmp_path: Path) -> None:
    rows = [row for repeat in range(2) for row in measured_rows(DESIGNS[0], "T0", OBJECTS[0], repeat)]
    rows[3] = rows[3].model_copy(update={"bench": "real", "repeat": 0, "lab": "delft"})
    measured = read_grasps(_lake_of(tmp_path, rows), None)
    assert len(measured.grasps.grasp_ids) == 2


def test_too_little_is_refused_before_anything_is_simulated(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has no measured grasps"):
        split_measurements(Lake.open(tmp_path / "none", create=True), None, 0)
    few = [row for object_id in OBJECTS for row in measured_rows(DESIGNS[0], "T0", object_id, 0)]
    with pytest.raises(UsageError, match="1 designs were measured, gap discovery needs at least 7"):
        split_measurements(_lake_of(tmp_path, few), None, 0)


@pytest.mark.parametrize(("factor", "said"), [(1 / 9.81, "9.81 is suspected"), (1000.0, "1000"), (0.001, "1000")])
def test_the_unit_of_forces_is_suspected(lake: Lake, factor: float, said: str) -> None:
    data = read_data(lake)
    data = replace(data, grasps=replace(data.grasps, steps_n=factor * data.grasps.steps_n))
    if said == "1000":
        with pytest.raises(UsageError, match="factor of about 1000"):
            check_units(data)
    else:
        assert said in check_units(data)[0]


def test_forces_of_the_other_sign_are_refused(lake: Lake) -> None:
    data = read_data(lake)
    with pytest.raises(UsageError, match="other sign than simulated ones: a force is positive where the object pulls"):
        check_units(replace(data, grasps=replace(data.grasps, steps_n=-data.grasps.steps_n)))
