"""The service of the documents leaves what it stops the time that this needs."""

import configparser
import re
from pathlib import Path

from fast.flows.server.child_process import STOP_LIMIT_S
from fast.flows.server.run_process import ASKED_S

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "operate-a-lab.md"


def test_a_service_asks_fast_serve_alone_and_waits_for_it():
    """Asked by both, a run heard "stop" after "pause", and was killed before its grasp was finished."""
    (unit,) = re.findall(r"```ini\n(.*?)```", PAGE.read_text(), re.DOTALL)
    read = configparser.ConfigParser()
    read.read_string(unit)
    assert read["Service"]["KillMode"] == "mixed"
    assert float(read["Service"]["TimeoutStopSec"]) > ASKED_S + 3 * STOP_LIMIT_S  # page, worker and server
