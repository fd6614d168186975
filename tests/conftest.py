from typing import Any

import pytest

from flows.cli.main import leave

_STATUS: list[int] = []


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    _STATUS.append(int(exitstatus))


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: Any) -> None:
    """End as the command line does: service threads still alive make DuckDB's binding print pages of leaks."""
    if _STATUS:
        leave(_STATUS[-1])
