"""A bench that is lent to the lab's page: a process near it keeps it, people move it by hand, one after the other.

The process has leave to move, given at its terminal; a virtual bench needs none. Orders are events of the lake and name
the process that they are for: one that comes late, when that has ended, is heard by nobody. One person holds the bench
at a time, and who wants it asks.
"""

import contextlib
import json
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from fast.hardware.hand import Hand, HandStep
from fast.hardware.parts.safe_state import Verb
from fast.lake.leases import exclusive, holder_of
from fast.lake.order import OLDEST_FIRST
from fast.lake.query.engine import Mark
from fast.lake.storage.files import write_file
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import FastError, UsageError
from fast.models.records import Record
from fast.tasks.campaign.present_run import StaleRequestError
from fast.tasks.campaign.requests import GANTRY_LEASE, append_event

LENT, REQUESTED, DONE = "bench_lent", "bench_order", "bench_order_done"  # kinds of the events
LEASE = "lent-bench"
REPLY_S = 60.0  # a holder who does not answer for so long is asked no more
IDLE_S = 600.0  # without an order, the bench is given back
LOOK_S = 0.2
logger = logging.getLogger(__name__)
_OF_SESSION = f"""
    SELECT event_id, kind, payload_json, created_at FROM events
    WHERE kind IN ('{LENT}', '{REQUESTED}', '{DONE}') AND payload_json ->> '$.session' = $session
    ORDER BY {OLDEST_FIRST}, event_id
"""


class BenchRequest(Record):
    """What a person wants of the process that lends a bench. `session`: which process is meant."""

    session: str
    operator: str = Field(min_length=1)
    verb: Literal["take", "want", "give", "keep", "release", "step", "stop", "run"]
    step: HandStep | None = None
    may_vent: bool = Field(default=False, description="of take: a person has looked at a gripper that is closed")
    config: str = Field(default="", description="of run: the campaign's file")


@dataclass(frozen=True)
class LentBench:
    """A lent bench as the lake tells."""

    session: str
    """The process that lends it; orders name it."""
    name: str
    """Of the bench: its file without the ending."""
    is_real: bool
    """Whether a machine moves."""
    file: str
    """Bench file, or world of a virtual bench."""
    holder: str = ""
    """Who moves it by hand; empty: nobody."""
    wanted_by: str = ""
    """Who asks the holder for it."""
    wanted_at: datetime | None = None
    """Since when."""
    said: str = ""
    """What the last order came to."""

    def may_take(self, operator: str, now: datetime | None = None) -> bool:
        """Return whether a person may take it: it is free, or its holder has not answered."""
        if self.holder in ("", operator):
            return True
        now = now or datetime.now(UTC)
        is_late = self.wanted_at is not None and (now - self.wanted_at).total_seconds() > REPLY_S
        return self.wanted_by == operator and is_late


def read_lent(lake: Lake) -> LentBench | None:
    """Read the bench that is lent now, and who holds it; None where none is."""
    holder = holder_of(lake.storage, LEASE)
    if holder is None:
        return None
    lent: LentBench | None = None
    for row in lake.query(_OF_SESSION, {"session": holder.token}).to_pylist():
        payload = json.loads(row["payload_json"])
        if row["kind"] == LENT:
            lent = LentBench(payload["session"], payload["name"], payload["is_real"], payload["file"])
        elif lent is not None:
            lent = _follow(lent, row["kind"], payload, row["created_at"])
    return lent


def send_request(lake: Lake, request: BenchRequest) -> str:
    """Order something of the process that lends the bench; a sentence says what was asked, what came of it comes later.

    Raises:
        StaleRequestError: that process has ended.
        UsageError: somebody else holds the bench, or a campaign moves it.
    """
    lent = read_lent(lake)
    if lent is None or request.session != lent.session:
        raise StaleRequestError("this bench is not lent any more; nothing was moved: load the page again.")
    check_request(lake, lent, request)
    append_event(lake, "", REQUESTED, _say(request, lent), **request.model_dump(mode="json"))
    return f"{_say(request, lent)}."


