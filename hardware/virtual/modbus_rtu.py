"""A Modbus RTU slave on a pty in its own thread, in front of the holding registers of any register map.

Written from the protocol (address, function, data, CRC-16 low byte first) and not on pymodbus, so that the driver's
RTU side meets code that it does not share. A frame with a wrong CRC or address is not answered; whatever does not
make a frame is thrown away at the next silence on the line.
"""

import os
import pty
import select
import struct
import threading
import tty

from fast.hardware.virtual.modbus_pdu import WRITE_COILS, WRITE_REGISTERS, RegisterMap, reply_to_pdu

_POLYNOMIAL = 0xA001
_SILENCE_S = 0.05  # real: after this much silence an unfinished frame is thrown away
_LONGEST_FRAME = 256
_SHORTEST_FRAME = 4  # address, function, CRC
_FIXED_LENGTH = 8  # functions 1 to 6: address, function, two words, CRC
_LAST_SHORT_FUNCTION = 6
_LENGTH_BYTE = 6  # of the writes of many: how many bytes of data follow


def crc16(data: bytes) -> int:
    """Compute the Modbus CRC of a frame."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ _POLYNOMIAL if crc & 1 else crc >> 1
    return crc


def with_crc(body: bytes) -> bytes:
    """Make the frame of a body: CRC appended, low byte first."""
    return body + struct.pack("<H", crc16(body))


def has_crc(frame: bytes) -> bool:
    """Return whether a frame ends with its own CRC."""
    return with_crc(frame[:-2]) == frame


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
                self._send(self.reply(received))  # a function of unknown length ends with the line's silence
                received = b""
                continue
            received += os.read(self._master, 512)
            length = _frame_length(received)
            while length is not None and len(received) >= length:
                self._send(self.reply(received[:length]))
                received = received[length:] if has_crc(received[:length]) else b""
                length = _frame_length(received)
            if len(received) > _LONGEST_FRAME:
                received = b""

    def reply(self, frame: bytes) -> bytes:
        """Answer one frame; give none to a damaged frame or one for another device."""
        if len(frame) < _SHORTEST_FRAME or not has_crc(frame) or frame[0] != self._device_id:
            return b""
        return with_crc(frame[:1] + reply_to_pdu(self._registers, frame[1:-2]))

    def _send(self, reply: bytes) -> None:
        if reply:
            os.write(self._master, reply)


def _frame_length(received: bytes) -> int | None:
    """Return the length of the frame that begins here, or None while that cannot be known."""
    if len(received) < 2:
        return None
    if received[1] in (WRITE_COILS, WRITE_REGISTERS):
        return 9 + received[_LENGTH_BYTE] if len(received) > _LENGTH_BYTE else None
    return _FIXED_LENGTH if 1 <= received[1] <= _LAST_SHORT_FUNCTION else None
