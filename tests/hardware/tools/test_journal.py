import errno
import itertools
import json
import os
import re

import pytest

from fast.hardware.tools.journal import Journal, Transaction
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.tools.status import HeadSensors, WayOn, judge
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import DeviceError

TOOLS = {slot: MountedTool(f"a/B01T{slot}", BEST_PUBLISHED) for slot in (0, 3, 5)}


def write_pick(journal, n_steps=2):
    journal.begin("pick", 3, "a/B01T3")
    for name in ("over_slot", "weighed_free")[:n_steps]:
        journal.step(name, **({"free_n": 8.25} if name == "weighed_free" else {}))


def test_a_new_journal_finds_what_the_last_one_wrote(tmp_path):
    path = tmp_path / "bench.journal.jsonl"
    write_pick(Journal(path))
    found = Journal(path).open
    assert found == Transaction("pick", 3, "a/B01T3", ("over_slot", "weighed_free"), {"free_n": 8.25})
    Journal(path).close("done")
    again = Journal(path)
    assert again.open is None
    assert again.last.slot_on_head == 3
    again.begin("dock", 3, "a/B01T3")
    again.close("done")
    assert Journal(path).last.slot_on_head is None
    assert Journal(path).last.values["free_n"] == 8.25, "the empty head's weight is kept for the next pick"


@pytest.mark.parametrize("n_lost", [1, 5, 30])
def test_a_torn_line_counts_as_not_written_and_is_cut(tmp_path, n_lost):
    path = tmp_path / "journal"
    write_pick(Journal(path))
    data = path.read_bytes()
    path.write_bytes(data[:-n_lost])
    journal = Journal(path)
    assert journal.open.steps == ("over_slot",)
    journal.step("weighed_free", free_n=8.5)
    assert Journal(path).open.values == {"free_n": 8.5}
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_a_broken_line_in_the_middle_is_an_error_not_a_guess(tmp_path):
    path = tmp_path / "journal"
    path.write_text('{"verb": "pick", "slot"\n{"end": "done"}\n')
    with pytest.raises(DeviceError, match=r"journal `.*` cannot be read .* must come from a person"):
        Journal(path)


def test_a_journal_that_cannot_be_written_stops_before_anything_moves(tmp_path, monkeypatch):
    def full(_file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    journal = Journal(tmp_path / "journal")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DeviceError, match="No space left.*: the tool changer does not move without it"):
        journal.begin("pick", 3, "a/B01T3")
    assert journal.last is None


def test_a_large_journal_starts_anew_and_keeps_where_the_tool_is(tmp_path, monkeypatch):
    path = tmp_path / "journal"
    journal = Journal(path)
    write_pick(journal)
    journal.close("done")
    monkeypatch.setattr("fast.hardware.tools.journal._LARGEST_BYTES", 100)
    anew = Journal(path)
    assert anew.last.slot_on_head == 3
    assert anew.last.values["free_n"] == 8.25
    assert len(path.read_text().splitlines()) == 1
    assert (tmp_path / "journal.old").exists()


def transactions():
    yield None
    for verb, slot, end in itertools.product(("pick", "dock"), (3, 5), (None, "done", "undone")):
        yield Transaction(verb, slot, f"a/B01T{slot}", end=end)
    for slot in (None, 3, 5):
        yield Transaction("told", slot, "", end="done")


def sensors():
    full = [(0, 3, 5), (0, 5), (0, 3), (0,), (), (0, 3, 5, 7)]
    for bits in itertools.product((False, True), repeat=3):
        for slots in full:
            yield HeadSensors(*bits, slots)


def test_every_case_has_one_way_on_and_none_of_them_is_unsafe():
    n = 0
    for last, seen in itertools.product(transactions(), sensors()):
        status = judge(last, seen, TOOLS)
        n += 1
        assert status.sentence.endswith(".")
        empty = set(TOOLS) - set(seen.full_slots)
        if status.way in (WayOn.FINISH_PICK, WayOn.FINISH_DOCK) or status.slot is not None:
            assert (seen.is_tool_present, seen.is_lock_closed) == (True, True), "only a locked tool is carried"
            assert empty == {status.slot}
        if status.way in (WayOn.UNDO_PICK, WayOn.CLOSE_DOCK):
            assert not seen.is_tool_present
            assert last.slot not in empty, "the tool is where the journal says"
        if last is not None and last.end is None and status.is_clear:
            assert status.way is not WayOn.NONE, "an open transaction is ended"
        if last is not None and last.end is not None and status.is_clear:
            assert status.way is WayOn.NONE
            assert status.slot == last.slot_on_head
    assert n == 16 * 48


@pytest.mark.parametrize(
    ("last", "seen", "sentence"),
    [
        (None, HeadSensors(True, False, True, (0, 5)), "the lock is not closed: it may fall"),
        (None, HeadSensors(True, True, False, (0,)), r"2 slots of the tool table are empty \(\[3, 5\]\)"),
        (None, HeadSensors(False, True, False, (0, 3, 5)), "The lock is closed on an empty head"),
        (
            Transaction("pick", 3, "a/B01T3"), HeadSensors(True, True, False, (0, 3)),
            "The pick of slot 3 was interrupted, but slot 5 is the empty one",
        ),
        (
            Transaction("dock", 3, "a/B01T3"), HeadSensors(False, False, True, (0, 5)),
            "the tool is neither on the head nor there",
        ),
        (
            Transaction("pick", 3, "a/B01T3", end="done"), HeadSensors(False, False, True, (0, 3, 5)),
            "was on the head when the journal ended, now it is in slot 3",
        ),
        (
            Transaction("dock", 3, "a/B01T3", end="done"), HeadSensors(True, True, False, (0, 5)),
            "The head carried no tool when the journal ended, now slot 3 is empty",
        ),
    ],
)  # fmt: skip
def test_a_person_is_asked_where_they_disagree(last, seen, sentence):
    status = judge(last, seen, TOOLS)
    assert status.way is WayOn.ASK_PERSON
    assert re.search(sentence, status.sentence)
