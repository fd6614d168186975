"""Waiting for what another thread or process is about to do."""

import time
from collections.abc import Callable
from typing import Any


def wait_for(condition: Callable[[], Any], limit_s: float = 120.0) -> Any:
    """What the condition says once it is true; an assertion fails if that takes longer."""
    deadline, pause_s = time.monotonic() + limit_s, 0.005
    while True:
        found = condition()
        if found:
            return found
        assert time.monotonic() < deadline, f"it did not come in {limit_s:g} s"
        time.sleep(pause_s)
        pause_s = min(1.5 * pause_s, 0.2)
