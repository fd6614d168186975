"""Who owns a campaign, the gantry, a calibration: decided in the lake, for all hosts that share it.

A lease is a small file `leases/NAME/EPOCH.json` of the lake. To own is to have made the file with the largest epoch:
the store lets one of all who try make it, and epochs only grow. The owner writes a beat into its file now and then. A
process of this machine that has died owns nothing from that moment on: the system is asked whether it lives. A process
of another machine counts as gone when its beat has not changed for `SILENT_S` by the clock of the one who watches, so
clocks are never compared. Whoever then makes the next epoch owns it; the former owner, should it come back, finds a
larger epoch than its own, and neither moves nor writes any more.
"""

import json
import logging
import os
import random
import re
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import NamedTuple

from fast.lake.storage.base import LEASES, Storage
from fast.models.errors import FastError, LostLeaseError

_LOG = logging.getLogger(__name__)
BEAT_S = 5.0
SILENT_S = 30.0  # without a new beat, the owner on another machine is taken for gone
RENEWED_S = 15.0  # an owner whose last beat is older has to write one before it goes on
CHECKED_S = 1.0  # a look at the epochs this recent still counts
_LOOK_S = 0.5
_ATTEMPTS = 8
_SIZE = 512  # bytes of a file: one of the same length is written over without room on the disk


class Holder(NamedTuple):
    """Who made a lease, as the file says. `token` names this one time of owning: of a campaign, this run of it."""

    token: str
    host: str
    machine: str
    pid: int
    started: str
    since: str
    is_released: bool

    @property
    def is_here(self) -> bool:
        """True for a process of this machine, of which alone can be told whether it lives."""
        return self.machine == _machine()

    @property
    def is_free(self) -> bool:
        """True when it was given back, or its owner is a process of this machine that has died."""
        return self.is_released or (self.is_here and _start_of(self.pid) != self.started)

    @property
    def words(self) -> str:
        """Who, where and since when, for people."""
        return f"process {self.pid} on {self.host}, since {self.since}"


@dataclass(frozen=True)
class _Claims:
    """The files of the newest epoch: one, and now and then that of a process that came too late or died trying."""

    epoch: int
    texts: tuple[str, ...]

    @property
    def holders(self) -> list[Holder]:
        """Those who may own it."""
        return [holder for text in self.texts if not (holder := _parsed(text)).is_free]


class Lease:
    """Ownership of `name` in a lake, renewed by a thread until it is released or lost.

    `token` names this one time of owning it.
    """

    def __init__(self, storage: Storage, name: str, file: str, holder: Holder, asked_s: float) -> None:
        self.name, self.token = name, holder.token
        self._storage, self._file, self._holder = storage, file, holder
        self._epoch, self._beat, self._pid = _epoch_of(file), 0, os.getpid()
        self._renewed_s = self._checked_s = asked_s
        self._lost = ""
        self._turn = threading.RLock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat_on, name=f"lease {name}", daemon=True)

    def require(self) -> None:
        """Ask before each motion and each row.

        Raises:
            LostLeaseError: another process owns it by now, or one may: it could not be renewed in time.
        """
        with self._turn:
            if not self._lost and now_s() - self._renewed_s > RENEWED_S:
                self._renew()
            if not self._lost and now_s() - self._checked_s > CHECKED_S:
                self._check()
            if self._lost:
                raise LostLeaseError(self._lost)

    def release(self) -> None:
        """Give it back; of one that is lost nothing is written."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        _OWNED.get(_key(self._storage), set()).discard(self)
        with self._turn:
            if not self._lost:
                self._overwrite(self._holder._replace(is_released=True))

    def begin(self) -> None:
        """Beat from now on, and count for every row that this process appends."""
        _OWNED.setdefault(_key(self._storage), set()).add(self)
        self._thread.start()

    @property
    def is_own(self) -> bool:
        """False in a forked copy of the process that owns it."""
        return self._pid == os.getpid()

    def _beat_on(self) -> None:
        while not self._ended.wait(BEAT_S) and not self._lost:
            with self._turn:
                self._renew()

    def _renew(self) -> None:
        """Write the next beat; where that fails, the lease ages, and is lost for this process when it is too old."""
        asked_s = now_s()
        self._beat += 1
        if self._overwrite(self._holder) and self._check():
            self._renewed_s = asked_s
        if not self._lost and now_s() - self._renewed_s > RENEWED_S:
            self._lose(f"could not be renewed for {now_s() - self._renewed_s:.0f} s, and may be another's by now")

    def _overwrite(self, holder: Holder) -> bool:
        try:
            if self._storage.overwrite(self._file, _text(holder, self._beat)):
                return True
            if self._check():
                self._lost = (
                    f"The lease of {_words(self.name)} is gone from {self._storage.address}: the lake was moved, "
                    "renamed or deleted. Nothing more is written or moved here, all rows are kept. Give the lake's new "
                    "place with --lake and run the same command again."
                )
        except FastError as error:
            _LOG.warning("the lease of %s was not renewed: %s", self.name, error)
        return False

    def _check(self) -> bool:
        """Look for a larger epoch than one's own."""
        asked_s = now_s()
        try:
            newest = _newest(self._storage, self.name)
        except FastError as error:
            _LOG.warning("the lease of %s could not be looked at: %s", self.name, error)
            return False
        if newest.epoch > self._epoch:
            by = f" by {_parsed(newest.texts[0]).words}" if newest.texts else ""
            self._lose(f"was taken over{by}")
            return False
        self._checked_s = asked_s
        return True

    def _lose(self, how: str) -> None:
        self._lost = (
            f"This process no longer owns {_words(self.name)} of {self._storage.address}: it {how}. Nothing more is "
            "written or moved here, all rows are kept. Look at that machine; when nothing works there, give the same "
            "command again."
        )
        _LOG.error("%s", self._lost)


