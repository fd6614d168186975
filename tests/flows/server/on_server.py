"""A Prefect server of a test: Python run on it, questions to it, waiting for what it does."""

import json
import os
import subprocess
import sys
import time
import urllib.request

from fast.flows.server.server import state_folder
from tests.flows.cli.cli_lakes import ROOT


def python(url, root, *words, **settings):
    """Run Python on a server, with these variables of the environment; returns what it printed."""
    environment = {**os.environ, "PREFECT_API_URL": url, "PREFECT_HOME": str(state_folder(root))}
    environment |= {"FAST_CHECKOUT": str(ROOT), "FAST_LAKE": "lake-data", **settings}
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def asked(url, path, **body):
    """Answer of a POST to the server."""
    data, headers = json.dumps(body).encode(), {"Content-Type": "application/json"}
    with urllib.request.urlopen(urllib.request.Request(f"{url}{path}", data, headers), timeout=30) as answer:
        return json.load(answer)


def wait_for(condition, limit_s=120.0):
    """What the condition says once it is true."""
    deadline = time.monotonic() + limit_s
    while time.monotonic() < deadline:
        found = condition()
        if found:
            return found
        time.sleep(0.5)
    raise AssertionError("it did not come in time")
