"""Wire logs on disk: always on, of bounded size, and never in the way of a machine.

One thread carries what the logs of a bench hold to files, so that no driver waits for a disk. Each device has files of
its own, `SESSION-DEVICE-PART.log`; when they reach the limit the oldest go. A disk that is full or gone costs the files
and nothing else: the logs go on in memory, and the files go on when there is room again.

The first line of every file describes it: device, port, version of the driver, and one moment both on the wall clock
and on the monotonic clock, which all other times of the file are on.
"""

import json
import logging
import os
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import BinaryIO

from fast.hardware.wire.log import WireEntry, WireLog
from fast.models.errors import UsageError

logger = logging.getLogger(__name__)

FOLDER_NAME = "bench-log"
HEADER_START = "# fast wire log "
FORMAT = 1
SUFFIX = ".log"
GANTRY, PLC, LOAD_CELL = "gantry", "plc", "load-cell"  # devices
LIMIT_BYTES = 256_000_000  # of one device: four hours of force readings at 80 Hz, days of gantry traffic
N_PARTS = 32  # files that share the limit
WRITE_PERIOD_S = 0.1  # real; what a killed process can lose
RETRY_S = 30.0  # real, after a failed write
_CLOSE_TIMEOUT_S = 5.0  # a hanging disk must not keep a bench from closing


@dataclass(frozen=True)
class WireHeader:
    """First line of a file. `wall` and `monotonic_s` are the same moment."""

    device: str
    port: str
    session: str
    part: int
    version: str
    wall: str
    monotonic_s: float

    def as_text(self) -> str:
        """Return the line, without its end."""
        return HEADER_START + json.dumps({"format": FORMAT, **self.__dict__})

    @classmethod
    def from_text(cls, line: str) -> "WireHeader":
        """Undo `as_text`.

        Raises:
            ValueError: not the first line of a wire log, or of a later format.
        """
        if not line.startswith(HEADER_START):
            raise ValueError(f"it does not begin with `{HEADER_START.strip()}`")
        values = json.loads(line[len(HEADER_START) :])
        if not isinstance(values, dict) or values.pop("format", None) != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        try:
            return cls(**values)
        except TypeError as error:
            raise ValueError("its header lacks a key or has an unknown one") from error

    def wall_time(self, time_s: float) -> datetime:
        """Return the wall-clock time of a time in the log, in UTC."""
        return datetime.fromisoformat(self.wall) + timedelta(seconds=time_s - self.monotonic_s)


class WireFiles:
    """Writes the wire logs of one bench session to a folder; `with WireFiles(folder) as files: files.follow(log, ..)`.

    Args:
        folder: made when it is missing; other sessions may write to it at the same time.
        limit_bytes: most bytes of one device's files, those of earlier sessions included.

    Attributes:
        session: name of this session, the beginning of all its files.
    """

    def __init__(self, folder: Path, limit_bytes: int = LIMIT_BYTES) -> None:
        self.folder = folder
        self.session = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}-{os.getpid()}"
        self._limit_bytes = limit_bytes
        self._channels: list[_Channel] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="wire log writer", daemon=True)
        self._thread.start()

    def __enter__(self) -> "WireFiles":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def follow(self, log: WireLog, device: str, port: str) -> None:
        """Write what `log` holds and will hold; `device` is a word of letters, digits and hyphens."""
        log.keep_for_writing()
        self._channels.append(_Channel(self.folder, self.session, device, port, log, self._limit_bytes))

    def close(self) -> None:
        """Write what is left, then stop. Never raises, and gives a hanging disk up after a while."""
        self._stopping.set()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        is_last = False
        while not is_last:
            is_last = self._stopping.wait(WRITE_PERIOD_S)
            for channel in tuple(self._channels):
                channel.write()
        for channel in self._channels:
            channel.close()


