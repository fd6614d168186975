import os
import tempfile
from typing import Any

import pytest

from flows.cli.main import leave

_STATUS: list[int] = []
# Wire logs of benches moved by hand go to the user's state folder: not to that of whoever runs the tests.
_STATE = tempfile.TemporaryDirectory(prefix="fast-tests-")
os.environ["XDG_STATE_HOME"] = _STATE.name


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    _STATUS.append(int(exitstatus))


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: Any) -> None:
    """End as the command line does: service threads still alive make DuckDB's binding print pages of leaks."""
    _STATE.cleanup()
    if _STATUS:
        leave(_STATUS[-1])
