"""Programs of others that tests run against, for the last lines of a test run: which are here, which were missing."""

import ctypes.util
import os
import shutil
import subprocess
from pathlib import Path


def list_peers() -> dict[str, str | None]:
    """What is known of each peer, by name: its version or file, or None where it is not here."""
    board = shutil.which("cc") and Path("/usr/include/simavr/sim_avr.h").exists()
    image = os.environ.get("FAST_GRBL_IMAGE")
    return {
        "CalculiX": _version("calculix-ccx") if shutil.which("ccx") else None,
        "chromium": _version("chromium") if shutil.which("chromium") else None,
        "libmodbus": ctypes.util.find_library("modbus"),
        "mbpoll": _version("mbpoll") if shutil.which("mbpoll") else None,
        "socat": _version("socat") if shutil.which("socat") else None,
        "grbl-Mega on simavr": Path(image).name if board and image and Path(image).is_file() else None,
        "grblHAL": _file(os.environ.get("FAST_GRBLHAL_SIM")) if shutil.which("cc") else None,
        "pyclickplc": "own environment" if os.environ.get("FAST_PYCLICKPLC_PYTHON") else None,
    }


def _file(path: str | None) -> str | None:
    return Path(path).name if path and Path(path).is_file() else None


def _version(package: str) -> str:
    said = subprocess.run(["dpkg-query", "-W", "-f=${Version}", package], capture_output=True, text=True, check=False)
    return said.stdout.strip() or "here"
