"""A lake in a folder."""

import os
import tempfile
import uuid
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import pyarrow as pa

from fast.lake.query.engine import is_rows
from fast.lake.storage.base import MARKER, QUARANTINE, STAGED_MARKER, Entry, reason_of, reason_text
from fast.lake.storage.files import (
    FORBIDDEN,
    NOT_CONTENT,
    TEMPORARY_PREFIX,
    discard,
    file_name,
    make_folder,
    publish,
    sync_folder,
    write_synced,
    writing_failed,
)
from fast.models.errors import FastError, LakeError, UsageError


class FolderStorage:
    """A folder: files are written under a temporary name, synced and renamed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.address = str(root)
        self._absolute = root.absolute()  # of leases, which a thread renews while others may change the working folder

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
        """See `Storage`; what is read here is the store itself.

        Raises:
            LakeError: it is no longer here.
        """
        if self.marker() is None:
            raise LakeError(
                f"{self.root} is no lake any more: it was moved, renamed or deleted while this command ran; what was "
                "written is where the lake is now: give that place with --lake and run the same command again."
            )

    def file_name(self, rows: pa.Table) -> str:
        """End the name alike for the same rows whenever appended, so that a repeated append replaces its file."""
        return file_name(rows, NOT_CONTENT)

    def names(self, table: str) -> list[str]:
        """See `Storage`."""
        self.refresh([table])
        folder = self.root / table
        try:
            found, before = set(os.listdir(folder)), None
            while found != before:  # one scan may miss a merged file that appears while it passes
                found, before = set(os.listdir(folder)), found
            return [name for name in found if is_rows(name)]
        except FileNotFoundError:
            return []  # the table has no rows yet
        except OSError as error:
            raise writing_failed(folder, error) from error

    def publish(self, staged: Path, final: Path) -> None:
        """See `Storage`."""
        publish(staged, final)

    def remove(self, folder: Path, names: Iterable[str]) -> None:
        """See `Storage`."""
        try:
            for name in names:
                (folder / name).unlink(missing_ok=True)
            sync_folder(folder)
        except OSError as error:
            raise LakeError(
                f"Files of {folder} whose rows are in newer ones could not be removed ({error.strerror}); no row is "
                "lost, and those in two files count once: repair the disk or its permissions, then run the same "
                "command again."
            ) from error

    def claim(self, folder: str, stem: str, text: str) -> str | None:
        """See `Storage`: a link is made for one, also on a file server."""
        place = self._absolute / folder
        staged = place / f"{TEMPORARY_PREFIX}{os.getpid()}-{uuid.uuid4().hex}"
        try:
            make_folder(place)
            write_synced(staged, text)
            os.link(staged, place / f"{stem}.json")
        except FileExistsError:
            return None
        except OSError as error:
            raise writing_failed(place, error) from error
        finally:
            discard([staged])
        return f"{folder}/{stem}.json"

    def read(self, name: str) -> str | None:
        """See `Storage`."""
        try:
            return (self._absolute / name).read_text(errors="replace")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise _unread(self._absolute / name, error) from error

    def overwrite(self, name: str, text: str) -> bool:
        """See `Storage`: in place, which needs no room."""
        try:
            with (self._absolute / name).open("r+") as file:
                file.write(text)
        except FileNotFoundError:
            return False
        except OSError as error:
            raise writing_failed(self._absolute / name, error) from error
        return True

    def small_files(self, folder: str) -> list[str]:
        """See `Storage`."""
        try:
            names = os.listdir(self._absolute / folder)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise _unread(self._absolute / folder, error) from error
        return [f"{folder}/{name}" for name in names if name.endswith(".json")]

    def drop(self, name: str) -> None:
        """See `Storage`."""
        try:
            (self._absolute / name).unlink(missing_ok=True)
        except OSError as error:
            raise writing_failed(self._absolute / name, error) from error

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
        """Return whether the folder has more than what other processes leave that make, or died making, this lake."""
        if not self.root.exists():
            return False
        names = [entry.name for entry in self.root.iterdir()]
        return any(not name.startswith(STAGED_MARKER) for name in names) and self.marker() is None


def _unread(path: Path, error: OSError) -> LakeError:
    return LakeError(f"{path} cannot be read ({error.strerror}): change its permissions or repair the disk.")


def _not_set_aside(path: Path, error: OSError) -> FastError:
    stayed = f"{path} could not be set aside ({error.strerror}); it is where it was, nothing was lost: "
    if error.errno in FORBIDDEN:
        return UsageError(f"{stayed}change the permissions of the lake, then run the same command again.")
    return LakeError(f"{stayed}free disk space or repair the disk, then run the same command again.")
