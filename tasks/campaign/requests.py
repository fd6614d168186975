"""What people ask of a running campaign (`hardware.parts.safe_state.Verb`), kept in the lake."""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fast.hardware.parts.safe_state import EmergencyStopError, StopAskedError, Verb
from fast.hardware.wire.log_files import FOLDER_NAME
from fast.lake.leases import holder_of
from fast.lake.query.engine import Mark
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import FastError, LakeError
from fast.tasks.campaign.campaign import stored_provenance

STARTED = "started"  # kind of the event with which a process begins to run a campaign
BENCH_OPENED = "bench_opened"  # the campaign's bench is connected
# A verb is meant for the run that it names. One that names none (a single step, version 0.1) counts for the run before.
_LATEST = f"""
    WITH said AS (
        SELECT kind, event_id, (sequence, created_at) AS place, payload_json ->> '$.run' AS run
        FROM events WHERE campaign_id = $campaign AND (kind = '{STARTED}' OR list_contains($verbs, kind))
    ), started AS (SELECT place, run FROM said WHERE kind = '{STARTED}'),
    last AS (SELECT place, run FROM started ORDER BY place DESC LIMIT 1)
    SELECT said.kind FROM said LEFT JOIN last ON true
    WHERE said.kind <> '{STARTED}' AND (
        said.run = last.run
        OR (last.place IS NULL OR said.place > last.place)
        AND (said.run IS NULL OR said.run NOT IN (SELECT run FROM started WHERE run IS NOT NULL))
    )
    ORDER BY said.place DESC, event_id LIMIT 1
"""
GANTRY_LEASE = "gantry"  # of a lake, whose bench one process at a time moves
GAP_LEASE = "gap"  # of a lake, in which one process at a time searches for a gap
LEAST_FREE_MB = 100.0  # some thousand grasps of 30 kB


def append_event(lake: Lake, campaign_id: str, kind: str, message: str, **payload: object) -> None:
    """Add a line to the campaign's log in the lake; equal kind, message and payload are distinct events."""
    row = EventRow.of([campaign_id, kind, message, uuid.uuid4().hex], kind, message, payload, campaign_id)
    lake.append([row], stored_provenance(lake, campaign_id))


def append_request(lake: Lake, campaign_id: str, verb: Verb, message: str) -> None:
    """Ask the process that runs the campaign now for something; a later run does not hear it."""
    holder = holder_of(lake.storage, lease_name(campaign_id))
    append_event(lake, campaign_id, verb, message, **({"run": holder.token} if holder else {}))


def lease_name(campaign_id: str) -> str:
    """Return what a process owns in the lake while it runs the campaign."""
    return f"campaign-{campaign_id}"


def requested_verb(lake: Lake, campaign_id: str) -> Verb | None:
    """Return the latest verb for the last run of the campaign, if any; the bench itself notes an e-stop."""
    found = lake.query(_LATEST, {"campaign": campaign_id, "verbs": [*map(str, Verb)]})["kind"].to_pylist()
    return Verb(found[0]) if found else None


class Requests:
    """`requested_verb`, asked again and again: the events are read only when there are new ones."""

    def __init__(self, lake: Lake, campaign_id: str) -> None:
        self._lake, self._campaign_id = lake, campaign_id
        self._mark: Mark | None = None
        self._verb: Verb | None = None

    def verb(self) -> Verb | None:
        """Return the latest verb since the campaign was last started, if any."""
        mark = self._lake.mark(EventRow)
        if mark != self._mark:
            self._verb = requested_verb(self._lake, self._campaign_id)
            self._mark = mark
        return self._verb


def require_acknowledgement(lake: Lake, campaign_id: str, is_acknowledged: bool) -> None:
    """Let a campaign that an emergency stop ended go on only after a person has acknowledged it.

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
    """Run bench work: a person's stop or abort is a normal end, an emergency stop is noted before it goes up."""
    try:
        yield
    except StopAskedError as asked:
        append_event(lake, campaign_id, "bench_safe", str(asked))
    except EmergencyStopError as error:
        append_request(lake, campaign_id, Verb.ESTOP, str(error))
        raise


def require_room(lake: Lake) -> None:
    """Require room before each grasp, so that none is made that cannot be kept.

    Raises:
        LakeError: less than `LEAST_FREE_MB` are left on the disk of the lake.
    """
    folder = bench_log_folder(lake).parent
    folder.mkdir(parents=True, exist_ok=True)
    free_mb = shutil.disk_usage(folder).free / 1e6
    if free_mb < LEAST_FREE_MB:
        raise LakeError(
            f"The disk of the lake {lake.root} has {free_mb:.0f} MB left, limit {LEAST_FREE_MB:g} MB; the bench "
            "stopped before the next grasp. Make room, then give the same command again."
        )


def bench_log_folder(lake: Lake) -> Path:
    """Return where the wire logs of benches go that work for this lake."""
    return lake.root / ".state" / FOLDER_NAME
