"""A virtual arm in a process of its own, as a test's other end of the line."""

import json
import os
import subprocess
import sys
from itertools import count
from pathlib import Path

from fast.hardware.arm.settings import ArmSettings

ROOT = Path(__file__).parents[3]
SPEED_UP = 25.0
_ADDRESSES = count(10)  # 127.0.x.y, so that tests side by side have port 30004 each


class ArmProcess:
    """A controller that listens, and what a test does to it."""

    def __init__(self, speed_up: float = SPEED_UP) -> None:
        host = f"127.0.{os.getpid() % 200 + 20}.{next(_ADDRESSES)}"
        command = [sys.executable, "-m", "tests.hardware.arm.arm_process", host, str(speed_up)]
        self._process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.settings = ArmSettings.model_validate(self._answer())

    def _answer(self) -> dict:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def tell(self, command: str) -> dict:
        """Send a command; returns tool on the flange, tools in the rack and height."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{command}\n")
        self._process.stdin.flush()
        return self._answer()

    def end(self) -> None:
        self._process.kill()
        self._process.communicate()
