"""A machine that FAST does not know: the bench file names the function that opens a driver of the user's own."""

import logging
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field

from fast.hardware.grasp_bench import GraspBench, Leave
from fast.hardware.parts.safe_state import Verb
from fast.hardware.questions import Ask, BenchQuestion
from fast.hardware.station.recorder import GraspInView
from fast.hardware.station.station import Item, MeasuredGrasp
from fast.hardware.tools.mounted import MountedTool
from fast.models.errors import DeviceError, FastError, UsageError
from fast.models.own_code import load_own
from fast.models.records import BENCH_FAULT, GraspRequest, GraspSetup, Record
from fast.models.units import force_n_from_kg

_T = TypeVar("_T")

IN_NEWTONS, NOT_NEWTONS = "the forces are in N", "stop"
# Of the tool's weight, where what the free gripper pulls with is in kg or g: head and tool weigh up to five tools.
_SHARES_OF_KG = (0.08, 0.5)
_LEAST_SHARE_OF_G = 50.0

logger = logging.getLogger(__name__)


class OwnBenchSettings(Record):
    """A driver, and what it is told; `docs/how-to/write-a-bench-driver.md` says what it must do."""

    kind: str = Field(description="`module:function` that opens the bench")
    moves: str = Field(min_length=1, description="what will move: said to the person who gives leave")
    settings: dict[str, Any] = Field(default_factory=dict, description="what the function is given")


class OwnBench:
    """A driver of the user's own. What it raises that is no `FastError` is a fault of the bench, and ends there."""

    def __init__(self, kind: str, driver: GraspBench, tools: Mapping[int, MountedTool] | None = None) -> None:
        self._kind = kind
        self._driver = driver
        self._tools = tools or {}
        self._ask: Ask | None = None
        self._is_unit_judged = False

    @property
    def wire_session(self) -> str | None:
        """Name of the logs of this session."""
        return self._driver.wire_session

    def set_leave(self, leave: Leave) -> None:
        """Have `leave` asked before every motion from now on."""
        with _told(self._kind):
            self._driver.set_leave(leave)

    def set_ask(self, ask: Ask) -> None:
        """Have a person asked where the bench cannot decide by itself."""
        self._ask = ask
        with _told(self._kind):
            self._driver.set_ask(ask)

    def ask(self, verb: Verb) -> None:
        """Stop or abort now, from any thread."""
        with _told(self._kind):
            self._driver.ask(verb)

    def present_grasp(self) -> GraspInView | None:
        """Return the grasp that is made now, or the last one."""
        with _told(self._kind):
            return self._driver.present_grasp()

    def check_position(self) -> tuple[float, float, float]:
        """Check how far the head is from where it is believed to be; a driver that fails is asked to stop."""
        with _told(self._kind, self._stop):
            return self._driver.check_position()

    def measure_tool(
        self,
        slot: int,
        plan: Sequence[Item],
        setup: GraspSetup,
        on_grasp: Callable[[MeasuredGrasp], None],
        should_stop: Callable[[], bool],
    ) -> None:
        """Have the planned grasps made; a driver that fails is asked to stop, and its grasp is kept as failed.

        Raises:
            DeviceError: also for what the driver raises that is no `FastError`.
        """
        begun, done, ours = datetime.now(UTC), list[MeasuredGrasp](), list[Exception]()

        def keep(grasp: MeasuredGrasp) -> None:
            done.append(grasp)
            _call(ours, lambda: self._judge_unit(slot, grasp))
            _call(ours, lambda: on_grasp(grasp))

        try:
            with _told(self._kind, self._stop):
                self._driver.measure_tool(slot, plan, setup, keep, lambda: _call(ours, should_stop))
        except DeviceError as fault:
            if ours:  # the driver only passed on what the campaign raised
                raise ours[0] from fault
            if not isinstance(fault, OwnDriverError):
                raise
            cut_short = self._find_cut_short(plan, setup, done, begun, str(fault))
            if cut_short is not None:
                on_grasp(cut_short)
            raise

    def _judge_unit(self, slot: int, grasp: MeasuredGrasp) -> None:
        """Ask once about a force of the free gripper that is its tool's weight in another unit.

        Raises:
            DeviceError: a person says so, or nobody can be asked; the grasp is not kept.
        """
        if self._is_unit_judged or slot not in self._tools:
            return
        self._is_unit_judged = True
        doubt = _doubt_unit(grasp.tare_force_n, force_n_from_kg(self._tools[slot].expected_mass_kg))
        if not doubt:
            return
        sentence = f"The driver `{self._kind}` {doubt}"
        question = BenchQuestion(
            key=f"force unit of {self._kind}", sentence=sentence, choices=(IN_NEWTONS, NOT_NEWTONS)
        )
        if self._ask is None or self._ask(question).choice != IN_NEWTONS:
            raise DeviceError(f"{sentence} Nothing was kept; correct the driver, then start the campaign again.")

    def _stop(self) -> str:
        """Ask the driver to stop; what became of that, in words."""
        try:
            self._driver.ask(Verb.STOP)
        except Exception as error:
            logger.warning("`%s` failed when it was asked to stop: %s", self._kind, error)
            return "it failed again when it was asked to stop, so stop the machine by hand"
        return "it was asked to stop"

    def _find_cut_short(
        self, plan: Sequence[Item], setup: GraspSetup, done: Sequence[MeasuredGrasp], begun: datetime, reason: str
    ) -> MeasuredGrasp | None:
        """Find the grasp that the driver was at, as far as it tells; None between two grasps."""
        try:
            view = self._driver.present_grasp()
            if view is None or view.started_at < begun:
                return None
            trace, cell = view.read(0), (view.object_id, view.repeat)
        except Exception as error:
            logger.warning("`%s` does not tell which grasp it was at: %s", self._kind, error)
            return None
        n_done = sum((grasp.object_id, grasp.repeat) == cell for grasp in done)
        owing = [item for item in plan if _grasp_of(item) == cell][n_done:]
        if not owing:
            return None
        request = owing[0] if isinstance(owing[0], GraspRequest) else None
        details: dict[str, float | str] = {"end": BENCH_FAULT}
        made_with = setup if request is None else request.setup
        return MeasuredGrasp(*cell, view.started_at, trace, "failed", reason, 0.0, details, made_with, request)


