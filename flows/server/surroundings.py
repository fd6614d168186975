"""What this machine must grant before a server is started, looked at while nothing is written yet."""

import json
import os
import resource
import socket
import subprocess
import sys
import tempfile

from fast.flows.server.environment import LOGIN_VARIABLE, OWN_PREFIX, PREFIX, SERVER_VARIABLE
from fast.flows.server.loopback import LOOPBACK
from fast.flows.server.server import reach_named_server
from fast.models.errors import UsageError

MIN_OPEN_FILES = 128  # the server has the most, about 60
_TALK_LIMIT_S = 5.0
# Each setting alone: Prefect names the first one that it cannot use by its last word only.
_ASK_PREFECT = """
import json, os, sys
import prefect.settings
from pydantic import ValidationError
for name, value in json.load(sys.stdin).items():
    if not hasattr(prefect.settings, name):
        sys.exit(print(json.dumps([name, "is no setting of Prefect"])))
    os.environ[name] = value
    try:
        prefect.settings.Settings()
    except ValidationError as error:
        sys.exit(print(json.dumps([name, error.errors()[0]["msg"]])))
    del os.environ[name]
"""


def check_surroundings() -> None:
    """Raise UsageError where a limit of this process, its loopback or a setting `FAST_PREFECT_...` is of no use."""
    _check_open_files()
    check_loopback()
    _check_own_settings()
    reach_named_server()


def _check_open_files() -> None:
    """Take as many open files as are allowed; children take them over."""
    taken, allowed = resource.getrlimit(resource.RLIMIT_NOFILE)
    if allowed != resource.RLIM_INFINITY and allowed < MIN_OPEN_FILES:
        raise UsageError(
            f"this process may have {allowed} open files at once, at least {MIN_OPEN_FILES} are needed; "
            "`ulimit -n 1024` allows more, else ask who runs this machine."
        )
    if taken != resource.RLIM_INFINITY and taken < MIN_OPEN_FILES:
        resource.setrlimit(resource.RLIMIT_NOFILE, (MIN_OPEN_FILES, allowed))


def check_loopback() -> int:
    """Return a port on which a process of this machine reached another one.

    Raises:
        UsageError: it reached none.
    """
    try:
        with socket.create_server((LOOPBACK, 0)) as listener:
            port = int(listener.getsockname()[1])
            with socket.create_connection((LOOPBACK, port), timeout=_TALK_LIMIT_S):
                return port
    except OSError as error:
        raise UsageError(
            f"programs on this machine cannot reach each other at {LOOPBACK} ({error.strerror or error}); allow it, "
            "and have the loopback interface up (`ip link set lo up`)."
        ) from error


def _check_own_settings() -> None:
    """Ask Prefect, in a process of its own: this one's takes its settings later, and only once."""
    own = {
        name.removeprefix("FAST_"): value
        for name, value in sorted(os.environ.items())
        if name.startswith(OWN_PREFIX) and name not in (SERVER_VARIABLE, LOGIN_VARIABLE)
    }
    if not own:
        return
    clean = {name: value for name, value in os.environ.items() if PREFIX not in name}
    with tempfile.TemporaryDirectory(prefix="fast-settings-") as empty:
        asked = subprocess.run(
            [sys.executable, "-c", _ASK_PREFECT],
            input=json.dumps(own), env={**clean, "PREFECT_HOME": empty}, cwd=empty, capture_output=True, text=True,
        )  # fmt: skip
    if asked.stdout:
        name, problem = json.loads(asked.stdout)
        raise UsageError(f"FAST_{name} is `{own[name]}`: {problem}; correct it or unset it.")
