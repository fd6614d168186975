import gc
import os
import signal
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from fast.flows.cli.main import leave
from tests.peers import list_peers

_STATUS: list[int] = []
_HERE = Path(__file__).parent
settings.register_profile("quick", max_examples=40)  # a test that needs more says so
settings.load_profile("quick")
# Wire logs of benches moved by hand go to the user's state folder: not to that of whoever runs the tests.
_STATE = tempfile.TemporaryDirectory(prefix="fast-tests-")
os.environ["XDG_STATE_HOME"] = _STATE.name
gc.set_threshold(50_000)  # as `fast` has it
# Started with nohup or from cron, pytest ignores Ctrl-C, and so would every child that a test ends with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def _no_waiting_for_the_disk() -> Iterator[None]:
    """No test cuts the power: what a killed process has written survives without `fsync`, which costs 10 ms a call."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _descriptor: None)
        yield


@pytest.fixture(autouse=True)
def _no_settings_of_another_test() -> Iterator[None]:
    """A campaign that ran in this process leaves its settings of Prefect; the next test has those of before."""
    before = {name: value for name, value in os.environ.items() if name.startswith("PREFECT_")}
    yield
    for name in [name for name in os.environ if name.startswith("PREFECT_") and name not in before]:
        del os.environ[name]
    os.environ.update(before)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Folders take turns: tests of devices wait, tests of models compute, and side by side they fill the cores.

    Files with slow tests are among the first half, lest a worker end alone.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    files: dict[str, list[Path]] = defaultdict(list)
    for path in dict.fromkeys(item.path for item in items):
        files["slow" if path in slow else os.path.relpath(path, _HERE).split(os.sep)[0]].append(path)
    turns = {path: place / len(group) for group in files.values() for place, path in enumerate(group)}
    items.sort(key=lambda item: turns[item.path] / (2.0 if item.path in slow else 1.0))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say which programs of others were there, and how many tests were left out for want of what."""
    peers = list_peers()
    here = [f"{name} ({version})" for name, version in peers.items() if version]
    gone = [name for name, version in peers.items() if not version]
    terminalreporter.write_line(f"peers: {', '.join(here) or 'none'}; missing: {', '.join(gone) or 'none'}")
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in skipped)
    for reason, n in reasons.most_common():
        terminalreporter.write_line(f"skipped {n}: {reason}")


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    _STATUS.append(int(exitstatus))


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: Any) -> None:
    """End as the command line does: service threads still alive make DuckDB's binding print pages of leaks."""
    _STATE.cleanup()
    if _STATUS:
        leave(_STATUS[-1])
