"""Which grasps are made, under which number and in which place, after all that can end a batch."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from fast.hardware.own_bench import OwnBench
from fast.hardware.parts.safe_state import Verb
from fast.hardware.station.recorder import GraspInView
from fast.hardware.station.station import MeasuredGrasp
from fast.hardware.virtual.world.file import World
from fast.lake.maintenance import check
from fast.lake.tables.campaign import GraspRow, TraceRow
from fast.models.errors import DeviceError
from fast.models.records import BENCH_FAULT, Trace
from fast.tasks.bench.measure import BenchUse, measure_tool
from fast.tasks.bench.plan import plan_tool
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import ProposedTool
from fast.tasks.scientist.propose import propose_initial
from tests.studies.benchmarks.made_up_batch import Batch, measure_missing

LIFT_MM = np.linspace(0, 10, 11)
FIRST_CELLS = [(4, 0), (4, 1), (7, 0)]


class Killed(BaseException):
    """The process died here."""


class Cell:
    """A bench whose grasps are made up: `force_n` is the peak of the next one; what `faults` names ends otherwise."""

    def __init__(self) -> None:
        self.force_n = 10.0
        self.made: list[tuple[int, int]] = []
        self.faults: dict[tuple[int, int], str] = {}
        self.dies_before: tuple[int, int] | None = None

    def measure_tool(self, slot, plan, setup, on_grasp, should_stop):
        for cell in plan:
            if should_stop():
                return
            if cell == self.dies_before:
                raise Killed
            self.made.append(cell)
            fault = self.faults.get(cell, "")
            on_grasp(self._grasp(cell, fault))
            if fault == BENCH_FAULT:
                raise DeviceError("the line was unplugged")

    def _grasp(self, cell: tuple[int, int], fault: str) -> MeasuredGrasp:
        self.force_n += 1.0
        trace = Trace(LIFT_MM / 5, LIFT_MM, self.force_n * np.sin(np.pi * LIFT_MM / 10))
        status = "failed" if fault else "ok"
        return MeasuredGrasp(*cell, datetime.now(UTC), trace, status, fault, 0.0, {"end": fault or "separated"})


@pytest.fixture
def cell() -> Cell:
    return Cell()


@pytest.fixture
def tool(campaign: Campaign) -> ProposedTool:
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    return campaign.state().tools_of(1)[0]


@pytest.fixture
def measure(campaign: Campaign, cell: Cell, tool: ProposedTool) -> Callable[..., None]:
    """Run the same command again."""

    def run(max_grasps: int = 99) -> None:
        made: list[MeasuredGrasp] = []
        use = BenchUse(None, "w", lambda: len(made) >= max_grasps, lambda tool, grasp: made.append(grasp))
        measure_tool(campaign, cell, plan_tool(campaign, campaign.state(), tool), use)

    return run


class OwnCell(Cell):
    """A driver of the user's own; what `mistakes` names ends in an error that is none of a bench."""

    def __init__(self) -> None:
        super().__init__()
        self.mistakes: set[tuple[int, int]] = set()
        self.asked: list[Verb] = []
        self.present: GraspInView | None = None

    def ask(self, verb: Verb) -> None:
        self.asked.append(verb)

    def present_grasp(self) -> GraspInView | None:
        return self.present

    def _grasp(self, cell: tuple[int, int], fault: str) -> MeasuredGrasp:
        grasp = super()._grasp(cell, fault)
        self.present = GraspInView("", *cell, grasp.started_at, lambda first: grasp.trace)
        if cell in self.mistakes:
            self.mistakes.remove(cell)
            raise ZeroDivisionError("float division by zero")
        return grasp


def rows(campaign: Campaign) -> list[dict]:
    return sorted(campaign.lake.rows(GraspRow), key=lambda row: row["order"])


def assert_once_each(campaign: Campaign, n_failed: int = 0) -> None:
    """Every grasp good once, with its own trace, and places without a double."""
    good = [row for row in rows(campaign) if row["status"] == "ok"]
    assert sorted((row["object_id"], row["repeat"]) for row in good) == [(4, 0), (4, 1), (7, 0), (7, 1)]
    assert len(rows(campaign)) == len(good) + n_failed
    assert len({row["order"] for row in rows(campaign)}) == len(rows(campaign))
    for row in good:
        assert campaign.lake.trace(row["grasp_id"]).force_n.max() == pytest.approx(row["peak_force_n"])
    assert check(campaign.lake) == []


def lose(folder: Path, grasp_id: str) -> None:
    """Set aside the file of a row, as `fast lake check --quarantine` does with a torn one."""
    for path in folder.iterdir():
        if grasp_id.encode() in path.read_bytes():
            path.unlink()


def test_it_goes_on_in_the_planned_order_where_it_stopped(campaign, cell, measure):
    measure(max_grasps=2)
    measure()
    assert cell.made == [*FIRST_CELLS, (7, 1)]
    assert [row["order"] for row in rows(campaign)] == [0, 1, 2, 3]
    measure()
    assert len(cell.made) == 4
    assert_once_each(campaign)


def test_a_process_that_dies_in_a_grasp_leaves_that_grasp_to_be_made(campaign, cell, measure):
    cell.dies_before = (7, 0)
    with pytest.raises(Killed):
        measure()
    cell.dies_before = None
    measure()
    assert_once_each(campaign)
    assert [row["order"] for row in rows(campaign)] == [0, 1, 2, 3]
    assert {row["attempt"] for row in rows(campaign)} == {0}


