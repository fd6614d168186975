"""A lake in an object store: objects under `s3://bucket/prefix`, read through copies in a folder on this machine.

An object store has no rename, and needs none: an object is visible whole, once its last byte was acknowledged, or not
at all. So an object is written under its final name at once. The name is made from all that the object holds, so one
name never stands for two contents: an object may be written twice, copied, or removed after its rows were merged into
another, without any lock, and a copy of it is as good as itself.
"""

import hashlib
import json
import os
import re
import time
import uuid
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

import pyarrow as pa
from pyarrow.fs import FileInfo, FileType

from fast.lake.storage.base import MARKER, QUARANTINE, STAGED_MARKER, Entry, reason_text
from fast.lake.storage.files import (
    FILE_PREFIX,
    FILE_SUFFIX,
    LEFTOVER_AGE_S,
    discard,
    file_name,
    make_folder,
    writing_failed,
)
from fast.lake.storage.s3_client import Connection, refusal
from fast.models.errors import LakeError, UsageError
from fast.models.folders import folder_of_person

_FETCHED_AT_ONCE = 16  # each waits for the network most of its time
# pyarrow writes the marker of the folder after each delete, and some servers make writers of one object wait a second.
_DELETED_AT_ONCE = 4
_PAGE = 1000  # objects in a listing of one request
_REFRESH_ATTEMPTS = 50  # an object may be merged into another between listing and reading
_COPYING_PREFIX = ".copying-"

T = TypeVar("T")


class ObjectStorage:
    """The objects under a prefix of a bucket.

    `refresh` lists a table, a request for each thousand objects, fetches what is new into `root` and forgets what is
    gone. Several processes may share the folder; it may be deleted while none runs.
    """

    def __init__(self, bucket: str, prefix: str) -> None:
        self._base = f"{bucket}/{prefix}".rstrip("/")
        self.address = f"s3://{self._base}"
        self.root = working_folder(self.address)
        self._store = Connection(bucket)

    def marker(self) -> str | None:
        """See `Storage`."""
        return self.read(MARKER)

    def is_empty(self) -> bool:
        """See `Storage`."""
        return self._asked("could not be read", lambda: not self._list("") and self._store.has_bucket())

    def try_writing(self) -> None:
        """See `Storage`."""

        def write_and_delete() -> None:
            key = self._key(f"{STAGED_MARKER}{os.getpid()}")
            self._store.put(key, b"")
            self._store.delete(key)

        self._asked("cannot be written", write_and_delete)

    def make(self, marker: str) -> None:
        """See `Storage`."""
        if self._asked("could not be read", lambda: self._list("")) and self.marker() is None:
            raise UsageError(
                f"{self.address} is not empty and not a lake; nothing was written: give a new prefix with --lake."
            )
        self._asked("could not be made a lake", lambda: self._store.put(self._key(MARKER), marker.encode()))

    def refresh(self, tables: Iterable[str], *, anew: bool = False) -> None:
        """See `Storage`."""
        for table in tables:
            self._asked("could not be read", partial(self._refresh, table, anew))

    def file_name(self, rows: pa.Table) -> str:
        """Make the name from all columns: rows appended again are another object, and no object ever changes."""
        return file_name(rows)

    def names(self, table: str) -> list[str]:
        """See `Storage`."""
        return self._asked("could not be read", lambda: list(self._whole_listing(table)))

    def publish(self, staged: Path, final: Path) -> None:
        """See `Storage`; what was staged becomes the copy read here."""
        try:
            self._asked(
                "did not take all rows of this call, and some may be missing",
                lambda: self._store.put(self._key(final), staged.read_bytes()),
            )
            with suppress(OSError):  # it is fetched when next read
                os.replace(staged, final)
        finally:
            discard([staged])

    def remove(self, folder: Path, names: Iterable[str]) -> None:
        """See `Storage`."""
        gone = list(names)

        def delete(name: str) -> None:
            with suppress(FileNotFoundError):  # another process was faster
                self._store.delete(self._key(folder / name))

        self._asked(
            "did not remove all merged objects; no row is lost, and those in two objects count once",
            lambda: _side_by_side(delete, gone, _DELETED_AT_ONCE),
        )
        discard([folder / name for name in gone])

    def claim(self, folder: str, stem: str, text: str) -> str | None:
        """See `Storage`: everybody writes an object of an own name, then looks; who is not alone takes it back.

        A listing shows every object that was acknowledged before. Of two who write, the one who looks last sees both,
        so two never go on. That needs no conditional writing, which pyarrow has not.
        """
        own = f"{folder}/{stem}-{uuid.uuid4().hex}.json"
        self._asked("could not be written", lambda: self._store.put(self._key(own), text.encode()))
        if [name for name in self.small_files(folder) if name.startswith(f"{folder}/{stem}-")] == [own]:
            return own
        self.drop(own)
        return None

    def read(self, name: str) -> str | None:
        """See `Storage`."""

        def get() -> str | None:
            with suppress(FileNotFoundError):
                return self._store.get(self._key(name)).decode(errors="replace")
            return None

        return self._asked("could not be read", get)

    def overwrite(self, name: str, text: str) -> bool:
        """See `Storage`."""
        self._asked("could not be written", lambda: self._store.put(self._key(name), text.encode()))
        return True

    def small_files(self, folder: str) -> list[str]:
        """See `Storage`."""
        found = self._asked("could not be read", lambda: self._list(folder))
        return [f"{folder}/{info.base_name}" for info in found if info.type == FileType.File]

    def drop(self, name: str) -> None:
        """See `Storage`."""

        def delete() -> None:
            with suppress(FileNotFoundError):
                self._store.delete(self._key(name))

        self._asked("could not be cleared", delete)

    def place(self, table: str) -> str:
        """See `Storage`."""
        return f"{self.address}/{table}"

    def entries(self, table: str | None = None) -> list[Entry]:
        """See `Storage`."""
        found = self._asked("could not be read", lambda: self._list(table or ""))
        return sorted(_entry(info) for info in found)

    def set_aside(self, entry: Path | str, reason: Mapping[str, str]) -> str:
        """See `Storage`: copied, then deleted."""
        source = str(entry).removeprefix("s3://")
        target = f"{self._key(QUARANTINE)}/{source.removeprefix(self._base + '/')}"

        def move() -> str:
            free = target
            while self._store.has(free):
                free += ".again"
            self._store.put(f"{free}.reason.json", reason_text(reason).encode())
            self._store.copy(source, free)
            self._store.delete(source)
            return f"s3://{free}"

        return self._asked(f"did not set {entry} aside; it is where it was, nothing was lost", move)

    def _key(self, name: Path | str) -> str:
        below = name.relative_to(self.root).as_posix() if isinstance(name, Path) else name
        return f"{self._base}/{below}"

    def _asked(self, failing: str, ask: Callable[[], T]) -> T:
        """Return the answer of the store.

        Raises:
            FastError: one sentence for what went wrong; `failing` says what that means.
        """
        try:
            return ask()
        except OSError as error:
            if error.errno is not None and not isinstance(error, FileNotFoundError):
                raise writing_failed(self.root, error) from error  # a folder here, not the store
            raise refusal(self.address, failing, error) from error

    def _list(self, folder: str) -> list[FileInfo]:
        found = self._store.list(self._key(folder).rstrip("/"))
        return [info for info in found if info.base_name]

    def _listing(self, table: str) -> dict[str, int]:
        """Return the sizes of the objects of a table that readers look at, in bytes."""
        return {info.base_name: info.size for info in self._list(table) if _is_rows(info)}

    def _refresh(self, table: str, anew: bool) -> None:
        folder = self.root / table
        make_folder(folder)
        for _ in range(_REFRESH_ATTEMPTS):
            here = _copies(folder)
            listed = self._settled_listing(table, here)
            if here and not listed and self.marker() is None:
                raise LakeError(
                    f"The lake {self.address} is gone, or its bucket is; the copies in {self.root} were kept: "
                    "restore it, or copy them."
                )
            wanted = {name: size for name, size in listed.items() if anew or here.get(name) != size}
            try:
                _side_by_side(lambda name: self._fetch(folder, name), wanted, _FETCHED_AT_ONCE)
            except FileNotFoundError:
                continue  # merged into another object since it was listed
            discard([folder / name for name in here if name not in listed])
            return
        raise LakeError(f"The table `{table}` of {self.address} changes faster than it can be read; try again.")

    def _settled_listing(self, table: str, here: dict[str, int]) -> dict[str, int]:
        """Return a listing that misses no row.

        A listing comes in pages of a thousand names. It may miss a merged object that appears while it is made, and
        the small ones that then go; two equal ones in a row cannot have.
        """
        found, before = self._listing(table), here
        while found != before:
            found, before = self._listing(table), found
        return found

    def _whole_listing(self, table: str) -> dict[str, int]:
        """Return a listing that misses no object: one page of it is of one moment, and more are asked for twice."""
        found = self._listing(table)
        return found if len(found) < _PAGE else self._settled_listing(table, found)

    def _fetch(self, folder: Path, name: str) -> None:
        """Copy an object into the folder, whole or not at all."""
        data = self._store.get(self._key(folder / name))
        copying = folder / f"{_COPYING_PREFIX}{os.getpid()}-{name}"
        try:
            copying.write_bytes(data)
            os.replace(copying, folder / name)
        except OSError:
            discard([copying])
            raise


