"""What a lake asks of the place that keeps its files: a folder, or an object store of which a folder here is a copy.

Whatever the store, tables are read from a folder on this machine, `root`; locks, caches and outputs of the lake, which
belong to the machine and not to the data, are in it too.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import pyarrow as pa

MARKER = "lake.json"
STAGED_MARKER = f".{MARKER}."  # with the number of the process that makes the lake


QUARANTINE = "quarantine"
LEASES = "leases"


class Entry(NamedTuple):
    """A file or folder of the store; `place` is what a person calls it."""

    name: str
    place: Path | str
    is_file: bool
    modified_s: float


class Storage(Protocol):
    """What a lake asks of the place that keeps its files."""

    address: str
    root: Path

    def marker(self) -> str | None:
        """Return the text of the file that makes this place a lake; None if there is none."""

    def is_empty(self) -> bool:
        """Return whether nothing is at this place.

        Raises:
            FastError: the object store does not answer.
            OSError: the folder cannot be read.
        """

    def try_writing(self) -> None:
        """Write a file that no reader looks at, and remove it: permissions alone do not tell.

        Raises:
            FastError: the object store does not take it.
            OSError: the folder cannot be written.
        """

    def make(self, marker: str) -> None:
        """Make a lake of an empty place.

        Raises:
            UsageError: it cannot be written, or holds something else.
        """

    def refresh(self, tables: Iterable[str], *, anew: bool = False) -> None:
        """Bring the files that are read here in step with the store; `anew` trusts none that is here.

        Raises:
            FastError: the store does not answer; what is here is as before.
        """

    def file_name(self, rows: pa.Table) -> str:
        """Name the file of appended rows."""

    def names(self, table: str) -> list[str]:
        """List names of the files of a table that readers look at, as they are now in the store; asked before writing.

        Raises:
            FastError: the store does not answer, or the folder cannot be listed.
        """

    def publish(self, staged: Path, final: Path) -> None:
        """Give a staged file its name, at once for every reader, and make that last.

        Raises:
            FastError: it may not have its name; the staged file is gone.
        """

    def remove(self, folder: Path, names: Iterable[str]) -> None:
        """Remove files whose rows are in other files; some may be gone.

        No lock is needed: a name stands for one content, so a file of this name that another process writes meanwhile
        holds rows that are elsewhere too.

        Raises:
            FastError: some could not be removed.
        """

    # Small files, of which `lake.leases` is made; their folders and names are told from the top.

    def claim(self, folder: str, stem: str, text: str) -> str | None:
        """Write a small file whose name begins with `stem`, if there is none; its name, for one at most who tries.

        All who try at the same moment may hear None.

        Raises:
            FastError: it cannot be written.
        """

    def read(self, name: str) -> str | None:
        """Read the text of a small file; None if it is not there.

        Raises:
            FastError: it cannot be read.
        """

    def overwrite(self, name: str, text: str) -> bool:
        """Replace the text of a small file by one of the same length; False if it is gone.

        Raises:
            FastError: it could not be written.
        """

    def small_files(self, folder: str) -> list[str]:
        """List names of the small files in a folder, with it; none if there is no such folder.

        Raises:
            FastError: it cannot be listed.
        """

    def drop(self, name: str) -> None:
        """Remove a small file that may be gone.

        Raises:
            FastError: it could not be removed.
        """

    def place(self, table: str) -> Path | str:
        """Return what a person calls the folder of a table."""

    def entries(self, table: str | None = None) -> list[Entry]:
        """List what is in the folder of a table, or at the top, by name; nothing if there is no such folder.

        Raises:
            OSError: it cannot be read.
        """

    def set_aside(self, entry: Path | str, reason: Mapping[str, str]) -> Path | str:
        """Move a file to the quarantine, its reason first; returns where it is now.

        Raises:
            FastError: it could not be moved, and is where it was.
        """


def reason_of(target: Path) -> Path:
    """Return the file beside one in the quarantine that says why it is there."""
    return target.with_name(f"{target.name}.reason.json")


def reason_text(reason: Mapping[str, str]) -> str:
    """Write the content of that file."""
    return json.dumps(dict(reason), indent=2) + "\n"
