"""Records the wire logs in tests/data/wire anew: `python -m tests.hardware.wire.record_wire_logs`.

They are recordings of the virtual bench, not of instruments; only `gantry-firmware.log` is of grbl-Mega, on an emulated
board (`python -m tests.hardware.firmware_faults IMAGE --log FILE`).

A session as a lab would have it, at ten times real speed: homing, a weighing, a lift, a limit switch that trips, homing
again, a hold. Needed when a driver is meant to speak differently; the difference shows in review.
"""

import tempfile
import threading
from pathlib import Path

from fast.hardware.bench import open_virtual_servers
from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import ScaledClock
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.parts.gantry import Gantry
from fast.hardware.virtual.world.file import World
from fast.hardware.wire.log_files import GANTRY, LOAD_CELL, PLC, WireFiles, list_logs, read_header
from fast.hardware.wire.modbus import rtu_link, tcp_link
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import DeviceError

FOLDER = Path(__file__).parents[2] / "data" / "wire"
SPEED_UP = 10.0


def record(folder: Path) -> None:
    """Write the logs of the session to `folder`."""
    clock = ScaledClock(SPEED_UP)
    with open_virtual_servers(World(seed=7), {}, lambda request: None, clock) as virtual:
        at = virtual.endpoints
        line = SerialTransport(at.serial_port)
        plc_link = tcp_link("CLICK PLC", at.plc_host, at.plc_port)
        tcp = tcp_link("Weight transmitter", at.transmitter_host, at.transmitter_port)
        rtu = rtu_link("Weight transmitter", at.transmitter_serial_port)
        with WireFiles(folder) as files, WireFiles(folder / "rtu") as rtu_files:
            files.follow(line.log, GANTRY, line.name)
            files.follow(plc_link.log, PLC, plc_link.name)
            files.follow(tcp.log, LOAD_CELL, tcp.name)
            rtu_files.follow(rtu.log, LOAD_CELL, rtu.name)
            _move(Gantry(line, clock), virtual.grbl, clock)  # first: a PLC that had a host and lost it takes the motors
            _use_plc(ClickPlc(plc_link, clock))
            for link in (tcp, rtu):
                _weigh(LaumasTransmitter(link, clock), clock)


def _use_plc(plc):
    plc.connect()
    plc.write_many(tags.SUPPLY_SETPOINT_REGISTER, [30.0])
    plc.write_bit(tags.SUPPLY_REQUEST, True)
    plc.wait_for({tags.SUPPLY_OUTPUT: True}, 1.0, "Opening the air supply")
    plc.request(tags.GRIP_REQUEST, {tags.GRIP_OUTPUT: True}, 1.0, "Gripping")
    plc.request(tags.VENT_REQUEST, {tags.GRIP_OUTPUT: False}, 1.0, "Venting")
    plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
    plc.read_bits(tags.FIRST_DOCK_INPUT, tags.N_DOCK_SLOTS)
    plc.close()


def _weigh(transmitter, clock):
    transmitter.connect()
    transmitter.tare()
    for _ in range(10):
        clock.sleep(0.1)
        transmitter.read()
    transmitter.close()


def _move(gantry, controller, clock):
    with gantry:
        gantry.home()
        gantry.move_to(1400, 1400, 100)
        gantry.start_lift(20, 5)
        for _ in range(5):
            gantry.sample()
            clock.sleep(0.2)
        gantry.stop_lift()
        tripping = threading.Timer(0.1, lambda: controller.inject("limit", axis="x"))
        tripping.start()
        try:
            gantry.move_to(x_mm=1000, speed_mm_per_s=100)
        except DeviceError:
            tripping.join()
        controller.clear("limit", axis="x")
        gantry.home()
        gantry.start_lift(-20, 5)
        clock.sleep(1.0)
        gantry.hold()
        gantry.move_to(z_mm=170)


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        record(Path(made))
        for path in [*list_logs(Path(made)), *list_logs(Path(made) / "rtu")]:
            name = "load-cell-rtu" if path.parent.name == "rtu" else read_header(path).device
            (FOLDER / f"{name}.log").write_bytes(path.read_bytes())
