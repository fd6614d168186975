"""`fast gantry log` and `fast gantry replay`: what was said on the wires of a bench, and saying it again."""

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import AsJson, show, table_text
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.hardware.replay.recording import Replay
    from fast.hardware.wire.log_files import RecordedWire, WireHeader

FromLake = Annotated[
    Path | None, Parameter(name="--lake", help="Lake whose benches' logs are meant; default: benches moved by hand.")
]


def log(
    file: Annotated[Path | None, Parameter(help="A log, or one part of it; without it the logs are listed.")] = None,
    *,
    lake: FromLake = None,
    grasp: Annotated[str | None, Parameter(help="Id of a grasp of the lake: what was said while it was made.")] = None,
    from_s: Annotated[float | None, Parameter(help="First time to print, seconds of the log's clock.")] = None,
    until_s: Annotated[float | None, Parameter(help="Last time to print.")] = None,
    last: Annotated[int | None, Parameter(help="Print only the last lines.", validator=Number(gte=1))] = None,
    json: AsJson = False,
) -> None:
    """List the wire logs of benches, or print one, or a grasp's share of all three devices."""
    folder = log_folder(lake)
    if grasp is not None:
        from_s, until_s, wires = _of_grasp(lake, folder, grasp)
    elif file is not None:
        from fast.hardware.wire.log_files import read_session

        wires = [read_session(file)]
    else:
        rows = _listing(folder)
        show(rows, table_text(rows) if rows else f"no wire logs in {folder}", json)
        return
    rows = _lines(wires, from_s, until_s)[-last if last else None :]
    show(rows, "\n".join(f"{row['time_s']:.6f} {row['device']:<9} {row['text']}" for row in rows), json)


def replay(
    file: Annotated[Path, Parameter(help="A log, or one part of it; `fast gantry log` lists them.")],
    *,
    real: Annotated[
        Path | None, Parameter(help="Bench file of the log's bench, if it has gantry_settings; nothing is opened.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Play a log back to the driver of its device; exit status 1 when the driver now sends something else.

    The device says again, byte for byte, what it said. Nothing real is touched.
    """
    from fast.hardware.replay.replay import replay as play
    from fast.hardware.wire.log_files import read_session
    from fast.tasks.campaign.setup import read_bench

    recorded = read_session(file)
    outcome = play(recorded, None if real is None else read_bench(real).gantry_profile)
    difference = outcome.difference
    data = {
        "device": recorded.header.device,
        "session": recorded.header.session,
        "n_compared": outcome.n_compared,
        "n_polls": outcome.n_polls,
        "errors": outcome.errors,
        "difference": difference
        and {
            "time_s": difference.time_s,
            "doing": difference.doing,
            "recorded_hex": difference.recorded.hex(" "),
            "sent_hex": difference.sent.hex(" "),
        },
    }
    show(data, _outcome_text(recorded.header, outcome), json)
    if difference is not None:
        sys.exit(1)


def log_folder(lake: Path | None) -> Path:
    """Return the folder of the wire logs: of a lake, or of benches moved by hand (in the user's state folder)."""
    from fast.hardware.wire.log_files import FOLDER_NAME
    from fast.models.folders import folder_of_person

    if lake is not None:
        from fast.tasks.campaign.requests import bench_log_folder

        return bench_log_folder(open_lake(lake))
    return folder_of_person("XDG_STATE_HOME", ".local/state") / "fast" / FOLDER_NAME


def _listing(folder: Path) -> list[dict[str, Any]]:
    from fast.hardware.wire.log_files import list_logs, read_header

    rows = []
    for path in list_logs(folder):
        try:
            header = read_header(path)
        except UsageError:
            continue  # somebody else's file, or one that a power cut left empty
        rows.append(
            {
                "started": header.wall[:19] + "Z",
                "device": header.device,
                "part": header.part,
                "kB": path.stat().st_size // 1000,
                "port": header.port,
                "file": str(path),
            }
        )
    return rows


def _of_grasp(lake: Path | None, folder: Path, grasp_id: str) -> "tuple[float, float, list[RecordedWire]]":
    """Find the time range and the logs of a grasp.

    Raises:
        UsageError: no such grasp, or its logs were not kept or have made room since.
    """
    from fast.hardware.wire.log_files import list_logs, read_session
    from fast.lake.tables.campaign import GraspRow

    if lake is None:
        raise UsageError("--grasp needs --lake, the lake that holds the grasp.")
    found = open_lake(lake).rows(GraspRow, grasp_id=grasp_id)
    if not found:
        raise UsageError(f"the lake {lake} has no grasp `{grasp_id}`; `fast sql` finds its id.")
    details = json_module.loads(found[-1]["details_json"])
    session = details.get("wire_log")
    firsts = {path.name.rsplit("-", 1)[0]: path for path in list_logs(folder) if path.name.startswith(f"{session}-")}
    if session is None or not firsts:
        raise UsageError(f"the wire logs of grasp {grasp_id} are not in {folder}: not kept, or removed to make room.")
    return details["wire_from_s"], details["wire_until_s"], [read_session(path) for path in firsts.values()]


def _lines(wires: "list[RecordedWire]", from_s: float | None, until_s: float | None) -> list[dict[str, Any]]:
    low, high = from_s if from_s is not None else float("-inf"), until_s if until_s is not None else float("inf")
    rows = [
        {"time_s": entry.time_s, "device": wire.header.device, "text": entry.as_text().split(" ", 1)[1]}
        for wire in wires
        for entry in wire.entries
        if low <= entry.time_s <= high
    ]
    return sorted(rows, key=lambda row: row["time_s"])


def _outcome_text(header: "WireHeader", outcome: "Replay") -> str:
    lines = [f"{header.device} on {header.port}, session {header.session}"]
    lines += [f"the driver complained as then: {error}" for error in outcome.errors]
    polls = f", {outcome.n_polls} status questions beside" if outcome.n_polls else ""
    lines.append(f"{outcome.n_compared} pieces were sent as recorded{polls}")
    if outcome.difference is not None:
        when = header.wall_time(outcome.difference.time_s).isoformat(sep=" ", timespec="milliseconds")
        lines.append(f"{outcome.difference.as_text()}\n  at        {when} on the wall clock")
    return "\n".join(lines)
