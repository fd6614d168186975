"""RTDE on port 30004 and the secondary interface, on loopback, each client in its own thread.

RTDE, version 2: every package is a size (2 bytes), a type (1 byte) and a payload, big-endian (Universal Robots,
"Real-Time Data Exchange Guide"). Time passes here: a step of the controller for every package of the fastest client.
"""

import logging
import socket
import struct
import threading
import time
from collections.abc import Callable

from fast.hardware.virtual.arm.controller import VirtualArm
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)

RTDE_PORT = 30004
STEP_S = 0.008  # of the controller, 125 Hz
_REST_S = 20.0  # after which no client counts the packages: no tare or pull lasts as long
_VERSION = (5, 11, 0, 0)  # of the controller software: major, minor, bugfix, build
_REQUEST_VERSION, _CONTROLLER_VERSION, _OUTPUTS, _START, _PAUSE, _DATA = b"VvOSPU"
_VECTORS = {"actual_TCP_pose", "target_TCP_pose", "actual_TCP_force"}
_UNSIGNED = {"safety_status_bits", "runtime_state"}
_LONG = {"actual_digital_input_bits", "actual_digital_output_bits"}
_CODES = {"VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "DOUBLE": "d"}
_LONGEST_PROGRAM = 100_000


class ArmServer:
    """Serves a virtual arm, `speed_up` times faster than real time, until `stop`."""

    def __init__(self, arm: VirtualArm, host: str = "127.0.0.1", speed_up: float = 1.0) -> None:
        self.arm = arm
        self.host = host
        self._speed_up = speed_up
        self._stopping = threading.Event()
        self._sockets: list[socket.socket] = []
        self._stepped = threading.Condition()
        self.script_port = 0

    def start(self, script_port: int = 0) -> None:
        """Listen; the script port 0 is a free one.

        Raises:
            DeviceError: a port is taken.
        """
        self._listen(RTDE_PORT, self._serve_rtde)
        self.script_port = self._listen(script_port, self._serve_script)
        threading.Thread(target=self._tick, name="virtual-arm", daemon=True).start()

    def stop(self) -> None:
        """Hang up; safe to call twice."""
        self._stopping.set()
        for one in self._sockets:
            one.close()
        self.arm.close()

    def _listen(self, port: int, serve: Callable[[socket.socket], None]) -> int:
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((self.host, port))
        except (OSError, ValueError, TypeError) as error:  # the last two: no name of a host
            listener.close()
            self.stop()
            raise DeviceError(
                f"Port {port} of `{self.host}` cannot be listened on ({error}); give another address of this computer, "
                "such as 127.0.0.2."
            ) from error
        listener.listen()
        self._sockets.append(listener)
        threading.Thread(target=self._accept, args=(listener, serve), daemon=True).start()
        return int(listener.getsockname()[1])

    def _accept(self, listener: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        while not self._stopping.is_set():
            try:
                client, _ = listener.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._guard, args=(client, serve), daemon=True).start()

    def _guard(self, client: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        with client:
            try:
                serve(client)
            except (OSError, EOFError, struct.error, UnicodeDecodeError) as error:
                logger.info("Virtual arm: a client has gone (%s)", error)

    def _tick(self) -> None:
        """Advance time: never faster than asked, slower where the computer is.

        At rest it makes one step for every 8 ms of the computer's time: shorter ones would cost half a core.
        """
        next_s = time.monotonic()
        while not self._stopping.is_set():
            with self._stepped, self.arm.lock:  # no program comes between the look and the step
                speed_up = 1.0 if self.arm.is_solving else self._speed_up
                step_s = STEP_S * max(speed_up, 1.0) if self.arm.rest_s > _REST_S else STEP_S
                self.arm.advance(step_s)
                self._stepped.notify_all()
            next_s = max(next_s + step_s / speed_up, time.monotonic() - 0.05)
            time.sleep(max(next_s - time.monotonic(), 0.0))

    def _serve_script(self, client: socket.socket) -> None:
        text = b""
        while len(text) < _LONGEST_PROGRAM and (part := client.recv(4096)):
            text += part
        self.arm.run_program(text.decode("ascii"))

    def _serve_rtde(self, client: socket.socket) -> None:
        names: list[str] = []
        while True:
            size, kind = struct.unpack(">HB", _receive(client, 3))
            payload = _receive(client, size - 3)
            if kind == _REQUEST_VERSION:
                _send(client, kind, struct.pack(">B", payload == b"\x00\x02"))
            elif kind == _CONTROLLER_VERSION:
                _send(client, kind, struct.pack(">4I", *_VERSION))
            elif kind == _OUTPUTS:
                names = [name for name in payload[8:].decode("ascii").split(",") if name]
                _send(client, kind, b"\x01" + ",".join(map(_type_of, names)).encode())
            elif kind == _START:
                _send(client, kind, b"\x01")
                threading.Thread(target=self._stream, args=(client, names), daemon=True).start()
            elif kind == _PAUSE:
                _send(client, kind, b"\x01")

    def _stream(self, client: socket.socket, names: list[str]) -> None:
        """Send a package after every step, at the controller's own rate."""
        try:
            while not self._stopping.is_set():
                with self._stepped:
                    self._stepped.wait(timeout=1.0)
                    values = self.arm.values()
                payload = b"\x01" + b"".join(_pack(name, values.get(name, 0)) for name in names)
                _send(client, _DATA, payload)
        except OSError:
            return


def _type_of(name: str) -> str:
    if name in _VECTORS:
        return "VECTOR6D"
    if name in _UNSIGNED:
        return "UINT32"
    if name in _LONG:
        return "UINT64"
    return "DOUBLE" if name in ("timestamp", "target_speed_fraction") else "INT32"


def _pack(name: str, value: float | list[float]) -> bytes:
    values = value if isinstance(value, list) else [value]
    return struct.pack(f">{_CODES[_type_of(name)]}", *values)


def _send(client: socket.socket, kind: int, payload: bytes) -> None:
    client.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)


def _receive(client: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = client.recv(size - len(data))
        if not part:
            raise EOFError("closed")
        data += part
    return data