class _Channel:
    """Files of one log. Used by the writer's thread only; no method raises `OSError`."""

    def __init__(self, folder: Path, session: str, device: str, port: str, log: WireLog, limit_bytes: int) -> None:
        self._folder = folder
        self._session = session
        self._device = device
        self._port = port
        self._log = log
        self._limit_bytes = limit_bytes
        self._part_bytes = max(limit_bytes // N_PARTS, 1)
        self._n_parts = 0
        self._n_lost = 0
        self._file: BinaryIO | None = None
        self._retry_at_s = 0.0

    def write(self) -> None:
        """Carry what is new to the file."""
        entries, n_lost = self._log.take_unwritten()
        self._n_lost += n_lost
        if not entries:
            return
        if time.monotonic() < self._retry_at_s:
            self._n_lost += len(entries)
            return
        try:
            file = self._open_file()
            file.write(_lines(entries, self._n_lost))
            file.flush()
            self._n_lost = 0
            if file.tell() >= self._part_bytes:
                self.close()
        except OSError as error:
            logger.warning("the wire log of the %s goes on in memory only: %s", self._device, error)
            self._n_lost += len(entries)
            self._retry_at_s = time.monotonic() + RETRY_S
            self.close()

    def close(self) -> None:
        """Close the file; the next write begins another part."""
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                logger.warning("a wire log did not close cleanly: %s", error)

    def _open_file(self) -> BinaryIO:
        if self._file is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._make_room()
            self._n_parts += 1
            name = f"{self._session}-{self._device}-{self._n_parts:04d}{SUFFIX}"
            self._file = (self._folder / name).open("wb")
            now, now_s = datetime.now(UTC), time.monotonic()
            header = WireHeader(
                self._device, self._port, self._session, self._n_parts, _version(), now.isoformat(), round(now_s, 6)
            )
            self._file.write(f"{header.as_text()}\n".encode())
        return self._file

    def _make_room(self) -> None:
        """Remove the oldest files of this device until another part fits; names sort by time."""
        sizes = {path: path.stat().st_size for path in self._folder.glob(f"*-{self._device}-*{SUFFIX}")}
        total_bytes = sum(sizes.values())
        for path in sorted(sizes):
            if total_bytes + self._part_bytes <= self._limit_bytes:
                return
            path.unlink(missing_ok=True)
            total_bytes -= sizes[path]


def _lines(entries: Iterable[WireEntry], n_lost: int) -> bytes:
    lines = [entry.as_text() for entry in entries]
    if n_lost:
        first_s = next(iter(entries)).time_s
        lines.insert(0, WireEntry(first_s, "note", f"{n_lost} earlier pieces were not written".encode()).as_text())
    return ("\n".join(lines) + "\n").encode()


def _version() -> str:
    try:
        return version("fast-gripper-lab")
    except PackageNotFoundError:
        return "unknown"


# Reading


@dataclass(frozen=True)
class RecordedWire:
    """A wire log read back: the header of its first file, the pieces, and whether its beginning is missing."""

    header: WireHeader
    entries: tuple[WireEntry, ...]
    is_cut: bool = False


def read_log(path: Path) -> RecordedWire:
    """Read one file. A last line that a power cut tore is left out.

    Raises:
        UsageError: the file cannot be read, or is no wire log; names the line.
    """
    header = read_header(path)
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    entries = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            entries.append(WireEntry.from_text(line))
        except ValueError as error:
            if number < len(lines):
                raise UsageError(f"`{path}`, line {number}: {error}; remove the line to use the rest.") from error
    return RecordedWire(header, tuple(entries), is_cut=header.part > 1)


def read_header(path: Path) -> WireHeader:
    """Read what the first line of a file says.

    Raises:
        UsageError: the file cannot be read, or is no wire log.
    """
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return WireHeader.from_text(file.readline().rstrip("\n"))
    except OSError as error:
        raise UsageError(f"wire log `{path}` cannot be read: {error.strerror}; give an existing file.") from error
    except ValueError as error:
        raise UsageError(f"`{path}` is no wire log: {error}; `fast gantry log` lists those that are there.") from error


def read_session(path: Path) -> RecordedWire:
    """Read all parts of the log that `path` is one part of, from the first one there is.

    Raises:
        UsageError: as `read_log`.
    """
    header = read_header(path)
    name = f"{header.session}-{header.device}-"
    paths = sorted(path.parent.glob(f"{name}*{SUFFIX}")) if path.name.startswith(name) else [path]
    parts = [read_log(part) for part in paths]
    entries = tuple(entry for part in parts for entry in part.entries)
    return RecordedWire(parts[0].header, entries, is_cut=parts[0].is_cut)


def list_logs(folder: Path) -> list[Path]:
    """List the wire logs of a folder, oldest first; none when there is no folder."""
    return sorted(folder.glob(f"*{SUFFIX}"))
