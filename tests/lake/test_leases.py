"""Who owns what is decided in the lake: by one host, by several, by those that sleep, die, or come back."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from fast.lake import leases
from fast.lake.leases import Lease, exclusive, holder_of, is_held
from fast.lake.maintenance import check
from fast.lake.provenance import Provenance
from fast.lake.storage.folder import FolderStorage
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import FastError, LakeError, LostLeaseError, UsageError
from tests.lake.lease_race import race_for_lease

PROVENANCE = Provenance(code_version="x", code_dirty=False)
ELSEWHERE = {"machine": "another", "host": "bench-2"}


class Time:
    """A clock of the watching process; sleeping moves it, and `meanwhile` is what others do in that time."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.meanwhile = lambda: None

    def sleep(self, seconds: float) -> None:
        """Let the others work."""
        self.now_s += seconds
        self.meanwhile()


@pytest.fixture
def time_(monkeypatch):
    time = Time()
    monkeypatch.setattr(leases, "now_s", lambda: time.now_s)
    monkeypatch.setattr(leases.time, "sleep", time.sleep)
    monkeypatch.setattr(leases, "BEAT_S", 1e6)  # beats come when a test says so
    return time


def newest(lake: Lake, name: str = "gantry") -> Path:
    return max((lake.root / "leases" / name).glob("*.json"))


def change(path: Path, **values: object) -> None:
    """Write something else into a lease, as its owner on another machine does."""
    text = json.loads(path.read_text()) | values
    path.write_text(json.dumps(text).ljust(512) + "\n")


def take_over(lake: Lake, name: str = "gantry") -> None:
    """What another host does after a silence."""
    path = newest(lake, name)
    epoch = int(path.stem) + 1
    other = path.with_name(f"{epoch:08d}.json")
    other.write_text(path.read_text())
    change(other, **ELSEWHERE, token="other", pid=99)


def event(name: str = "E1") -> EventRow:
    return EventRow(event_id=name, campaign_id="c", kind="k", message="m")


def test_a_second_owner_is_refused_with_who_where_and_since_when(lake):
    with exclusive(lake.storage, "gantry", "the gantry is in use") as lease:
        assert is_held(lake.storage, "gantry")
        assert holder_of(lake.storage, "gantry").token == lease.token
        with (
            pytest.raises(FastError, match=rf"in use \(process {os.getpid()} on .+, since 20.+ UTC\); wait for it or"),
            exclusive(Lake.open(lake.root).storage, "gantry", "the gantry is in use"),
        ):
            pass
        with exclusive(lake.storage, "campaign-a", "busy"):
            lease.require()
    assert not is_held(lake.storage, "gantry")
    assert check(lake) == []


def test_epochs_grow_and_old_ones_go(lake):
    tokens = set()
    for _ in range(3):
        with exclusive(lake.storage, "gantry", "busy") as lease:
            tokens.add(lease.token)
    assert len(tokens) == 3
    assert [path.name for path in (lake.root / "leases" / "gantry").iterdir()] == ["00000003.json"]


def test_a_killed_owner_of_this_machine_holds_nothing_at_once(lake, time_):
    code = (
        "import sys; from fast.lake.store import Lake; from fast.lake.leases import exclusive\n"
        "with exclusive(Lake.open(sys.argv[1]).storage, 'gantry', 'busy'):\n"
        "    print('held', flush=True); sys.stdin.read()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", code, str(lake.root)], **pipes) as owner:
        assert owner.stdout.readline() == "held\n"
        assert is_held(lake.storage, "gantry")
        owner.kill()
        owner.wait()
    assert not is_held(lake.storage, "gantry")
    with exclusive(lake.storage, "gantry", "busy"):
        assert time_.now_s < 1001.0, "it did not wait"


def test_a_process_with_the_number_of_a_dead_one_is_not_it(lake):
    with exclusive(lake.storage, "gantry", "busy"):
        change(newest(lake), started="1")
        assert not is_held(lake.storage, "gantry")


def test_an_owner_on_another_machine_that_gives_signs_of_life_stays(lake, time_):
    with exclusive(lake.storage, "gantry", "busy"):
        path = newest(lake)
        change(path, **ELSEWHERE)
        beats = iter(range(1, 100))
        time_.meanwhile = lambda: change(path, beat=next(beats))
        with (
            pytest.raises(FastError, match=r"busy \(process \d+ on bench-2"),
            exclusive(lake.storage, "gantry", "busy"),
        ):
            pass
    assert time_.now_s < 1000.0 + leases.SILENT_S / 2


