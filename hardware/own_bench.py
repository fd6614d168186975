"""The bench file of a machine that FAST does not know: it names the function that opens a driver of the user's own."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from pydantic import Field

from fast.hardware.grasp_bench import GraspBench
from fast.hardware.tools.mounted import MountedTool
from fast.models.errors import FastError, UsageError
from fast.models.own_code import load_own
from fast.models.records import Record


class OwnBenchSettings(Record):
    """A driver, and what it is told; `docs/how-to/write-a-bench-driver.md` says what it must do."""

    kind: str = Field(description="`module:function` that opens the bench")
    moves: str = Field(min_length=1, description="what will move: said to the person who gives leave")
    settings: dict[str, Any] = Field(default_factory=dict, description="what the function is given")


@contextmanager
def open_own_bench(settings: OwnBenchSettings, tools: Mapping[int, MountedTool]) -> Iterator[GraspBench]:
    """The user's bench, open: a context manager of `function(settings, tools)`. The caller has asked for leave to move.

    Raises:
        UsageError: the function cannot be found, fails as it opens, or gives no bench.
    """
    with ExitStack() as stack:
        try:
            bench = stack.enter_context(load_own(settings.kind)(dict(settings.settings), dict(tools)))
        except FastError:
            raise
        except Exception as error:
            raise UsageError(
                f"`{settings.kind}` did not open a bench ({type(error).__name__}: {error}); correct it and start again."
            ) from error
        missing = [name for name in vars(GraspBench) if not name.startswith("_") and not hasattr(bench, name)]
        if missing:
            raise UsageError(f"The bench of `{settings.kind}` has no `{missing[0]}`; write it and start again.")
        yield bench