def check_request(lake: Lake, lent: LentBench, request: BenchRequest) -> None:
    """Raise UsageError where a person may not order this now; a stop is never refused."""
    who, holder = request.operator, lent.holder
    moving = holder_of(lake.storage, GANTRY_LEASE)
    if request.verb in ("take", "run") and moving is not None and not holder:
        raise UsageError(f"a campaign moves the bench ({moving.words}); have it finish its grasp first.")
    if request.verb == "run" and holder:
        raise UsageError(f"{holder} moves the bench by hand; it has to be given back first. Nothing was started.")
    if request.verb == "take" and not lent.may_take(who):
        raise UsageError(f"{holder} holds the bench; ask for it first. Nothing was moved.")
    if request.verb == "want" and holder in ("", who):
        raise UsageError("nobody else holds the bench; take it.")
    if request.verb in ("give", "keep", "release", "step") and holder != who:
        raise UsageError(f"{holder or 'nobody'} holds the bench, not {who}; nothing was moved.")
    if request.verb in ("give", "keep") and not lent.wanted_by:
        raise UsageError("nobody asks for the bench.")


def _follow(lent: LentBench, kind: str, payload: dict[str, Any], at: datetime) -> LentBench:
    """Return what an event makes of who holds the bench."""
    free = replace(lent, holder="", wanted_by="", wanted_at=None)
    if kind == DONE:
        return replace(free if payload["is_over"] else lent, said=payload["sentence"])
    verb, who = payload["verb"], payload["operator"]
    if verb == "want":
        return replace(lent, wanted_by=who, wanted_at=at)
    holders = {"take": who, "give": lent.wanted_by, "keep": lent.holder, "release": ""}
    return replace(free, holder=holders[verb]) if verb in holders else lent


def _say(request: BenchRequest, lent: LentBench) -> str:
    step = request.step
    if step is not None:
        by = f" {step.axis} {step.distance_mm:+g} mm" if step.verb == "jog" else ""
        return f"{request.operator}: {step.verb}{by}"
    words = {
        "take": f"takes {lent.name} by hand",
        "want": f"asks {lent.holder} for {lent.name}",
        "give": f"gives {lent.name} to {lent.wanted_by}",
        "keep": f"keeps {lent.name}",
        "release": f"gives {lent.name} back",
        "stop": f"stops {lent.name}",
        "run": f"has {lent.name} run {Path(request.config).name}",
    }
    return f"{request.operator} {words[request.verb]}"


def reading_path(lake: Lake) -> Path:
    """Return where a bench that is moved by hand writes what it reads."""
    return lake.root / ".state" / "live" / "by-hand.json"


