"""What the tool changer was about to do, on disk before it does it: after a kill it is known where the tool is.

One JSON object per line, appended and synced before the call returns: the intent of a pick or a dock, every step that a
sensor has proven, and the end. A line that was torn by the kill is the last one, and counts as not written.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from fast.models.errors import DeviceError

Verb = Literal["pick", "dock", "told"]
End = Literal["done", "undone"]

_LARGEST_BYTES = 1_000_000  # some 3,000 picks; then the file starts anew


@dataclass(frozen=True)
class Transaction:
    """A pick or a dock as far as the journal tells: `steps` proven so far, in order, with what was measured."""

    verb: Verb
    slot: int | None
    tool_id: str
    steps: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    end: End | None = None

    @property
    def slot_on_head(self) -> int | None:
        """Slot of the tool on the head when this ended as it did."""
        is_carrying = (self.verb == "dock") == (self.end == "undone")
        return self.slot if is_carrying or self.verb == "told" else None


class Journal:
    """Append-only file of transactions; with `path` None it lives as long as the object (a bench in this process)."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._last: Transaction | None = None
        for record in _read(path) if path is not None else ():
            self._last = _after(self._last, record)
        if path is not None and self.open is None and path.exists() and path.stat().st_size > _LARGEST_BYTES:
            self._start_anew(path)

    @property
    def last(self) -> Transaction | None:
        """The last transaction, ended or not; None in an empty journal."""
        return self._last

    @property
    def open(self) -> Transaction | None:
        """The transaction that has not ended."""
        return self._last if self._last is not None and self._last.end is None else None

    def begin(self, verb: Literal["pick", "dock"], slot: int, tool_id: str) -> None:
        """Write the intent; nothing may move or switch before this returns."""
        self._write({"verb": verb, "slot": slot, "tool_id": tool_id, "free_n": self._free_n})

    def step(self, name: str, **values: float) -> None:
        """Write a step that a sensor has proven, or a switch that comes next."""
        self._write({"step": name, **values})

    def close(self, end: End) -> None:
        """End the open transaction."""
        self._write({"end": end})

    def note_tool(self, slot: int | None, person: str) -> None:
        """Note what a person who has looked says: this slot's tool is on the head, or none."""
        self._write(
            {"verb": "told", "slot": slot, "tool_id": "", "person": person, "free_n": self._free_n, "end": "done"}
        )

    @property
    def _free_n(self) -> float | None:
        return self._last.values.get("free_n") if self._last is not None else None

    def _write(self, record: dict[str, Any]) -> None:
        kept = {key: value for key, value in record.items() if key == "slot" or value is not None}
        if self.path is not None:
            _append(self.path, {**kept, "at": datetime.now(UTC).isoformat(timespec="milliseconds")})
        self._last = _after(self._last, kept)

    def _start_anew(self, path: Path) -> None:
        last = self._last
        os.replace(path, path.with_name(path.name + ".old"))
        if last is not None:
            self._last = None
            self._write({"verb": "told", "slot": last.slot_on_head, "tool_id": "", **last.values, "end": "done"})


def _after(last: Transaction | None, record: Mapping[str, Any]) -> Transaction:
    """Return the transaction after one more line."""
    measured = {key: float(value) for key, value in record.items() if key.endswith("_n")}
    if "verb" in record:
        return Transaction(record["verb"], record["slot"], record["tool_id"], values=measured, end=record.get("end"))
    if last is None:
        raise ValueError("a step before any intent")
    steps = (*last.steps, record["step"]) if "step" in record else last.steps
    return Transaction(last.verb, last.slot, last.tool_id, steps, {**last.values, **measured}, record.get("end"))


def _append(path: Path, record: Mapping[str, Any]) -> None:
    line = (json.dumps(record) + "\n").encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab") as file:
            _cut_torn_line(path)
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise DeviceError(
            f"The journal `{path}` cannot be written ({error.strerror or error}): the tool changer does not move "
            "without it. Free the disk or correct the permissions, then continue."
        ) from error


def _cut_torn_line(path: Path) -> None:
    """Remove the rest of a line that a kill left without its end."""
    data = path.read_bytes()
    if data and not data.endswith(b"\n"):
        os.truncate(path, data.rfind(b"\n") + 1)


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        lines = path.read_bytes().split(b"\n")[:-1]  # what follows the last line end is torn, or empty
        return [json.loads(line) for line in lines]
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        raise DeviceError(
            f"The journal `{path}` cannot be read ({error}): where the tool is must come from a person. Look at the "
            "head, move the file away, then say what you saw with `fast gantry tool --real BENCH.toml`."
        ) from error
