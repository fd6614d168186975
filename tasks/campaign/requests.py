"""What people ask of a running campaign (`hardware.safety.safe_state.Verb`), kept in the lake; and who may run it."""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

from hardware.safety.safe_state import EmergencyStopError, StopAskedError, Verb
from hardware.wire.log_files import FOLDER_NAME
from lake.query.engine import Mark
from lake.storage.files import writing_failed
from lake.store import Lake
from lake.tables.campaign import EventRow
from models.errors import FastError, LakeError
from models.ids import canonical_json, content_id
from tasks.campaign.campaign import stored_provenance

_LATEST = """
    SELECT kind FROM events WHERE campaign_id = $campaign AND list_contains($kinds, kind)
    ORDER BY created_at DESC, event_id LIMIT 1
"""
LEAST_FREE_MB = 100.0  # some thousand grasps of 30 kB


def append_event(lake: Lake, campaign_id: str, kind: str, message: str, **payload: object) -> None:
    """Add a line to the campaign's log in the lake; equal kind, message and payload are distinct events."""
    stamp = datetime.now(UTC).isoformat()
    row = EventRow(
        event_id=content_id("E", [campaign_id, kind, message, stamp, os.getpid()]),
        campaign_id=campaign_id,
        kind=kind,
        message=message,
        payload_json=canonical_json(payload),
    )
    lake.append([row], stored_provenance(lake, campaign_id))


def requested_verb(lake: Lake, campaign_id: str) -> Verb | None:
    """The latest verb that came after the campaign was last started, if any; the bench itself notes an e-stop."""
    found = lake.query(_LATEST, {"campaign": campaign_id, "kinds": [*map(str, Verb), "started"]})["kind"].to_pylist()
    return None if not found or found[0] == "started" else Verb(found[0])


class Requests:
    """`requested_verb`, asked again and again: the events are read only when there are new ones."""

    def __init__(self, lake: Lake, campaign_id: str) -> None:
        self._lake, self._campaign_id = lake, campaign_id
        self._mark: Mark | None = None
        self._verb: Verb | None = None

    def verb(self) -> Verb | None:
        """The latest verb since the campaign was last started, if any."""
        mark = self._lake.mark(EventRow)
        if mark != self._mark:
            self._verb = requested_verb(self._lake, self._campaign_id)
            self._mark = mark
        return self._verb


def require_acknowledgement(lake: Lake, campaign_id: str, is_acknowledged: bool) -> None:
    """A campaign that an emergency stop ended goes on only after a person has acknowledged it.

    Raises:
        FastError: nobody has.
    """
    if requested_verb(lake, campaign_id) is Verb.ESTOP and not is_acknowledged:
        raise FastError(
            f"campaign {campaign_id} was ended by the emergency stop and does not go on by itself. Release the button, "
            "look at gripper, lock and tool, then add --acknowledge; nothing was moved."
        )


@contextmanager
def note_verbs(lake: Lake, campaign_id: str) -> Iterator[None]:
    """Bench work: a person's stop or abort is a normal end, an emergency stop is noted before it goes up."""
    try:
        yield
    except StopAskedError as asked:
        append_event(lake, campaign_id, "bench_safe", str(asked))
    except EmergencyStopError as error:
        append_event(lake, campaign_id, Verb.ESTOP, str(error))
        raise


@contextmanager
def exclusive(lake: Lake, name: str, busy: str) -> Iterator[None]:
    """Hold the lock `name` of this lake; the kernel frees it however the holder dies.

    Raises:
        FastError: `busy`, with the holder's process id, when another process holds it.
        UsageError: the lake cannot be written.
    """
    path = lock_path(lake, name)
    with _open_lock(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            holder = file.read().strip() or "unknown"
            raise FastError(f"{busy} (process {holder}); wait for it or stop it first.") from error
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


def _open_lock(path: Path) -> TextIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("a+")
    except OSError as error:
        raise writing_failed(path.parent, error) from error


def require_room(lake: Lake) -> None:
    """Asked before each grasp, so that none is made that cannot be kept.

    Raises:
        LakeError: less than `LEAST_FREE_MB` are left on the disk of the lake.
    """
    folder = lock_path(lake, "gantry").parent
    folder.mkdir(parents=True, exist_ok=True)
    free_mb = shutil.disk_usage(folder).free / 1e6
    if free_mb < LEAST_FREE_MB:
        raise LakeError(
            f"The disk of the lake {lake.root} has {free_mb:.0f} MB left, limit {LEAST_FREE_MB:g} MB; the bench "
            "stopped before the next grasp. Make room, then give the same command again."
        )


def is_held(lake: Lake, name: str) -> bool:
    """True while another process holds the lock."""
    try:
        # Reading is enough, so that the status of a lake that cannot be written is still told.
        with lock_path(lake, name).open("r") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def lock_path(lake: Lake, name: str) -> Path:
    """File behind a lock."""
    return lake.root / ".state" / f"{name}.lock"


def bench_log_folder(lake: Lake) -> Path:
    """Where the wire logs of benches go that work for this lake."""
    return lock_path(lake, FOLDER_NAME).with_name(FOLDER_NAME)
