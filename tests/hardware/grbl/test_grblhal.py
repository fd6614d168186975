"""The driver on grblHAL, GRBL's successor on 32-bit boards, as its authors' simulator runs it.

`FAST_GRBLHAL_SIM` names the program; without it, socat, or on another kind of machine the test is left out.
"""

import os
import shutil
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from fast.hardware.clock import RealClock
from fast.hardware.grbl.errors import ProfileMismatchError
from fast.hardware.grbl.profile import LAB_SETTINGS, GrblProfile
from fast.hardware.grbl.session import GrblSession
from fast.hardware.wire.serial import SerialTransport

SIMULATOR = os.environ.get("FAST_GRBLHAL_SIM")
pytestmark = pytest.mark.skipif(
    SIMULATOR is None or not Path(SIMULATOR).is_file() or shutil.which("socat") is None,
    reason="FAST_GRBLHAL_SIM names no simulator of grblHAL, or socat is missing",
)
# What the simulator has when it is new, of the settings that GRBL has too.
NEW = {0: 5, 1: 25, 2: 0, 3: 0, 4: 7, 5: 0, 6: 0, 10: 511, 11: 0.010, 12: 0.002, 13: 0, 20: 0, 21: 0, 22: 0, 23: 0,
       24: 25, 25: 500, 26: 250, 27: 1, 30: 1000, 31: 0, 32: 0, 100: 250, 101: 250, 102: 250, 110: 500, 111: 500,
       112: 500, 120: 10, 121: 10, 122: 10, 130: 200, 131: 200, 132: 200}  # fmt: skip


@pytest.fixture
def port(tmp_path):
    link = tmp_path / "tty"
    program = f"EXEC:{SIMULATOR} -n -t 1 -s /dev/null -b /dev/null -e {tmp_path / 'settings.dat'},pty,raw,echo=0"
    process = subprocess.Popen(["socat", f"PTY,raw,link={link},echo=0", program])
    deadline_s = time.monotonic() + 10.0
    while not link.exists() and time.monotonic() < deadline_s:
        time.sleep(0.05)
    yield str(link)
    process.kill()
    process.wait(10.0)
    for other in psutil.process_iter(["cmdline"]):  # the simulator is in a session of its own
        if str(tmp_path / "settings.dat") in (other.info["cmdline"] or []):
            other.kill()


def test_settings_that_grbl_does_not_have_are_no_fault_and_those_of_safety_are(port):
    profile = GrblProfile(settings={**LAB_SETTINGS, **NEW})
    session = GrblSession(SerialTransport(port), RealClock(), profile)
    session.connect()
    try:
        assert any("grblHAL" in line for line in session.build)
        found = session._settings("reading")
        assert len(found) > len(LAB_SETTINGS) + 30
        assert profile.differences(found) == []
        assert session.link.request_report(5.0).state == "Idle"
        session.reset("test")  # it answers after a reset too
        assert session.link.request_report(5.0) is not None
    finally:
        session.close()


def test_a_new_board_is_refused_with_the_settings_that_matter(port):
    session = GrblSession(SerialTransport(port), RealClock(), GrblProfile())
    with pytest.raises(ProfileMismatchError, match=r"\$0 is 5, profile 10"):
        session.connect()
