"""What people leave out of a running plan: none of it is begun any more, what was measured stays."""

import pytest

from fast.flows.campaign.progress import count_work
from fast.hardware.virtual.world.file import World
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.models.errors import UsageError
from fast.tasks.bench.leave_out import leave_out, read_part
from fast.tasks.bench.plan import plan_tool
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.left_out import LeftOut, LeftOuts, Part
from fast.tasks.campaign.state import rank_tools
from fast.tasks.scientist.observe import unfinished_tools
from fast.tasks.scientist.propose import propose_initial
from tests.studies.benchmarks.made_up_batch import measure_missing


@pytest.fixture
def printed(campaign):
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    return campaign


def made(campaign):
    rows = sorted(campaign.lake.rows(GraspRow), key=lambda row: row["order"])
    return [(row["tool_id"].rpartition("T")[2], row["object_id"], row["repeat"]) for row in rows]


class Killed(BaseException):
    """The process died here."""


def measure(campaign, on_grasp=lambda *_: None):
    """The same command again, on the virtual gantry; returns the grasps that it made."""
    before = len(made(campaign))
    measure_missing(campaign, World(seed=1), on_grasp)
    return made(campaign)[before:]


def test_an_object_that_is_left_out_while_a_tool_is_measured_is_passed_over_by_all(printed):
    first = plan_tool(printed, printed.state(), printed.state().tools_of(1)[0]).items[0][0]
    other = next(object_id for object_id in printed.object_ids if object_id != first)
    said = []

    def leave_other_out(tool, grasp):
        if not said:
            said.append(leave_out(printed, read_part(printed, object_id=other), "mount broke", "ada"))
            assert count_work(printed, printed.state()).grasps_total == whole - n_other
            raise Killed

    whole = count_work(printed, printed.state()).grasps_total
    n_tools = len(printed.state().tools_of(1))
    n_other = whole // len(printed.object_ids)
    with pytest.raises(Killed):
        measure(printed, leave_other_out)
    assert said[0].endswith("is left out: no grasp is begun with it any more; what was measured stays.")
    measure(printed)
    assert {cell[1] for cell in made(printed)} == {first}
    assert len(made(printed)) == n_tools * printed.config.objects.repeats
    assert unfinished_tools(printed, printed.state(), 1) == []
    leave_out(printed, read_part(printed, object_id=other), "", "ada", is_out=False)
    assert {cell[1] for cell in measure(printed)} == {other}


def test_the_tool_on_the_head_is_hung_back_when_it_is_left_out(printed):
    def leave_tool_out(tool, grasp):
        if tool.slot == 0:
            leave_out(printed, read_part(printed, "B01T0"), "tip torn", "ada")

    tools = [cell[0] for cell in measure(printed, leave_tool_out)]
    assert tools == ["0", *["1"] * 4]
    assert count_work(printed, printed.state()).grasps_done == 5
    assert not printed.state().is_to_be_had(printed.state().tools_of(1)[0])
    assert rank_tools(printed.lake, "small")[-1]["tool_id"] == "small/B01T0"  # what was measured counts


def test_one_grasp_is_given_up_and_a_batch_is_ended(printed):
    plan = plan_tool(printed, printed.state(), printed.state().tools_of(1)[0]).items
    (first_object, first_repeat), last = plan[0], plan[-1]
    leave_out(printed, read_part(printed, "B01T0", first_object, first_repeat), "slips each time", "ada")

    def end_batch(tool, grasp):
        if (grasp.object_id, grasp.repeat) == last:
            leave_out(printed, read_part(printed, batch=1), "the plastic is used up", "grace")

    assert [cell[1:] for cell in measure(printed, end_batch)] == list(plan[1:])
    assert unfinished_tools(printed, printed.state(), 1) == []
    messages = [row.message for row in printed.lake.records(EventRow, kind="left_out")]
    assert messages[1] == "grace left out the rest of B01: the plastic is used up"


def test_an_object_stays_out_of_later_batches_until_it_is_put_back():
    def word(batch, is_out, object_id=4):
        return LeftOut(part=Part(batch=batch, object_id=object_id), is_out=is_out, reason="x", operator="ada")

    words = LeftOuts((word(2, True), word(2, True, 7), word(4, False)))
    assert [words.objects(batch) for batch in (1, 2, 3, 4)] == [set(), {4, 7}, {4, 7}, {7}]
    assert words.covers(3, 9, (4, 0))
    assert not words.covers(4, 9, (4, 0))


def test_what_cannot_be_left_out_is_refused_in_a_sentence(campaign):
    propose_initial(campaign)
    for part, words in (
        ({"tool": "B01T0"}, "nobody has confirmed a tool `B01T0`"),
        ({"tool": "B02T0"}, "batch 2 is not proposed yet"),
        ({"object_id": 30}, r"has no cube \(30\)"),
        ({"tool": "T0"}, "write it like B01T3"),
        ({"object_id": 4, "repeat": 0}, "name both"),
    ):
        with pytest.raises(UsageError, match=words):
            leave_out(campaign, read_part(campaign, **part), "why", "ada")
    part = read_part(campaign, object_id=4)
    with pytest.raises(UsageError, match="say why"):
        leave_out(campaign, part, " ", "ada")
    with pytest.raises(UsageError, match="is not left out"):
        leave_out(campaign, part, "", "ada", is_out=False)
    leave_out(campaign, part, "mount broke", "ada")
    with pytest.raises(UsageError, match=r"left out already, by ada \(mount broke\)"):
        leave_out(campaign, part, "again", "grace")
    assert len(campaign.lake.rows(EventRow, kind="left_out")) == 1
