"""Which row counts is decided by the lake, whatever the clocks of its writers say."""

import subprocess
import sys
from datetime import datetime, timedelta

import pyarrow.parquet as pq
import pytest

from fast.lake.maintenance import compact
from fast.lake.order import LogicalClock
from fast.lake.provenance import Provenance
from fast.lake.storage.files import number_of, older_copies
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import LakeError

PROVENANCE = Provenance(code_version="x", code_dirty=False)
_OTHER_HOST = """
import sys, datetime as standard
from pathlib import Path
class Wrong(standard.datetime):
    @classmethod
    def now(cls, tz=None):
        return standard.datetime.now(tz) + standard.timedelta(hours=float(sys.argv[2]))
import fast.lake.provenance
fast.lake.provenance.datetime = Wrong
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
row = EventRow(event_id="E1", campaign_id="c", kind="k", message=sys.argv[3])
Lake.open(Path(sys.argv[1])).append([row], fast.lake.provenance.Provenance(code_version="x", code_dirty=False))
"""


class Clock(datetime):
    """A clock that can be set."""

    off = timedelta(0)

    @classmethod
    def now(cls, tz=None):
        """The time that this clock shows."""
        return datetime.now(tz) + cls.off


@pytest.fixture
def clock(monkeypatch):
    monkeypatch.setattr("fast.lake.provenance.datetime", Clock)
    monkeypatch.setattr(Clock, "off", timedelta(0))
    return Clock


def event(message):
    return EventRow(event_id="E1", campaign_id="c", kind="k", message=message)


def messages(lake):
    """What a reader sees that was open, one that opens now, and a copied connection."""
    seen = {row["message"] for reader in (lake, Lake.open(lake.root)) for row in reader.rows(EventRow)}
    return seen | {text for (text,) in lake.connect().execute("SELECT message FROM events").fetchall()}


@pytest.mark.parametrize("hours", [-24, -1, 1, 24])
def test_a_row_of_a_writer_with_a_wrong_clock_is_seen(lake, clock, hours):
    lake.append([event("first")], PROVENANCE)
    assert messages(lake) == {"first"}
    clock.off = timedelta(hours=hours)
    Lake.open(lake.root).append([event("second")], PROVENANCE)
    assert messages(lake) == {"second"}
    clock.off = timedelta(0)
    lake.append([event("third")], PROVENANCE)
    assert messages(lake) == {"third"}


def test_two_writers_whose_clocks_leap_take_turns_and_compaction_keeps_their_order(lake, clock):
    other = Lake.open(lake.root)
    for turn, hours in enumerate((0, 24, -24, 1000, -1, 0, 7)):
        clock.off = timedelta(hours=hours)
        (lake, other)[turn % 2].append([event(str(turn))], PROVENANCE)
        assert messages(lake) == messages(other) == {str(turn)}
        if turn % 3 == 2:
            compact(lake, EventRow)
            assert messages(lake) == messages(other) == {str(turn)}
    times = [row["created_at"] for row in lake.query("SELECT * FROM raw_events ORDER BY sequence").to_pylist()]
    assert times != sorted(times)


@pytest.mark.parametrize("hours", [-24, 24])
def test_a_row_of_another_process_with_a_wrong_clock_is_seen(lake, hours):
    for turn, off_hours in (("first", 0), ("second", hours)):
        subprocess.run([sys.executable, "-c", _OTHER_HOST, lake.root, str(off_hours), turn], check=True)
    assert messages(lake) == {"second"}
    lake.append([event("third")], PROVENANCE)
    assert messages(lake) == {"third"}


def test_whoever_has_read_a_row_of_one_table_comes_after_it_in_every_other(lake, monkeypatch, small_rows):
    """As another process would, which has given no number yet."""
    for number in range(5):
        lake.append([event(str(number))], PROVENANCE)
    monkeypatch.setattr("fast.lake.order.CLOCK", own := LogicalClock())
    monkeypatch.setattr("fast.lake.store.CLOCK", own)
    monkeypatch.setattr("fast.lake.query.engine.CLOCK", own)
    other = Lake.open(lake.root)
    seen = other.rows(EventRow)[0]["sequence"]
    other.append(small_rows[:1], PROVENANCE)
    assert other.rows(type(small_rows[0]))[0]["sequence"] > seen


def test_rows_of_programs_without_numbers_keep_their_order_and_come_first(lake, clock):
    """Files as version 0.1 wrote them: no column, another name; the later time counts."""
    for number, hours in enumerate((0, 2, 1)):
        clock.off = timedelta(hours=hours)
        lake.append([event(f"old {number}")], PROVENANCE)
    for number, path in enumerate(sorted((lake.root / "events").glob("rows-*"))):
        pq.write_table(pq.read_table(path).drop_columns(["sequence"]), path.with_name(f"rows-{number:024x}.parquet"))
        path.unlink()
    assert messages(lake) == {"old 1"}
    compact(lake, EventRow)
    assert messages(lake) == {"old 1"}
    clock.off = timedelta(days=-1)
    lake.append([event("new")], PROVENANCE)
    assert messages(lake) == {"new"}
    assert lake.query("SELECT count(*) AS n FROM raw_events").to_pylist() == [{"n": 4}]


def test_numbers_grow_over_all_that_was_seen():
    clock = LogicalClock()
    first = clock.next()
    clock.see(["rows-0000000000ff-0123456789abcdef01234567.parquet", "rows-0123456789abcdef01234567.parquet", "other"])
    assert (first, clock.next(), clock.next()) == (1, 256, 257)
    clock.see([])
    assert clock.next() == 258


def test_names_tell_numbers_and_copies():
    new, old = "rows-00000000000a-0123456789abcdef01234567.parquet", "rows-0123456789abcdef01234567.parquet"
    assert (number_of(new), number_of(old), number_of("x")) == (10, 0, 0)
    again = new.replace("a-", "b-")
    assert older_copies(again, [new, old, again, "rows-00000000000a-ffff.parquet"]) == [new, old]


def test_rows_stay_when_the_copies_that_they_replace_cannot_be_removed(lake, monkeypatch):
    lake.append([event("same")], PROVENANCE)

    def refuse(path, missing_ok=False):
        if path.name.startswith("rows-"):
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("pathlib.Path.unlink", refuse)
    with pytest.raises(LakeError, match="no row is lost, and those in two files count once"):
        lake.append([event("same")], PROVENANCE)
    assert messages(lake) == {"same"}
