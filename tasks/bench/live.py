"""The force of the present grasp for other processes: a small file of the lake's working folder, written as it comes.

A line with what the grasp is, then a line for each look: times in s, lifts in mm, forces in N. The next grasp replaces
the file. Whoever reads late gets the whole grasp; whoever comes again reads on where it was.
"""

import json
import logging
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from fast.hardware.grasp_bench import GraspBench
from fast.hardware.station.recorder import GraspInView
from fast.lake.store import Lake

LOOK_S = 0.1  # between looks at the bench: ten a second, where a screen shall show five
_MOST_BYTES = 4_000_000  # of one grasp; a minute at 300 readings a second has a tenth
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class LiveGrasp:
    """A grasp as far as the file has it."""

    place: str
    """Where to read on: number of the file, and bytes."""
    tool_id: str
    """That grasps; `<campaign_id>/B01T0`."""
    object_id: int
    """That is grasped."""
    repeat: int
    """Of the tool on the object."""
    started_at: str
    """When it began, ISO 8601."""
    purpose: str
    """Of a grasp that is no ordinary one, in a word; empty otherwise."""
    time_s: list[float]
    """m new samples, from the start of closing."""
    lift_mm: list[float]
    """m."""
    force_n: list[float]
    """m, tared."""
    is_other: bool
    """Whether it is not the grasp that was read before."""


def live_path(lake: Lake, campaign_id: str) -> Path:
    """Return where the present grasp of a campaign is written."""
    return lake.root / ".state" / "live" / f"{campaign_id}.jsonl"


@contextmanager
def show_live(path: Path, bench: GraspBench) -> Iterator[None]:
    """Write what the bench measures to the file until the `with` block ends, from a thread of its own."""
    is_over = threading.Event()
    writer = threading.Thread(target=_write_on, args=(path, bench, is_over), daemon=True, name="live-force")
    writer.start()
    try:
        yield
    finally:
        is_over.set()
        writer.join()


def read_live(path: Path, place: str = "") -> LiveGrasp | None:
    """Read the present grasp of a file: samples after `place`, where the last reading ended, or all of another grasp.

    None where there is nothing new, or no file.
    """
    try:
        with path.open("rb") as file:
            number, size = os.fstat(file.fileno()).st_ino, os.fstat(file.fileno()).st_size
            known, _, offset = place.partition(":")
            is_other = known != str(number) or not offset.isdecimal() or int(offset) > size
            if not is_other and int(offset) == size:
                return None
            head = json.loads(file.readline())
            if not is_other:
                file.seek(int(offset))
            text = file.read()
            end = file.tell()
    except (OSError, ValueError):
        return None
    whole = text[: text.rfind(b"\n") + 1]  # a line that is being written is read next time
    time_s: list[float] = []
    lift_mm: list[float] = []
    force_n: list[float] = []
    for line in whole.splitlines():
        for channel, part in zip((time_s, lift_mm, force_n), json.loads(line), strict=True):
            channel += part
    end -= len(text) - len(whole)
    return LiveGrasp(
        place=f"{number}:{end}", **head, time_s=time_s, lift_mm=lift_mm, force_n=force_n, is_other=is_other
    )


def _write_on(path: Path, bench: GraspBench, is_over: threading.Event) -> None:
    """Write the file for people who look on; nothing that goes wrong here ends a grasp."""
    shown: GraspInView | None = None
    file: IO[str] | None = None
    n = 0
    try:
        while True:
            is_last = is_over.wait(LOOK_S)
            view = bench.present_grasp()
            if view is not None and view is not shown:
                if file is not None:
                    file.close()
                file, shown, n = _begin(path, view), view, 0
            if view is not None and file is not None:
                n += _write_part(file, view, n)
            if is_last:
                return
    except Exception as error:  # a driver of the user's own may raise anything
        logger.warning("the force of the present grasp is not shown: %s", error)
    finally:
        if file is not None:
            file.close()


def _begin(path: Path, view: GraspInView) -> IO[str]:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    file = part.open("w", encoding="utf-8")
    head = {
        "tool_id": view.tool_id,
        "object_id": view.object_id,
        "repeat": view.repeat,
        "started_at": view.started_at.isoformat(),
        "purpose": view.purpose,
    }
    file.write(f"{json.dumps(head)}\n")
    file.flush()
    os.replace(part, path)
    return file


def _write_part(file: IO[str], view: GraspInView, first: int) -> int:
    """Write the samples from number `first` on; returns how many they are."""
    found = view.read(first)
    if not len(found.time_s) or file.tell() > _MOST_BYTES:
        return 0
    parts = (found.time_s.round(3), found.lift_mm.round(3), found.force_n.round(3))
    file.write(f"{json.dumps([part.tolist() for part in parts])}\n")
    file.flush()
    return len(found.time_s)
