"""`fast doctor`: what this machine has and lacks; each failing check ends with its fix."""

import importlib.util
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show

PACKAGES = ("prefect", "duckdb", "pyarrow", "torch", "botorch", "gpytorch", "pymc", "trimesh", "pytetwild",
            "serial", "pymodbus", "rerun", "numba", "shapely", "qdldl", "matplotlib")  # fmt: skip
MIN_FREE_GB = 2.0

Check = tuple[str, bool, str]  # name, passed, what was seen or the fix


def doctor(*, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Check dependencies, solver, mesher, server and disk."""
    checks: list[Check] = [_python(), *map(_package, PACKAGES), _fastapi(), _disk(lake), _lake(lake), _serial_ports()]
    checks += [_try("FEM solves a small grasp", _small_grasp, "run `make setup` again; the solver package is broken")]
    data = [{"check": name, "ok": ok, "note": note} for name, ok, note in checks]
    lines = [f"{'ok  ' if ok else 'FAIL'}  {name:<32}  {note}" for name, ok, note in checks]
    show(data, "\n".join(lines), json)
    if not all(ok for _, ok, _ in checks):
        sys.exit(1)


def _python() -> Check:
    version = ".".join(map(str, sys.version_info[:3]))
    ok = (3, 11) <= sys.version_info[:2] < (3, 13)
    return "python", ok, version if ok else f"{version}; install Python 3.11 and run `make setup`"


def _package(name: str) -> Check:
    found = importlib.util.find_spec(name) is not None
    return f"package {name}", found, "" if found else "missing; run `make setup`"


def _fastapi() -> Check:
    from importlib.metadata import PackageNotFoundError, version

    try:
        found = version("fastapi")
    except PackageNotFoundError:
        return "fastapi version", False, "missing; run `make setup`"
    ok = (0, 139) <= tuple(int(part) for part in found.split(".")[:2]) < (0, 151)
    return "fastapi version", ok, found if ok else f"{found} breaks the Prefect server; run `make setup`"


def _disk(lake: Path) -> Check:
    folder = next(p for p in [lake.absolute(), *lake.absolute().parents] if p.exists())
    free_gb = shutil.disk_usage(folder).free / 1e9
    ok = free_gb > MIN_FREE_GB
    note = f"{free_gb:.0f} GB free"
    return "disk", ok, note if ok else f"{note} at {folder}, at least {MIN_FREE_GB:.0f} GB needed; free some"


def _lake(lake: Path) -> Check:
    from lake.store import Lake
    from models.errors import FastError

    if not lake.exists():
        return "lake", True, f"none yet at {lake}; `fast campaign run` makes one"
    try:
        Lake.open(lake)
    except FastError as error:
        return "lake", False, str(error)
    ok = os.access(lake, os.W_OK)
    return "lake", ok, str(lake) if ok else f"{lake} is read-only; correct its permissions"


def _serial_ports() -> Check:
    from serial.tools import list_ports

    ports = [port.device for port in list_ports.comports()]
    return "serial ports", True, ", ".join(ports) or "none (a virtual bench needs none)"


def _small_grasp() -> str:
    from models.design_space import BEST_PUBLISHED
    from models.fem.grasp import simulate_grasp
    from models.objects.catalogue import get_object
    from models.records import GraspSetup

    result = simulate_grasp(BEST_PUBLISHED, get_object(0), setup=GraspSetup(max_lift_mm=2))
    return f"{result.n_dof} degrees of freedom in {result.cpu_s:.1f} s of CPU"


def _try(name: str, check: Callable[[], str], fix: str) -> Check:
    try:
        return name, True, check()
    except Exception as error:
        return name, False, f"{error}; {fix}"
