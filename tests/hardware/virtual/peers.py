"""Independent Modbus servers behind one small interface, and a wire between driver and server that misbehaves.

pyModbusTCP and pymodbus come with the development dependencies. libmodbus (Debian: libmodbus5) and mbpoll are used
where they are found; pyclickplc needs an environment of its own, whose Python `FAST_PYCLICKPLC_PYTHON` names.
"""

import asyncio
import contextlib
import ctypes
import os
import select
import shutil
import socket
import subprocess
import tempfile
import threading
import time
from pathlib import Path

from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from pyModbusTCP.server import DataBank, ModbusServer

N_ADDRESSES = 0x10000
HOST = "127.0.0.1"
MBPOLL = shutil.which("mbpoll")
SOCAT = shutil.which("socat")


class PyModbusTcpPeer:
    """pyModbusTCP's server."""

    def __init__(self):
        self.block = DataBank(d_inputs_size=N_ADDRESSES)
        self.port = 0

    def start(self):
        self.server = ModbusServer(host=HOST, port=self.port, no_block=True, data_bank=self.block)
        self.server.start()
        self.port = self.server._service.server_address[1]

    def stop(self):
        self.server.stop()

    def poke(self, address, words):
        self.block.set_holding_registers(address, words)

    def peek(self, address, count):
        return self.block.get_holding_registers(address, count)

    def poke_input(self, address, value):
        self.block.set_discrete_inputs(address, [value])


class PymodbusPeer:
    """pymodbus' server, on TCP or on a serial port."""

    def __init__(self, serial_port=None):
        bits = SimData(0, values=[False] * N_ADDRESSES, datatype=DataType.BITS)
        words = SimData(0, count=N_ADDRESSES, datatype=DataType.REGISTERS)
        self.device = SimDevice(0, simdata=([bits], [bits], [words], [words]))
        self.port = 0
        self.serial_port = serial_port

    def start(self):
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self.thread.start()
        self._call(self._listen())

    async def _listen(self):
        if self.serial_port:
            self.server = ModbusSerialServer(self.device, port=self.serial_port, baudrate=115200)
        else:
            self.server = ModbusTcpServer(self.device, address=(HOST, self.port))
        await self.server.serve_forever(background=True)
        if not self.serial_port:
            self.port = self.server.transport.sockets[0].getsockname()[1]

    def stop(self):
        self._call(self._shut_down())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()

    async def _shut_down(self):
        await self.server.shutdown()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def poke(self, address, words):
        self._call(self.server.context.async_setValues(0, 16, address, words))

    def peek(self, address, count):
        return self._call(self.server.context.async_getValues(0, 3, address, count))

    def poke_input(self, address, value):
        self._call(self.server.context.async_setValues(0, 2, address, [value]))

    def _call(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(10.0)


class _Mapping(ctypes.Structure):
    """modbus_mapping_t of libmodbus 3.1."""

    _fields_ = (
        [(f"n{i}", ctypes.c_int) for i in range(8)]
        + [("bits", ctypes.POINTER(ctypes.c_uint8)), ("inputs", ctypes.POINTER(ctypes.c_uint8))]
        + [("input_words", ctypes.POINTER(ctypes.c_uint16)), ("words", ctypes.POINTER(ctypes.c_uint16))]
    )


def load_libmodbus():
    """libmodbus, or None where it is not installed."""
    try:
        library = ctypes.CDLL("libmodbus.so.5", use_errno=True)
    except OSError:
        return None
    for name in ("modbus_new_tcp", "modbus_new_rtu"):
        getattr(library, name).restype = ctypes.c_void_p
    library.modbus_mapping_new.restype = ctypes.POINTER(_Mapping)
    return library


LIBMODBUS = load_libmodbus()


class LibmodbusPeer:
    """The loop of libmodbus' example server (receive, reply), on TCP or on a serial port."""

    def __init__(self, serial_port=None):
        self.serial_port = serial_port
        self.port = 0
        self.map = LIBMODBUS.modbus_mapping_new(*[N_ADDRESSES - 1] * 4)

    def start(self):
        if self.serial_port:
            self.context = ctypes.c_void_p(
                LIBMODBUS.modbus_new_rtu(self.serial_port.encode(), 115200, ctypes.c_char(b"N"), 8, 1)
            )
            LIBMODBUS.modbus_set_slave(self.context, 1)
            assert LIBMODBUS.modbus_connect(self.context) == 0
            self.listener = None
        else:
            if not self.port:
                with socket.create_server((HOST, 0)) as free:
                    self.port = free.getsockname()[1]
            self.context = ctypes.c_void_p(LIBMODBUS.modbus_new_tcp(HOST.encode(), self.port))
            self.listener = LIBMODBUS.modbus_tcp_listen(self.context, 5)
            assert self.listener >= 0
        self.wake, self.waker = os.pipe()
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self):
        if self.listener is None:
            self._answer(LIBMODBUS.modbus_get_socket(self.context))
            return
        while self._is_ready(self.listener):
            LIBMODBUS.modbus_tcp_accept(self.context, ctypes.byref(ctypes.c_int(self.listener)))
            self._answer(LIBMODBUS.modbus_get_socket(self.context))
            LIBMODBUS.modbus_close(self.context)

    def _answer(self, handle):
        query = (ctypes.c_uint8 * 260)()
        while self._is_ready(handle, self.listener):
            length = LIBMODBUS.modbus_receive(self.context, query)
            if length < 0:
                return
            LIBMODBUS.modbus_reply(self.context, query, length, self.map)

    def _is_ready(self, handle, other=None):
        """Wait for `handle`; False when asked to stop, or when the next client (`other`) calls first."""
        others = [] if other is None else [other]
        ready, _, _ = select.select([handle, self.wake, *others], [], [])
        return self.wake not in ready and (handle in ready)

    def stop(self):
        os.write(self.waker, b"x")
        self.thread.join()
        LIBMODBUS.modbus_close(self.context)
        LIBMODBUS.modbus_free(self.context)
        for handle in (self.wake, self.waker, *([self.listener] if self.listener is not None else [])):
            os.close(handle)

    def poke(self, address, words):
        for i, word in enumerate(words):
            self.map.contents.words[address + i] = word

    def peek(self, address, count):
        return list(self.map.contents.words[address : address + count])

    def poke_input(self, address, value):
        self.map.contents.inputs[address] = int(value)


