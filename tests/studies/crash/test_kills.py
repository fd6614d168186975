"""A batch killed at random moments and continued; and a judge that finds what is wrong, from the content."""

import shutil
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from fast.lake.tables.campaign import GraspRow, TraceRow
from fast.models.errors import InterlockError
from fast.models.records import BENCH_FAULT, Trace
from fast.tasks.campaign.campaign import Campaign
from tests.studies.benchmarks.fingerprints import PLATEAUS_MM, fingerprint_world
from tests.studies.benchmarks.made_up_batch import Batch, lockstep_bench, measure_missing
from tests.studies.crash.kill_judge import Told, judge
from tests.studies.crash.kills import batch_of_about, kill_and_continue, kill_often, kill_outside
from tests.studies.crash.labels import SparseTraceError, label_problem, read_fingerprint

BATCH = Batch(n_tools=2, object_ids=(3, 29), n_repeats=2)
WORLD = fingerprint_world(BATCH.labels)


@pytest.mark.study
@pytest.mark.parametrize("n_kills", [12, 200])
@pytest.mark.timeout(1800)
def test_a_batch_killed_at_random_moments_is_complete_and_rightly_labelled(tmp_path, n_kills):
    batch = batch_of_about(n_kills)
    found = kill_and_continue(tmp_path, batch, kill_often, n_kills)
    assert found.problems == []
    assert found.row["kills"] > n_kills / 2  # a fast machine may finish the batch before the last of them
    assert found.row["grasps"] == len(batch.labels)


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_a_host_and_its_devices_may_die_apart(tmp_path):
    found = kill_and_continue(tmp_path, batch_of_about(16), kill_outside, 8)
    assert found.problems == []
    assert found.row["kills"] > 4


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake with a whole batch, made in two lives."""
    folder = tmp_path_factory.mktemp("batch")
    campaign, told, made = BATCH.make(folder / "lake"), Told(folder / "told.txt"), []
    told.tell("begun")
    measure_missing(campaign, WORLD, lambda *grasp: made.append(grasp), lambda: len(made) >= 3)
    measure_missing(campaign, WORLD, lambda *grasp: made.append(grasp))
    campaign.lake.close()
    return folder


@pytest.fixture
def campaign(measured, tmp_path) -> Campaign:
    """A copy of it to spoil."""
    shutil.copytree(measured, tmp_path / "copy")
    return BATCH.open(tmp_path / "copy" / "lake")


def problems(campaign: Campaign) -> list[str]:
    root = campaign.lake.root
    return judge(root, BATCH, WORLD, Told(root.parent / "told.txt")).problems


def grasp(campaign: Campaign, place: int) -> GraspRow:
    return next(row for row in campaign.lake.records(GraspRow) if row.order == place)


def store(campaign: Campaign, row: GraspRow, trace: Trace) -> None:
    campaign.lake.append([TraceRow.of(row.grasp_id, trace), row], campaign.provenance())


def test_a_batch_in_two_lives_is_as_it_must_be(campaign):
    assert problems(campaign) == []


def test_a_trace_under_another_label_is_found_by_its_content(campaign):
    first, other = grasp(campaign, 0), grasp(campaign, 1)
    store(campaign, first, campaign.lake.trace(other.grasp_id))
    found = " ".join(problems(campaign))
    assert f"('{first.tool_id}', {first.object_id}, {first.repeat}) holds another repeat" in found
    assert "has the peak of another trace" in found
    assert "2 grasps were written" not in found


@pytest.mark.parametrize("place", [2, 4])  # another object; another tool
def test_every_part_of_a_label_is_told_from_the_force(campaign, place):
    trace = campaign.lake.trace(grasp(campaign, place).grasp_id)
    right, wrong = grasp(campaign, place), grasp(campaign, 0)
    assert label_problem(WORLD, (right.tool_id, right.object_id, right.repeat), trace) == ""
    assert "holds a grasp of slot" in label_problem(WORLD, (wrong.tool_id, wrong.object_id, wrong.repeat), trace)


def test_half_a_trace_shows_no_fingerprint(campaign):
    trace = campaign.lake.trace(grasp(campaign, 0).grasp_id)
    half = replace(trace, time_s=trace.time_s[:400], lift_mm=trace.lift_mm[:400], force_n=trace.force_n[:400])
    with pytest.raises(ValueError, match="three plateaus"):
        read_fingerprint(half)


def test_a_place_given_twice_and_a_grasp_made_twice_are_found(campaign):
    row = grasp(campaign, 3)
    again = row.model_copy(
        update={"grasp_id": GraspRow.make_id(row.tool_id, row.object_id, row.repeat, 1), "attempt": 1}
    )
    store(campaign, again, campaign.lake.trace(row.grasp_id))
    found = " ".join(problems(campaign))
    assert "the places of the grasps are" in found
    assert "is there 2 times" in found


def test_a_grasp_written_again_is_found_though_it_replaces_itself(campaign):
    row = grasp(campaign, 3)
    campaign.lake.append([row.model_copy(update={"tare_force_n": 1.0})], campaign.provenance())
    assert "grasps were written for 8" in " ".join(problems(campaign))


def test_a_missing_grasp_is_found(campaign):
    lost = grasp(campaign, 5).grasp_id
    for path in (campaign.lake.root / "grasps").iterdir():
        if lost in pq.read_table(path, columns=["grasp_id"])["grasp_id"].to_pylist():
            path.unlink()
    found = " ".join(problems(campaign))
    assert "is missing" in found
    assert "planned order" in found


def test_an_emergency_stop_in_a_lift_costs_that_attempt_and_not_the_grasp(tmp_path):
    """What was recorded until then is kept; the same command measures the grasp again."""

    @contextmanager
    def pressed_in_the_third_lift(mounted):
        def press(now_s: float) -> None:
            if len(made) == 2 and bench.virtual.state.grasp_force_n() > 5.0:
                bench.virtual.state.inject("estop_pressed")

        with lockstep_bench(WORLD, mounted) as bench:
            bench.clock.add_listener(press)
            yield bench

    campaign, made = BATCH.make(tmp_path / "lake"), []
    with pytest.raises(InterlockError, match="emergency stop"):
        measure_missing(campaign, WORLD, lambda *one: made.append(one), open_bench=pressed_in_the_third_lift)
    cut_short = campaign.lake.records(GraspRow)[-1]
    assert (cut_short.order, cut_short.status) == (2, "failed")
    assert BENCH_FAULT in cut_short.details_json
    assert len(campaign.lake.trace(cut_short.grasp_id).force_n) > 50
    measure_missing(campaign, WORLD, lambda *_: None)
    Told(tmp_path / "told.txt").tell("begun")
    found = judge(tmp_path / "lake", BATCH, WORLD, Told(tmp_path / "told.txt"))
    assert found.problems == []
    assert (found.row["grasps"], found.row["cut_short_and_kept"]) == (8, 1)


def test_a_lift_with_few_readings_is_not_judged_but_counted(campaign):
    row = grasp(campaign, 0)
    trace = campaign.lake.trace(row.grasp_id)
    low_mm, high_mm = PLATEAUS_MM[1]
    kept = ~((trace.lift_mm > low_mm) & (trace.lift_mm < high_mm))
    thin = replace(trace, time_s=trace.time_s[kept], lift_mm=trace.lift_mm[kept], force_n=trace.force_n[kept])
    with pytest.raises(SparseTraceError, match="the host was too busy"):
        read_fingerprint(thin)
    store(campaign, row, thin)
    root = campaign.lake.root
    found = judge(root, BATCH, WORLD, Told(root.parent / "told.txt"))
    assert found.row["too_sparse_to_judge"] == 1
    assert not [problem for problem in found.problems if "plateau" in problem]
