"""A Modbus RTU slave on a pty in its own thread, in front of the holding registers of any register map.

Written from the protocol (address, function, data, CRC-16 low byte first) and not on pymodbus, so that the driver's
RTU side meets code that it does not share. Functions 3, 6 and 16; a frame with a wrong CRC or address is not answered.
"""

import os
import pty
import select
import struct
import threading
import tty

from hardware.virtual.modbus import RegisterMap

_POLYNOMIAL = 0xA001
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS = 1, 2
_SILENCE_S = 0.05  # real: after this much silence an unfinished frame is thrown away
_HEADER = struct.Struct(">BBHH")  # address, function, first register, count or value
_LONG_WRITE = 16


def crc16(data: bytes) -> int:
    """Modbus CRC of a frame."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ _POLYNOMIAL if crc & 1 else crc >> 1
    return crc


def with_crc(body: bytes) -> bytes:
    """Frame of a body: CRC appended, low byte first."""
    return body + struct.pack("<H", crc16(body))


class RtuServerThread:
    """Serves one `RegisterMap` on a pty; drivers open `port`."""

    def __init__(self, name: str, registers: RegisterMap, device_id: int = 1) -> None:
        self.name = name
        self.port = ""
        self._registers = registers
        self._device_id = device_id
        self._master = self._slave = -1
        self._wake_read = self._wake_write = -1
        self._thread = threading.Thread(target=self._serve, name=f"rtu-{name}", daemon=True)

    def start(self) -> None:
        """Open the pty and answer on it."""
        self._master, self._slave = pty.openpty()
        self._wake_read, self._wake_write = os.pipe()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the pty. Safe to call twice."""
        if not self._thread.is_alive():
            return
        os.write(self._wake_write, b"x")
        self._thread.join()
        for handle in (self._master, self._slave, self._wake_read, self._wake_write):
            os.close(handle)

    def _serve(self) -> None:
        received = b""
        while True:
            ready, _, _ = select.select([self._master, self._wake_read], [], [], _SILENCE_S if received else None)
            if self._wake_read in ready:
                return
            if not ready:
                received = b""
                continue
            received += os.read(self._master, 512)
            length = _frame_length(received)
            if length is not None and len(received) >= length:
                answer = self._answer(received[:length])
                received = received[length:]
                if answer:
                    os.write(self._master, answer)

    def _answer(self, frame: bytes) -> bytes:
        body = frame[:-2]
        if with_crc(body) != frame or body[0] != self._device_id:
            return b""
        address, function, first, count = _HEADER.unpack(body[: _HEADER.size])
        if function == 3:
            values = self._registers.read_registers("holding", first, count)
            if values is not None:
                return with_crc(struct.pack(f">BBB{count}H", address, function, 2 * count, *values))
        elif function in (6, _LONG_WRITE):
            words = [count] if function == 6 else list(struct.unpack(f">{count}H", body[7:]))
            if self._registers.write_registers(first, words, function):
                return with_crc(body[: _HEADER.size])
        code = _ILLEGAL_ADDRESS if function in (3, 6, _LONG_WRITE) else _ILLEGAL_FUNCTION
        return with_crc(bytes([address, function | 0x80, code]))


def _frame_length(received: bytes) -> int | None:
    """Length of the frame that begins here, or None while that cannot be known."""
    if len(received) < 7:
        return None
    return 9 + received[6] if received[1] == _LONG_WRITE else 8