class BadWire:
    """A TCP relay in front of a server: requests or answers can vanish, be damaged, or come late."""

    def __init__(self, port):
        self.upstream = port
        self.lost_requests = self.lost_answers = 0
        self.damage = None  # called with the bytes of the next answer
        self.late_s = 0.0
        self.n_connections = 0
        self.listener = socket.create_server((HOST, 0))
        self.port = self.listener.getsockname()[1]
        self.sockets = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            self.n_connections += 1
            try:
                server = socket.create_connection((HOST, self.upstream))
            except OSError:
                client.close()
                continue
            self.sockets += [client, server]
            for source, target, is_request in ((client, server, True), (server, client, False)):
                threading.Thread(target=self._relay, args=(source, target, is_request), daemon=True).start()

    def _relay(self, source, target, is_request):
        with contextlib.suppress(OSError):
            while data := source.recv(4096):
                data = self._treat(data, is_request)
                if data:
                    target.sendall(data)
        for end in (source, target):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _treat(self, data, is_request):
        if is_request:
            if self.lost_requests:
                self.lost_requests -= 1
                return b""
            return data
        time.sleep(self.late_s)
        if self.lost_answers:
            self.lost_answers -= 1
            return b""
        damage, self.damage = self.damage, None
        return damage(data) if damage else data

    def close(self):
        self.listener.close()
        for end in self.sockets:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


@contextlib.contextmanager
def pty_pair():
    """Two serial ports that are one line, made by socat."""
    with tempfile.TemporaryDirectory() as folder:
        ends = [str(Path(folder) / name) for name in ("host", "device")]
        process = subprocess.Popen([SOCAT, *(f"pty,raw,echo=0,link={end}" for end in ends)])
        try:
            deadline_s = time.monotonic() + 10.0
            while not all(os.path.exists(end) for end in ends) and time.monotonic() < deadline_s:
                time.sleep(0.01)
            yield ends
        finally:
            process.terminate()
            process.wait()
