"""`fast doctor`: what this machine has and lacks; each failing check ends with its fix."""

import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show, table_text
from fast.flows.cli.speed import measure_speed
from fast.flows.cli.wire import log_folder
from fast.flows.dependencies import ALL, BASE, LOCK, find_mismatches, is_checkout, is_installed, missing_sentence
from fast.models.errors import FastError

MIN_FREE_GB = 2.0
MESH_LIMIT_S = 60.0


class Check(NamedTuple):
    """One check: what was seen, or what is wrong and how to fix it."""

    name: str
    ok: bool
    note: str


def doctor(
    *,
    lake: LakePath = DEFAULT_LAKE,
    server: Annotated[
        bool, Parameter(negative="", help="Also start a Prefect server and stop it again (up to a minute).")
    ] = False,
    speed: Annotated[
        bool, Parameter(negative="", help="Say instead what this computer takes for grasps, fits and searches.")
    ] = False,
    real: Annotated[
        Path | None, Parameter(help="Bench file: look at that bench's devices instead. Nothing moves.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Check Python, packages, solver, mesher, disk, lake and ports; exit status 1 when a check fails."""
    if speed:
        rows = measure_speed()
        show(rows, table_text(rows), json)
        return
    _show_checks(_bench(real) if real is not None else _computer(lake, server), json)


def _show_checks(checks: list[Check], as_json: bool) -> None:
    lines = [f"{'ok  ' if check.ok else 'FAIL'}  {check.name:<18} {check.note}" for check in checks]
    show([check._asdict() for check in checks], "\n".join(lines), as_json)
    if not all(check.ok for check in checks):
        sys.exit(1)


def _bench(bench_file: Path) -> list[Check]:
    from fast.hardware.checkup.bench import check_bench
    from fast.tasks.campaign.setup import read_bench

    return [Check(*finding) for finding in check_bench(read_bench(bench_file), log_folder=log_folder(None))]


def _computer(lake: Path, server: bool) -> list[Check]:

    checks = [_python(), _packages(), _versions(), _disk(lake), _lake(lake)]
    if is_installed("prefect"):
        checks.append(_fastapi())
    checks += [
        _try("server", lambda: _running(lake), "delete .state/server.json of the lake"),
        _try("notifications", _notifications, "correct FAST_NOTIFY (https://appriseit.com/services/)"),
        _try("devices", _serial_ports, "pyserial is broken; run `make setup`"),
        _try("loopback ports", _loopback, "allow programs to listen on 127.0.0.1"),
        _try("serial pty", _pty, "mount devpts at /dev/pts; virtual benches need it"),
        _try("grasp simulation", _small_grasp, "the solver is broken; run `make clean setup`"),
    ]
    if is_installed("pytetwild"):
        fix = 'run `make clean setup`, or keep mesher = "extruded" in your configs'
        checks.append(_try("mesher fTetWild", _small_mesh, fix))
    if server:
        checks.append(_try("Prefect server", _server, "run `make clean setup`"))
    return checks


def _python() -> Check:
    version = ".".join(map(str, sys.version_info[:3]))
    ok = (3, 11) <= sys.version_info[:2] < (3, 13)
    return Check("python", ok, version if ok else f"{version}; install Python 3.11 or 3.12, then `make clean setup`")


def _packages() -> Check:

    wanted = ALL if is_checkout() else BASE
    missing = [name for name in wanted if not is_installed(name)]
    if missing:
        return Check("packages", False, missing_sentence(missing))
    absent = [name for name in ALL if not is_installed(name)]
    note = f"all {len(wanted)} are installed"
    return Check("packages", True, f"the base is whole; for more, {missing_sentence(absent)}" if absent else note)


def _versions() -> Check:

    wrong = list(find_mismatches(LOCK.read_text(encoding="utf-8"))) if LOCK.exists() else []
    others = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
    return Check("versions", not wrong, f"{wrong[0]}{others}" if wrong else "as in requirements.lock")


def _fastapi() -> Check:
    from importlib.metadata import PackageNotFoundError, version

    try:
        found = version("fastapi")
    except PackageNotFoundError:
        return Check("fastapi version", False, "missing; run `make setup`")
    ok = (0, 139) <= tuple(int(part) for part in found.split(".")[:2]) < (0, 151)
    note = found if ok else f"{found}, the Prefect server needs 0.139 to 0.150; run `make clean setup`"
    return Check("fastapi version", ok, note)


def _disk(lake: Path) -> Check:
    from fast.lake.storage.open import storage_at

    root = storage_at(lake).root.absolute()
    folder = next(p for p in [root, *root.parents] if p.exists())
    free_gb = shutil.disk_usage(folder).free / 1e9
    ok = free_gb > MIN_FREE_GB
    note = f"{free_gb:.0f} GB free"
    return Check("disk", ok, note if ok else f"{note} at {folder}, at least {MIN_FREE_GB:.0f} GB needed; free some")


def _lake(lake: Path) -> Check:
    from fast.lake.storage.open import storage_at

    storage = storage_at(lake)
    try:
        if storage.is_empty():
            return Check("lake", True, f"none yet at {storage.address}; `fast campaign run` makes one")
        open_lake(lake)
        storage.try_writing()
    except FastError as error:
        return Check("lake", False, str(error))
    except OSError as error:
        return Check("lake", False, f"{lake} cannot be written ({error.strerror}); correct its permissions")
    return Check("lake", True, f"{storage.address} can be read and written")


def _serial_ports() -> str:
    from serial.tools import list_ports

    ports = [port.device for port in list_ports.comports()]
    return ", ".join(ports) or "no serial port (a virtual bench needs none)"


def _running(lake: Path) -> str:
    import socket

    from fast.flows.server.access import address_for_person
    from fast.flows.server.loopback import LOOPBACK
    from fast.flows.server.server import DEFAULT_PORT, find_server, reach_named_server, report_ignored
    from fast.lake.storage.open import storage_at

    if named := reach_named_server():
        return f"named by FAST_PREFECT_API_URL: {named.page}"
    ignored = f"; {sentence}" if (sentence := report_ignored()) else ""
    if known := find_server(storage_at(lake).root):
        return f"of this lake: {address_for_person(known)}{ignored}"
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, DEFAULT_PORT))
        except OSError:
            return f"none of this lake; port {DEFAULT_PORT} is taken, so give `fast serve` another --port{ignored}"
    return f"none of this lake; `fast serve` starts one, port {DEFAULT_PORT} is free{ignored}"


def _notifications() -> str:
    from fast.flows.campaign.notify import VARIABLE

    addresses = os.environ.get(VARIABLE, "").split()
    if not addresses:
        return f"none; set {VARIABLE} to be told when a person is needed"
    import apprise

    n_wrong = sum(apprise.Apprise.instantiate(address) is None for address in addresses)
    if n_wrong:
        raise ValueError(f"{n_wrong} of {len(addresses)} addresses in {VARIABLE} are not understood")
    return f"{len(addresses)} addresses in {VARIABLE}; nothing was sent"


def _loopback() -> str:
    from fast.flows.server.surroundings import check_loopback

    return f"programs reach each other (tried port {check_loopback()})"


def _pty() -> str:
    for handle in os.openpty():
        os.close(handle)
    return "opens"


def _small_grasp() -> str:
    from fast.models.design.space import BEST_PUBLISHED
    from fast.models.objects.catalogue import get_object
    from fast.models.records import GraspSetup
    from fast.models.simulation.grasp import simulate_grasp

    result = simulate_grasp(BEST_PUBLISHED, get_object(0), setup=GraspSetup(max_lift_mm=2))
    return f"2 mm of lift, {result.n_dof} degrees of freedom in {result.cpu_s:.1f} s of CPU"


def _small_mesh() -> str:
    import trimesh

    from fast.models.simulation.mesh.tetwild import tetrahedralise

    box = trimesh.creation.box(extents=(10, 10, 10))
    _, tetrahedra = tetrahedralise(box.vertices, box.faces, 5.0, MESH_LIMIT_S)
    return f"a box gave {len(tetrahedra)} tetrahedra"


def _server() -> str:
    from fast.flows.server.server import server

    with tempfile.TemporaryDirectory(prefix="fast-doctor-") as folder, server(Path(folder)) as api:
        return f"answered at {api.page}"


def _try(name: str, check: Callable[[], str], fix: str) -> Check:
    try:
        return Check(name, True, check())
    except Exception as error:
        return Check(name, False, f"{str(error).rstrip('.')}; {fix}")