_OWNED: dict[Path, set[Lease]] = {}  # by lake


@contextmanager
def exclusive(storage: Storage, name: str, busy: str) -> Iterator[Lease]:
    """Own `name` in the lake of this storage, as no other process on any host does.

    While an owner on another machine is silent, this waits, for `SILENT_S` at most.

    Raises:
        FastError: `busy`, with who owns it and since when.
        UsageError: the lake cannot be written.
    """
    lease = _acquire(storage, name, busy)
    lease.begin()
    try:
        yield lease
    finally:
        lease.release()


def holder_of(storage: Storage, name: str) -> Holder | None:
    """Tell who owns `name`, as far as the lake says: one of another machine may have died without a word."""
    holders = _newest(storage, name).holders
    return holders[0] if holders else None


def is_held(storage: Storage, name: str) -> bool:
    """Return whether a process owns `name`, as far as the lake tells."""
    return holder_of(storage, name) is not None


def require_owned(storage: Storage) -> None:
    """Check before rows become visible that what this process took over in the lake is still its own.

    Raises:
        LostLeaseError: it is not.
    """
    for lease in tuple(_OWNED.get(_key(storage), ())):
        if lease.is_own:
            lease.require()


def now_s() -> float:
    """Return seconds that no person or server can set, and that count while a machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


def _acquire(storage: Storage, name: str, busy: str) -> Lease:
    host, pid = socket.gethostname()[:100], os.getpid()
    own = Holder(uuid.uuid4().hex, host, _machine(), pid, _start_of(pid), "", False)
    for attempt in range(_ATTEMPTS):
        newest = _newest(storage, name)
        if newest.holders and not _is_silent(storage, name, newest):
            raise FastError(f"{busy} ({newest.holders[0].words}); wait for it or stop it first.")
        asked_s = now_s()
        own = own._replace(since=f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC")
        file = storage.claim(f"{LEASES}/{name}", f"{newest.epoch + 1:08d}", _text(own, 0))
        if file is not None and _newest(storage, name).epoch == newest.epoch + 1:
            _forget_older(storage, name, newest.epoch + 1)
            return Lease(storage, name, file, own, asked_s)
        if file is not None:
            storage.drop(file)
        time.sleep(random.uniform(0.0, 0.05 * 2**attempt))
    raise FastError(f"{busy}: others take it at the same moment; give the same command again.")


def _is_silent(storage: Storage, name: str, seen: _Claims) -> bool:
    """Watch owners on other machines: True when all are gone or have given back, False at the first sign of life."""
    if any(holder.is_here for holder in seen.holders):
        return False
    _LOG.warning(
        "%s is owned by %s; waiting up to %.0f s for a sign of life", _words(name), seen.holders[0].words, SILENT_S
    )
    began_s = now_s()
    while now_s() - began_s < SILENT_S:
        time.sleep(_LOOK_S)
        now = _newest(storage, name)
        if now != seen:
            return now.epoch == seen.epoch and not now.holders
    return True


def _newest(storage: Storage, name: str) -> _Claims:
    files = storage.small_files(f"{LEASES}/{name}")
    epoch = max(map(_epoch_of, files), default=0)
    texts = [storage.read(file) for file in sorted(files) if _epoch_of(file) == epoch]
    return _Claims(epoch, tuple(text for text in texts if text is not None))


def _forget_older(storage: Storage, name: str, epoch: int) -> None:
    try:
        for file in storage.small_files(f"{LEASES}/{name}"):
            if _epoch_of(file) < epoch:
                storage.drop(file)
    except FastError as error:
        _LOG.debug("older leases of %s stay: %s", name, error)


def _epoch_of(file: str) -> int:
    found = re.match(r"\d+", file.rpartition("/")[2])
    return int(found[0]) if found else 0


def _text(holder: Holder, beat: int) -> str:
    return json.dumps(holder._asdict() | {"beat": beat}).ljust(_SIZE) + "\n"


def _parsed(text: str) -> Holder:
    """Read who made it; a file that says nothing is of somebody elsewhere, who beats or does not."""
    try:
        found = json.loads(text)
        return Holder(**{name: found[name] for name in Holder._fields})
    except (ValueError, KeyError, TypeError):
        return Holder("", "an unknown machine", "", 0, "", "an unknown time", False)


def _words(name: str) -> str:
    kind, _, rest = name.partition("-")
    return f"campaign {rest}" if kind == "campaign" and rest else f"the {name}"


def _key(storage: Storage) -> Path:
    return storage.root.resolve()


@cache
def _machine() -> str:
    """Name this machine since it was started, as processes see it: those of another container are not seen."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot}/{os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return f"{socket.gethostname()}/{uuid.getnode():x}"


def _start_of(pid: int) -> str:
    """Tell when a process of this machine began, in a form that no clock changes; empty for one that is gone."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return "" if status[0] == "Z" else status[19]  # fields 3 and 22 of proc(5)
    except FileNotFoundError:
        if Path("/proc/self/stat").exists():
            return ""
    except ProcessLookupError:
        return ""
    import psutil  # where there is no /proc

    try:
        return str(int(psutil.Process(pid).create_time()))
    except psutil.NoSuchProcess:
        return ""