@dataclass(frozen=True)
class Lender:
    """A process that lends a bench. `open_bench`: with leave for a closed gripper to open; `run`: starts a campaign."""

    lake: Lake
    name: str
    file: str
    is_real: bool
    open_bench: Callable[[bool], AbstractContextManager[Hand]]
    run: Callable[[str], str]
    should_end: Callable[[], bool]

    def lend(self, first_holder: str = "") -> str:
        """Lend the bench until `should_end`; with a first holder until that person, or who comes next, gives it back.

        Raises:
            FastError: another process lends a bench of this lake.
        """
        with exclusive(self.lake.storage, LEASE, "a bench of this lake is lent already") as lease:
            session, words = lease.token, f"{self.name} is lent to the lab's page"
            what = {"session": session, "name": self.name, "is_real": self.is_real, "file": self.file}
            append_event(self.lake, "", LENT, words, **what)
            if first_holder:
                taking = BenchRequest(session=session, operator=first_holder, verb="take")
                append_event(self.lake, "", REQUESTED, f"{first_holder} takes {self.name}", **taking.model_dump())
            with _hear(self.lake, session) as requests:
                while not self.should_end():
                    request = requests.next()
                    if request is None:
                        continue
                    sentence = self._fulfil(request, requests)
                    if sentence:
                        self._report(session, sentence, is_over=True)
                    if first_holder and request.verb == "take":
                        break
        return f"{self.name} is lent no more"

    def _fulfil(self, request: BenchRequest, requests: "_Requests") -> str:
        """Do what an order to a bench that nobody holds asks for; why not, or how it ended."""
        try:
            if request.verb == "take":
                return self._by_hand(request, requests)
            return self.run(request.config) if request.verb == "run" else ""
        except FastError as error:
            return str(error)

    def _by_hand(self, taken: BenchRequest, requests: "_Requests") -> str:
        """Have the bench moved by hand until it is given back, nobody moves it any more, or it fails."""
        path = reading_path(self.lake)
        path.parent.mkdir(parents=True, exist_ok=True)
        owned = exclusive(self.lake.storage, GANTRY_LEASE, "the bench of this lake is in use")
        try:
            with owned as gantry, self.open_bench(taken.may_vent) as hand:
                hand.set_leave(gantry.require)
                requests.drop()  # given before anything could be seen
                requests.hand = hand
                self._report(taken.session, f"{self.name} is connected")
                return self._follow_steps(taken.session, hand, requests, path)
        finally:
            requests.hand = None
            requests.drop()
            path.unlink(missing_ok=True)

    def _follow_steps(self, session: str, hand: Hand, requests: "_Requests", path: Path) -> str:
        last_s = time.monotonic()
        while not self.should_end():
            if time.monotonic() - last_s > IDLE_S:
                return f"{self.name} was given back, since nobody moved it for {IDLE_S / 60:.0f} minutes"
            hand.pass_time(LOOK_S)
            request = requests.next()
            if request is not None:
                last_s = time.monotonic()
                if request.verb == "release":
                    return f"{request.operator} gave {self.name} back"
                if request.step is not None:
                    self._report(session, self._make(hand, request.operator, request.step))
            _write_reading(path, hand)
        return f"{self.name} is lent no more"

    def _make(self, hand: Hand, operator: str, step: HandStep) -> str:
        lent = read_lent(self.lake)
        if lent is None or lent.holder != operator:
            return f"{operator} does not hold the bench any more; nothing was moved"
        try:
            return hand.do(step)
        except FastError as error:
            return str(error)

    def _report(self, session: str, sentence: str, is_over: bool = False) -> None:
        append_event(self.lake, "", DONE, sentence, session=session, sentence=sentence, is_over=is_over)


def _write_reading(path: Path, hand: Hand) -> None:
    """Write what the bench reads, for who looks on; a bench that does not answer is said so."""
    try:
        values: dict[str, Any] = asdict(hand.read())
    except FastError as error:
        values = {"fault": str(error)}
    write_file(path, json.dumps(values).encode())


class _Requests:
    """Orders for this process as they come; a stop reaches the bench at once and drops what waits."""

    def __init__(self, lake: Lake, session: str) -> None:
        self.hand: Hand | None = None
        self._lake, self._session = lake, session
        self._seen: set[str] = set()
        self._mark: Mark | None = None
        self._waiting: queue.Queue[BenchRequest] = queue.Queue()

    def next(self) -> BenchRequest | None:
        """Return the next order, waiting for a moment."""
        try:
            return self._waiting.get(timeout=LOOK_S)
        except queue.Empty:
            return None

    def drop(self) -> None:
        """Forget what waits."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._waiting.get_nowait()

    def look(self) -> None:
        """Take what is new in the lake."""
        mark = self._lake.mark(EventRow)
        if mark == self._mark:
            return
        self._mark = mark
        for row in self._lake.query(_OF_SESSION, {"session": self._session}).to_pylist():
            if row["kind"] == REQUESTED and row["event_id"] not in self._seen:
                self._seen.add(row["event_id"])
                self._take(row["payload_json"])

    def _take(self, text: str) -> None:
        try:
            request = BenchRequest.model_validate_json(text)
        except ValidationError as error:
            logger.warning("an order to the bench was not understood: %s", error)
            return
        if request.verb == "stop":
            self.drop()
            if self.hand is not None:
                self.hand.ask(Verb.STOP)
        elif request.verb in ("release", "step", "run") or (request.verb == "take" and self.hand is None):
            self._waiting.put(request)


@contextmanager
def _hear(lake: Lake, session: str) -> Iterator[_Requests]:
    """Yield orders of people until the `with` block ends, looked for in a thread of its own."""
    requests, is_over = _Requests(lake, session), threading.Event()

    def look_on() -> None:
        while not is_over.wait(LOOK_S):
            try:
                requests.look()
            except FastError as error:
                logger.warning("orders to the bench could not be read: %s", error)

    thread = threading.Thread(target=look_on, name="bench-orders", daemon=True)
    thread.start()
    try:
        yield requests
    finally:
        is_over.set()
        thread.join()
