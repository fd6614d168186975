"""A lake in a folder."""

import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import pyarrow as pa

from lake.query.engine import Signature, list_files
from lake.storage.base import MARKER, QUARANTINE, STAGED_MARKER, Entry, reason_of, reason_text
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


def _not_set_aside(path: Path, error: OSError) -> FastError:
    stayed = f"{path} could not be set aside ({error.strerror}); it is where it was, nothing was lost: "
    if error.errno in FORBIDDEN:
        return UsageError(f"{stayed}change the permissions of the lake, then run the same command again.")
    return LakeError(f"{stayed}free disk space or repair the disk, then run the same command again.")