def test_a_process_that_dies_between_trace_and_row_leaves_one_of_each(campaign, cell, measure, monkeypatch):
    def publish_and_die(temporary, final):
        publish(temporary, final)
        raise Killed

    storage = campaign.lake.storage
    publish = storage.publish
    measure(max_grasps=1)
    with monkeypatch.context() as patch:
        patch.setattr(storage, "publish", publish_and_die)
        with pytest.raises(Killed):
            measure()
    assert len(campaign.lake.ids(TraceRow)) == 2
    assert len(rows(campaign)) == 1
    measure()
    assert cell.made == [(4, 0), (4, 1), (4, 1), (7, 0), (7, 1)]
    assert_once_each(campaign)
    assert [row["order"] for row in rows(campaign)] == [0, 1, 2, 3]


def test_a_grasp_whose_trace_was_set_aside_is_made_again_under_its_number(campaign, cell, tool, measure):
    measure()
    lost = GraspRow.make_id(tool.tool_id, 4, 1)
    lose(campaign.lake.root / "traces", lost)
    assert [finding.kind for finding in check(campaign.lake)] == ["incomplete"]
    measure()
    assert cell.made[4:] == [(4, 1)]
    assert_once_each(campaign)
    assert rows(campaign)[-1]["grasp_id"] == lost
    assert [row["order"] for row in rows(campaign)] == [0, 2, 3, 4], "the lost grasp's place is not given again"
    lose(campaign.lake.root / "traces", lost)
    measure()
    assert [row["order"] for row in rows(campaign)] == [0, 2, 3, 5]


def test_a_lost_row_does_not_give_its_place_to_another(campaign, tool, measure):
    measure(max_grasps=3)
    lose(campaign.lake.root / "grasps", GraspRow.make_id(tool.tool_id, 4, 0))
    measure()
    assert_once_each(campaign)
    assert [row["order"] for row in rows(campaign)] == [1, 2, 3, 4]


def test_a_grasp_that_fails_by_itself_is_given_up_after_its_attempts(campaign, cell, measure):
    cell.faults[7, 0] = "load cell fault"
    for _ in range(4):
        measure()
    failed = [row for row in rows(campaign) if row["status"] == "failed"]
    assert [(row["object_id"], row["repeat"], row["attempt"]) for row in failed] == [(7, 0, 0), (7, 0, 1)]
    assert [row["order"] for row in rows(campaign)] == [0, 1, 2, 3, 4]


def test_a_mistake_of_a_driver_is_kept_as_a_bench_fault_and_the_grasp_is_made_again(campaign, tool):
    driver = OwnCell()
    driver.mistakes.add((7, 0))
    bench = OwnBench("my_press:open_bench", driver)

    def measure() -> None:
        work = plan_tool(campaign, campaign.state(), tool)
        measure_tool(campaign, bench, work, BenchUse(None, "w"))

    with pytest.raises(
        DeviceError, match=r"`my_press:open_bench` failed \(ZeroDivisionError: float division by zero; "
    ):
        measure()
    (failed,) = [row for row in rows(campaign) if row["status"] == "failed"]
    assert ((failed["object_id"], failed["repeat"]), driver.asked) == ((7, 0), [Verb.STOP])
    assert BENCH_FAULT in failed["details_json"]
    measure()
    assert_once_each(campaign, n_failed=1)


def test_faults_of_the_bench_never_give_a_grasp_up(campaign, cell, measure):
    cell.faults[7, 0] = BENCH_FAULT
    for _ in range(4):
        with pytest.raises(DeviceError):
            measure()
    cell.faults.clear()
    measure()
    assert_once_each(campaign, n_failed=4)
    at_fault = [row for row in rows(campaign) if (row["object_id"], row["repeat"]) == (7, 0)]
    assert [row["attempt"] for row in at_fault] == [0, 1, 2, 3, 4]
    assert [row["order"] for row in rows(campaign)] == list(range(8))


def test_a_lost_trace_of_a_later_attempt_is_made_again_under_that_attempt(campaign, cell, tool, measure):
    cell.faults[4, 0] = "load cell fault"
    measure()
    cell.faults.clear()
    measure()
    lose(campaign.lake.root / "traces", GraspRow.make_id(tool.tool_id, 4, 0, 1))
    measure()
    assert_once_each(campaign, n_failed=1)
    assert rows(campaign)[-1]["attempt"] == 1


def test_the_files_of_single_grasps_are_merged_after_each_tool(tmp_path):
    """A file for each grasp would make every look at the lake dearer, until the stage ends."""
    batch = Batch(2, (0, 7), 2)
    campaign, n_files = batch.make(tmp_path), []

    def count(tool: ProposedTool, grasp: MeasuredGrasp) -> None:
        n_files.append(len(list((campaign.lake.root / "grasps").glob("*.parquet"))))

    measure_missing(campaign, World(), count)
    assert n_files == [1, 2, 3, 4, 2, 3, 4, 5]
    assert len(list((campaign.lake.root / "traces").glob("*.parquet"))) == 1
    assert len(rows(campaign)) == 8
    assert check(campaign.lake) == []
