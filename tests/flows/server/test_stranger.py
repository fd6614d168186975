"""A stranger at every server that a `fast` command starts: a page of another site, a name pointed here, another user.

The pages of a lake and of a recording refuse them all. The devices of a virtual bench have no password, as real ones;
there it is shown what a page of a browser cannot do to them, and what a program of another user can.
"""

import os
import re
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import httpx
import pytest

from fast.flows.server.access import own_login
from fast.flows.server.lab import LabPlan, open_lab
from fast.flows.server.page_port import serve_page
from fast.flows.server.server import ANY_PORT, server
from fast.flows.viewer.page import open_page
from fast.hardware.bench import open_virtual_bench
from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.clock import ScaledClock
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.arm.controller import VirtualArm
from fast.hardware.virtual.arm.server import ArmServer
from fast.hardware.virtual.bench import VirtualBench
from fast.hardware.virtual.world.file import World
from fast.lake.store import Lake
from tests.flows.cli.cli_lakes import ROOT
from tests.studies.platform.sockets import family, is_loopback, listening
from tests.waiting import wait_for


@contextmanager
def serve(root: Path) -> Iterator[list[str]]:
    with open_lab(Lake.open(root, create=True), LabPlan(ANY_PORT, page_port=ANY_PORT)) as lab:
        yield [lab.api.page, lab.page.page]


@contextmanager
def run_campaign(root: Path) -> Iterator[list[str]]:
    lake = Lake.open(root, create=True)
    with server(root) as api, serve_page(lake, ANY_PORT) as page:
        yield [api.page, page.page]


@contextmanager
def view(root: Path) -> Iterator[list[str]]:
    recording = root / "x.rrd"
    recording.parent.mkdir()
    recording.write_bytes(b"secret")
    with open_page(recording, own_login(root), threading.Event()) as address:
        yield [address.partition("/?")[0]]


PAGES: dict[str, Callable[[Path], AbstractContextManager[list[str]]]] = {
    "fast serve": serve,
    "fast campaign run": run_campaign,
    "fast view": view,
}
# Where the product listens, or has it done: each is opened in this file, or by the doctor for a moment.
PLACES = {
    "flows/server/surroundings.py", "flows/server/loopback.py", "flows/server/server_process.py",
    "flows/viewer/page.py", "flows/page/process.py",
    "hardware/virtual/arm/server.py", "hardware/virtual/modbus_server.py",
}  # fmt: skip


def attack(url, login):
    """Statuses that a stranger gets, by path and by what he is; what is done in a browser is done with the key."""
    port, mine = url.rpartition(":")[2], tuple(login.split(":", 1))
    evil, json = {"Origin": "http://evil.example"}, {"name": "evil"}
    preflight = {**evil, "Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "content-type"}
    picture = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
    statuses = {}
    with httpx.Client(base_url=url, timeout=60.0) as client:
        for path in ("/", "/api/flows/", "/outputs/", "/recording.rrd"):
            answers = {
                "origin": client.post(path, headers=evil, json=json, auth=mine),
                "preflight": client.options(path, headers=preflight, auth=mine),
                "picture": client.get(path, headers=picture, auth=mine),
                "rebinding": client.get(path, headers={"Host": f"evil.example:{port}"}, auth=mine),
                "other user": client.get(path),
                "other user's program": client.post(path, json=json),
                "other user who guesses": client.get(path, auth=("fast", "guess")),
            }
            assert not any("access-control-allow-origin" in answer.headers for answer in answers.values())
            statuses[path] = {who: answer.status_code for who, answer in answers.items()}
    return statuses


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("command", PAGES)
def test_a_stranger_is_refused_on_every_port_that_a_command_opens(command, tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    monkeypatch.delenv("FAST_PASSWORD", raising=False)
    before = listening(family(os.getpid()))
    with PAGES[command](tmp_path / "lake") as urls:
        ports = {("127.0.0.1", int(url.rpartition(":")[2])) for url in urls}
        assert listening(family(os.getpid())) - before == ports
        login = own_login(tmp_path / "lake")
        for url in urls:
            for path, answers in attack(url, login).items():
                assert answers == {who: 401 if "user" in who else 403 for who in answers}, (url, path)
            # Whom the key lets in gets further than the gate.
            assert httpx.get(url, auth=tuple(login.split(":", 1)), timeout=60.0).status_code in (200, 303, 307)


def test_every_place_of_the_product_that_listens_is_known_here():
    listens = re.compile(
        r"\.listen\(\)|create_server\(|HTTPServer\(|uvicorn\.Server|--serve-|serve_grpc|serve_web|spawn\("
    )
    found = {
        str(path.relative_to(ROOT))
        for name in ("flows", "tasks", "lake", "hardware", "models")
        for path in (ROOT / name).rglob("*.py")
        if listens.search(path.read_text())
    }
    assert found == PLACES


def say(place, words):
    """What a port answers to these bytes within a moment."""
    with socket.create_connection(place, timeout=10.0) as link:
        link.sendall(words)
        link.shutdown(socket.SHUT_WR)
        link.settimeout(0.5)
        try:
            return link.recv(1000)
        except (TimeoutError, ConnectionResetError):
            return b""


def as_a_page(words):
    """The bytes that a browser makes of what a page of another site posts without asking first."""
    head = "POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example\r\nContent-Type: text/plain\r\n"
    return f"{head}Content-Length: {len(words)}\r\n\r\n".encode() + words


def test_a_page_cannot_command_the_devices_of_a_virtual_bench_and_a_program_of_any_user_can():
    coil = parse_address(tags.GRIP_REQUEST).wire
    grip = struct.pack(">HHHBBHH", 1, 0, 6, 1, 5, coil, 0xFF00)
    is_gripping = struct.pack(">HHHBBHH", 2, 0, 6, 1, 1, coil, 1)
    before = listening({os.getpid()})
    bench = VirtualBench(World(seed=7), {}, lambda request: None, ScaledClock(10.0), BenchLayout())
    at = bench.start(0, 0)
    plc, transmitter = (at.plc_host, at.plc_port), (at.transmitter_host, at.transmitter_port)
    try:
        assert listening({os.getpid()}) - before == {plc, transmitter}
        for place in (plc, transmitter):
            assert is_loopback(place[0])
            assert say(place, as_a_page(grip)) == b""
        off = say(plc, is_gripping)
        assert off[-1] == 0
        assert say(plc, grip) == grip
        assert say(plc, is_gripping)[-1] == 1
    finally:
        bench.stop()


def test_the_virtual_bench_of_a_campaign_opens_no_port():
    before = listening({os.getpid()})
    with open_virtual_bench(World(seed=7), {}, lambda request: None, wires="memory") as bench:
        assert bench.gantry.position_mm()
        assert listening({os.getpid()}) == before


def test_a_page_cannot_command_a_virtual_arm_and_a_program_of_any_user_can():
    program = b"def x():\nset_standard_digital_out(7, True)\nend\n"
    before = listening({os.getpid()})
    arm = ArmServer(VirtualArm(World(seed=7), {}, lambda request: None), "127.0.48.1")
    arm.start()
    script = ("127.0.48.1", arm.script_port)

    def outputs():
        return arm.arm.values()["actual_digital_output_bits"]

    try:
        assert listening({os.getpid()}) - before == {script, ("127.0.48.1", 30004)}
        say(script, as_a_page(program))
        say(("127.0.48.1", 30004), as_a_page(program))
        assert outputs() == 0
        say(script, program)
        wait_for(lambda: outputs() == 1 << 7, 10.0)
    finally:
        arm.stop()