def working_folder(address: str) -> Path:
    """Return the folder on this machine for a lake in an object store; the same for every process of a user.

    In `$XDG_STATE_HOME/fast/lakes`, or `~/.local/state/fast/lakes`. Two servers may have a bucket of one name, so
    that of the server counts too.
    """
    state = folder_of_person("XDG_STATE_HOME", ".local/state")
    name = re.sub(r"[^A-Za-z0-9.-]+", "-", address.removeprefix("s3://"))
    told_apart = hashlib.sha256(json.dumps([Connection.endpoint(), address]).encode()).hexdigest()[:8]
    return state.absolute() / "fast" / "lakes" / f"{name[:80]}-{told_apart}"


def _side_by_side(work: Callable[[str], None], names: Iterable[str], at_once: int) -> None:
    with ThreadPoolExecutor(at_once) as pool:
        for _ in pool.map(work, names):
            continue


def _is_rows(info: FileInfo) -> bool:
    name = info.base_name
    return info.type == FileType.File and name.startswith(FILE_PREFIX) and name.endswith(FILE_SUFFIX)


def _copies(folder: Path) -> dict[str, int]:
    """Return the sizes of the copies in a folder, in bytes; remove what a process left that died."""
    found = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            with suppress(FileNotFoundError):
                status = entry.stat()
                if entry.name.startswith(FILE_PREFIX):
                    found[entry.name] = status.st_size
                elif time.time() - status.st_mtime > LEFTOVER_AGE_S:
                    discard([folder / entry.name])
    return found


def _entry(info: FileInfo) -> Entry:
    is_file = info.type == FileType.File
    modified_s = info.mtime_ns / 1e9 if is_file else 0.0
    return Entry(info.base_name, f"s3://{info.path}", is_file, modified_s)