@pytest.mark.parametrize("ends", ["dies", "gives it back"])
def test_an_owner_on_another_machine_that_is_silent_is_followed(lake, time_, ends):
    with exclusive(lake.storage, "gantry", "busy") as first:
        path = newest(lake)
        change(path, **ELSEWHERE)
        if ends == "gives it back":
            time_.meanwhile = lambda: change(path, is_released=True)
        with exclusive(lake.storage, "gantry", "busy") as second:
            assert (time_.now_s >= 1000.0 + leases.SILENT_S) == (ends == "dies")
            assert newest(lake).name == "00000002.json"
            time_.now_s += leases.CHECKED_S + 0.1
            with pytest.raises(LostLeaseError, match="no longer owns the gantry .* taken over by process"):
                first.require()
            second.require()
    assert not is_held(lake.storage, "gantry"), "who lost it does not give it back for the other"


def test_an_owner_whose_lake_was_moved_is_told_so(lake, time_):
    with exclusive(lake.storage, "campaign-quick", "busy") as mine:
        lake.root.rename(lake.root.with_name("moved"))
        time_.now_s += leases.RENEWED_S + 0.1
        with pytest.raises(LostLeaseError, match="the lake was moved, renamed or deleted.*new place with --lake"):
            mine.require()


def test_an_owner_that_lost_it_writes_nothing_and_says_what_to_do(lake, time_):
    with exclusive(lake.storage, "campaign-quick", "busy"):
        lake.append([event()], PROVENANCE)
        take_over(lake, "campaign-quick")
        time_.now_s += leases.CHECKED_S + 0.1
        with pytest.raises(
            LostLeaseError, match="campaign quick .* process 99 on bench-2.* give the same command again"
        ):
            lake.append([event("E2")], PROVENANCE)
        assert lake.ids(EventRow) == {"E1"}
        Lake.open(lake.root)
    assert not list(lake.root.rglob(".writing-*"))
    lake.append([event("E2")], PROVENANCE)  # what owns nothing may write
    assert json.loads(newest(lake, "campaign-quick").read_text())["is_released"] is False


def test_an_owner_that_slept_renews_before_it_goes_on_or_stops(lake, time_):
    with exclusive(lake.storage, "gantry", "busy") as lease:
        time_.now_s += 3600.0
        before = newest(lake).read_text()
        lease.require()
        assert newest(lake).read_text() != before
        time_.now_s += 3600.0
        take_over(lake)
        with pytest.raises(LostLeaseError):
            lease.require()


def test_a_lease_that_cannot_be_renewed_is_lost_in_time(lake, time_, monkeypatch):
    def refuse(storage: FolderStorage, name: str, text: str) -> bool:
        raise LakeError("The file server does not answer.")

    with exclusive(lake.storage, "gantry", "busy") as lease:
        monkeypatch.setattr(FolderStorage, "overwrite", refuse)
        time_.now_s += leases.RENEWED_S - 1
        lease.require()
        time_.now_s += 2
        with pytest.raises(LostLeaseError, match="could not be renewed for 16 s, and may be another's"):
            lease.require()


def test_beats_come_by_themselves(lake, monkeypatch):
    monkeypatch.setattr(leases, "BEAT_S", 0.001)
    beaten = threading.Event()
    renew = Lease._renew

    def watched(lease: Lease) -> None:
        renew(lease)
        beaten.set()

    monkeypatch.setattr(Lease, "_renew", watched)
    with exclusive(lake.storage, "gantry", "busy"):
        assert beaten.wait(10)
        assert json.loads(newest(lake).read_text())["beat"] >= 1


@pytest.mark.parametrize("text", ["", "{}", "not json"])
def test_a_lease_that_says_nothing_is_somebodys_until_it_was_silent(lake, time_, text):
    folder = lake.root / "leases" / "gantry"
    folder.mkdir(parents=True)
    (folder / "00000004.json").write_text(text)
    assert is_held(lake.storage, "gantry")
    with exclusive(lake.storage, "gantry", "busy"):
        assert newest(lake).name == "00000005.json"
        assert time_.now_s >= 1000.0 + leases.SILENT_S


def test_of_many_that_try_at_once_one_owns(lake):
    assert race_for_lease(lake.root, 8) == (1, 7)


def test_whoever_comes_late_to_an_epoch_that_is_gone_does_not_own(lake, monkeypatch):
    """It looked, slept, and made the epoch that two others had made, given back and cleared away meanwhile."""
    look = leases._newest
    seen = iter([look(lake.storage, "gantry")])
    with exclusive(lake.storage, "gantry", "busy"):
        pass
    with exclusive(lake.storage, "gantry", "busy"):
        monkeypatch.setattr(leases, "_newest", lambda *where: next(seen, None) or look(*where))
        with pytest.raises(FastError, match="busy"), exclusive(lake.storage, "gantry", "busy"):
            pass
    assert [path.name for path in (lake.root / "leases" / "gantry").iterdir()] == ["00000002.json"]


def test_a_lake_that_cannot_be_written_lends_nothing_and_still_tells(lake, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert not is_held(lake.storage, "gantry")
    with pytest.raises(UsageError, match="cannot be written"), exclusive(lake.storage, "gantry", "busy"):
        pass
