"""Solved grasps of worlds in files, by content: a restarted bench, or another process, does not solve them again."""

import json
import logging
import os
import tempfile
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fast.hardware.virtual.world.physics import PhysicsRequest
from fast.models.ids import canonical_json, content_id
from fast.models.records import GraspSimulation, Trace
from fast.models.solver_code import solver_id, source_id

logger = logging.getLogger(__name__)

MAX_FILES = 20_000  # of some 5 kB: the grasps of 500 tools
_CHANNELS = ("time_s", "lift_mm", "force_n")
_WORLD_SOURCES = ("hidden.py", "physics.py")


@cache
def physics_id() -> str:
    """Return the id of the source code that decides a world's physics: the solver's, and that of the hidden laws."""
    return f"{solver_id()}-{source_id(Path(__file__).parent, _WORLD_SOURCES)}"


class PhysicsFiles:
    """A folder of solved grasps, for any number of processes at once.

    A file holds the whole request and the id of the code beside the result: what differs in anything that decides it
    is not found. Files are written whole or not at all; without a place to write, nothing is kept and a warning says
    so. Beyond `max_files` the oldest go.
    """

    def __init__(self, folder: Path, max_files: int = MAX_FILES) -> None:
        self._folder = folder
        self._max_files = max_files

    def get(self, request: PhysicsRequest) -> GraspSimulation | None:
        """Get the kept result of a request, or None."""
        content = _content(request)
        path = self._path(content)
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            return _simulation(kept["result"]) if kept["content"] == content else None
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            logger.warning("kept physics %s is unreadable (%s); solving again", path, error)
            return None

    def put(self, request: PhysicsRequest, result: GraspSimulation) -> None:
        """Keep the result of a request."""
        content = _content(request)
        text = canonical_json({"content": content, "result": _numbers(result)})
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            _write_whole(self._path(content), text)
            self._remove_oldest()
        except OSError as error:
            logger.warning("physics is not kept in %s (%s); it will be solved again", self._folder, error.strerror)

    def _path(self, content: dict[str, Any]) -> Path:
        return self._folder / f"{content_id('B', content)}.json"

    def _remove_oldest(self) -> None:
        files = list(self._folder.glob("*.json"))
        if len(files) <= self._max_files:
            return
        for path in sorted(files, key=_age_key)[: len(files) - self._max_files]:
            path.unlink(missing_ok=True)


def _content(request: PhysicsRequest) -> dict[str, Any]:
    """Return all that decides the result: not the tool's name, and its own seed only where there are hidden effects."""
    asked = request.model_dump(mode="json", exclude={"tool_id"} if request.hidden else {"tool_id", "tool_seed"})
    return {"physics": physics_id(), "family": request.design.family, "request": asked}


def _numbers(result: GraspSimulation) -> dict[str, Any]:
    channels = {name: getattr(result.trace, name).tolist() for name in _CHANNELS}
    return {**asdict(result), "trace": channels}


def _simulation(numbers: dict[str, Any]) -> GraspSimulation:
    trace = Trace(*(np.array(numbers["trace"][name], dtype=float) for name in _CHANNELS))
    return GraspSimulation(**{**numbers, "trace": trace})


def _write_whole(path: Path, text: str) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _age_key(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0  # another process removed it
