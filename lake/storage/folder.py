"""Where the files of a lake are kept: in a folder, or in an object store of which a folder here is a copy.

Whatever the store, tables are read from a folder on this machine, `root`; locks, caches and outputs of the lake, which
belong to the machine and not to the data, are in it too.
"""

import json
import os
import re
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import NamedTuple, Protocol

import pyarrow as pa

from lake.query.engine import Signature, list_files
from lake.storage.files import (
    FORBIDDEN,
    NOT_CONTENT,
    discard,
    file_name,
    locked,
    make_folder,
    publish,
    sync_folder,
    write_synced,
    writing_failed,
)
from models.errors import FastError, LakeError, UsageError

MARKER = "lake.json"
STAGED_MARKER = f".{MARKER}."  # with the number of the process that makes the lake
QUARANTINE = "quarantine"
# A path takes one of the two slashes away, and --lake is a path wherever it may be a folder.
_OBJECT_STORE = re.compile(r"s3:/{1,2}(?P<bucket>[^/]+)/*(?P<prefix>.*)")

_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")


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
        """Text of the file that makes this place a lake; None if there is none."""

    def is_empty(self) -> bool:
        """True when nothing is at this place.

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
        """Name for the file of appended rows."""

    def naming(self) -> AbstractContextManager[None]:
        """Hold while files get their names, so that no file of the same name is removed meanwhile."""

    def publish(self, staged: Path, final: Path) -> None:
        """Give a staged file its name, at once for every reader, and make that last.

        Raises:
            FastError: it may not have its name; the staged file is gone.
        """

    def remove(self, folder: Path, files: Mapping[str, Signature]) -> None:
        """Remove files whose rows are in other files, but for those that were written again since.

        Raises:
            FastError: some could not be removed.
        """

    def place(self, table: str) -> Path | str:
        """What a person calls the folder of a table."""

    def entries(self, table: str | None = None) -> list[Entry]:
        """What is in the folder of a table, or at the top, by name; nothing if there is no such folder.

        Raises:
            OSError: it cannot be read.
        """

    def set_aside(self, entry: Path | str, reason: Mapping[str, str]) -> Path | str:
        """Move a file to the quarantine, its reason first; returns where it is now.

        Raises:
            FastError: it could not be moved, and is where it was.
        """


def storage_at(address: Path | str) -> Storage:
    """The storage at what a person gives as --lake: a folder, or `s3://bucket/prefix`.

    Raises:
        UsageError: it is the address of something else.
    """
    found = _OBJECT_STORE.fullmatch(str(address))
    if found is None and _ADDRESS.match(str(address)):
        raise UsageError(f"{address} is no lake: give a folder or s3://BUCKET/PREFIX with --lake.")
    if found is None:
        return FolderStorage(Path(address))
    from lake.storage.object_store import ObjectStorage  # a tenth of a second that a folder does not need

    return ObjectStorage(found["bucket"], found["prefix"].strip("/"))


class FolderStorage:
    """A folder: files are written under a temporary name, synced and renamed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.address = str(root)

    def marker(self) -> str | None:
        """See `Storage`."""
        path = self.root / MARKER
        try:
            return path.read_text() if path.is_file() else None
        except OSError as error:
            raise UsageError(f"{path} cannot be read ({error.strerror}); change its permissions.") from error

    def is_empty(self) -> bool:
        """See `Storage`."""
        return not self.root.exists() or not any(self.root.iterdir())

    def try_writing(self) -> None:
        """See `Storage`."""
        with tempfile.NamedTemporaryFile(dir=self.root, prefix=STAGED_MARKER):
            pass

    def make(self, marker: str) -> None:
        """See `Storage`."""
        staged = self.root / f"{STAGED_MARKER}{os.getpid()}"
        try:
            if self._holds_something_else():
                raise UsageError(
                    f"{self.root} is not empty and not a lake; nothing was written: give a new folder with --lake."
                )
            make_folder(self.root)
            write_synced(staged, marker)
        except OSError as error:
            raise writing_failed(self.root, error) from error
        publish(staged, self.root / MARKER)

    def refresh(self, tables: Iterable[str], *, anew: bool = False) -> None:
        """See `Storage`; what is read here is the store itself."""

    def file_name(self, rows: pa.Table) -> str:
        """The same for the same rows whenever they are appended, so that a repeated append replaces its file."""
        return file_name(rows, NOT_CONTENT)

    def naming(self) -> AbstractContextManager[None]:
        """See `Storage`."""
        return locked(self.root, exclusive=False)

    def publish(self, staged: Path, final: Path) -> None:
        """See `Storage`."""
        publish(staged, final)

    def remove(self, folder: Path, files: Mapping[str, Signature]) -> None:
        """See `Storage`."""
        try:
            with locked(self.root, exclusive=True):
                now = list_files(folder)
                for name, signature in files.items():
                    if now.get(name) == signature:
                        (folder / name).unlink(missing_ok=True)
                sync_folder(folder)
        except OSError as error:
            raise LakeError(
                f"Merged files of {folder} could not be removed ({error.strerror}); no row is lost, and those in two "
                "files count once: repair the disk or its permissions, then compact again."
            ) from error

    def place(self, table: str) -> Path:
        """See `Storage`."""
        return self.root / table

    def entries(self, table: str | None = None) -> list[Entry]:
        """See `Storage`."""
        try:
            paths = sorted((self.root / table if table else self.root).iterdir())
        except FileNotFoundError:
            return []
        found = []
        for path in paths:
            # What is gone was merged into another file, or given its name, since it was listed.
            with suppress(FileNotFoundError):
                found.append(Entry(path.name, path, path.is_file(), path.lstat().st_mtime))
        return found

    def set_aside(self, entry: Path | str, reason: Mapping[str, str]) -> Path:
        """See `Storage`."""
        path = Path(entry)
        target = self.root / QUARANTINE / path.relative_to(self.root)
        try:
            make_folder(target.parent)
            while target.exists():
                target = target.with_name(f"{target.name}.again")
            reason_path = reason_of(target)
            write_synced(reason_path, reason_text(reason))
            try:
                os.replace(path, target)
            except OSError:
                discard([reason_path])
                raise
            sync_folder(target.parent)
            sync_folder(path.parent)
        except OSError as error:
            raise _not_set_aside(path, error) from error
        return target

    def _holds_something_else(self) -> bool:
        """True when the folder has more in it than what other processes leave that make, or died making, this lake."""
        if not self.root.exists():
            return False
        names = [entry.name for entry in self.root.iterdir()]
        return any(not name.startswith(STAGED_MARKER) for name in names) and self.marker() is None


def reason_of(target: Path) -> Path:
    """File beside one in the quarantine that says why it is there."""
    return target.with_name(f"{target.name}.reason.json")


def reason_text(reason: Mapping[str, str]) -> str:
    """Content of that file."""
    return json.dumps(dict(reason), indent=2) + "\n"


def _not_set_aside(path: Path, error: OSError) -> FastError:
    stayed = f"{path} could not be set aside ({error.strerror}); it is where it was, nothing was lost: "
    if error.errno in FORBIDDEN:
        return UsageError(f"{stayed}change the permissions of the lake, then run the same command again.")
    return LakeError(f"{stayed}free disk space or repair the disk, then run the same command again.")