class OwnDriverError(DeviceError):
    """A driver of the user's own failed with an error that is no `FastError`: a mistake in it."""


@contextmanager
def open_own_bench(settings: OwnBenchSettings, tools: Mapping[int, MountedTool]) -> Iterator[GraspBench]:
    """Open the user's bench: a context manager of `function(settings, tools)`. The caller has asked for leave to move.

    Raises:
        UsageError: the function cannot be found, fails as it opens, or gives no bench.
        DeviceError: it fails as it closes.
    """
    with ExitStack() as stack:
        try:
            driver = stack.enter_context(load_own(settings.kind)(dict(settings.settings), dict(tools)))
        except FastError:
            raise
        except Exception as error:
            raise UsageError(
                f"`{settings.kind}` did not open a bench ({type(error).__name__}: {error}); correct it and start again."
            ) from error
        missing = [name for name in vars(GraspBench) if not name.startswith("_") and not hasattr(driver, name)]
        if missing:
            raise UsageError(f"The bench of `{settings.kind}` has no `{missing[0]}`; write it and start again.")
        yield OwnBench(settings.kind, driver, tools)
        with _told(settings.kind):
            stack.close()


@contextmanager
def _told(kind: str, stop: Callable[[], str] | None = None) -> Iterator[None]:
    """Make one sentence of what a driver raises that is no `FastError`; `stop` stops it, and says what became of it."""
    try:
        yield
    except FastError:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name} line {at.lineno}"
        become = f"; {stop()}" if stop is not None else ""
        raise OwnDriverError(
            f"The driver `{kind}` failed ({type(error).__name__}: {error}; {where}){become}. Finished grasps are kept. "
            "Look at the machine, correct the driver, then start the campaign again."
        ) from error


def _doubt_unit(tare_force_n: float, tool_n: float) -> str:
    """Return words for a gross force that is no force in N of a gripper with this tool; 0 tells nothing."""
    share, (least, most) = abs(tare_force_n) / tool_n, _SHARES_OF_KG
    unit = "kg" if least <= share < most else "g" if share >= _LEAST_SHARE_OF_G else ""
    if not unit:
        return ""
    return (
        f"says that the free gripper pulls with {tare_force_n:.3g} N, and its tool alone weighs {tool_n:.3g} N: that "
        f"looks like {unit}, and forces are in N."
    )


def _call(failed: list[Exception], function: Callable[[], _T]) -> _T:
    """Call a function of the campaign; what it raises is noted, so that it is not taken for the driver's."""
    try:
        return function()
    except Exception as error:
        failed.append(error)
        raise


def _grasp_of(item: Item) -> tuple[int, int]:
    return (item.object_id, item.repeat) if isinstance(item, GraspRequest) else item
