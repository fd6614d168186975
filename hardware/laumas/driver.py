"""Driver of a Laumas weight transmitter over Modbus (TCP or RTU)."""

import logging

from fast.hardware.clock import Clock
from fast.hardware.laumas.codec import (
    COMMAND_REGISTER,
    DIVISION_REGISTER,
    FIRST_MEASURED_REGISTER,
    IDENTITY_REGISTER,
    N_IDENTITY,
    N_MEASURED,
    Command,
    Reading,
    Scale,
    Status,
    decode_measured,
    decode_scale,
)
from fast.hardware.laumas.source import NEWTON_PER_UNIT
from fast.hardware.wire.modbus import ModbusLink
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)

LATE_S = 0.1  # clock; half of it is 0.25 mm of a lift
MOST_READS = 3


class LaumasTransmitter:
    """A weight transmitter: status, gross, net and peak in one read; tare, zero and gross as commands.

    The peak register is an upper bound since power-up: no command that resets it is confirmed (131 is hearsay), so the
    driver sends none, and only a peak that rises during a lift belongs to that lift.
    """

    mode = "modbus"

    def __init__(self, link: ModbusLink, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._scale: Scale | None = None
        self.identity: tuple[int, ...] = ()

    def connect(self) -> None:
        """Open the connection, read identity and scale.

        Raises:
            DeviceError: no answer, an ambiguous division, or a unit that is no force or mass.
        """
        self._link.connect()
        self.identity = tuple(self._link.read_registers(3, IDENTITY_REGISTER, N_IDENTITY))
        (register,) = self._link.read_registers(3, DIVISION_REGISTER, 1)
        scale = decode_scale(register)
        if scale.unit not in NEWTON_PER_UNIT:
            raise DeviceError(
                f"{self._link.name} measures in {scale.unit}, which is no force; set it to kg or N on the keypad."
            )
        self._scale = scale
        if not any(self.identity):
            logger.warning("%s shows no firmware, type or serial number in its first registers; check with a known "
                           "weight that its register map is the expected one.", self._link.name)  # fmt: skip
        logger.info("%s: firmware, type, year, serial, program %s; division %s %s",
                    self._link.name, self.identity, scale.division, scale.unit)  # fmt: skip

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    @property
    def newton_per_unit(self) -> float:
        """Newtons of one unit of the instrument's readings."""
        return NEWTON_PER_UNIT[self._known_scale().unit]

    @property
    def resolution_n(self) -> float:
        """Force of one division, in N."""
        return self._known_scale().division * self.newton_per_unit

    def read(self) -> Reading:
        """Take one reading, in the instrument's unit. The caller decides what a fault bit means.

        It counts for the middle between question and answer. One that took longer than `LATE_S` (a busy host, a new
        connection after a time-out) could be of any moment in between, and is asked for again.

        Raises:
            DeviceError: no answer, or somebody changed the scale on the keypad since `connect`.
        """
        scale = self._known_scale()
        for _ in range(MOST_READS):
            asked_s = self._clock.now_s()
            registers = self._link.read_registers(3, FIRST_MEASURED_REGISTER, N_MEASURED)
            answered_s = self._clock.now_s()
            if answered_s - asked_s <= LATE_S:
                break
        reading = decode_measured(registers, scale, (asked_s + answered_s) / 2)
        found = decode_scale(registers[-1])
        if found != scale:
            raise DeviceError(
                f"The scale of {self._link.name} was changed on its keypad from {scale.division:g} {scale.unit} to "
                f"{found.division:g} {found.unit}. Set it back, or connect again if a known weight is shown right."
            )
        return reading

    def read_new(self) -> list[Reading]:
        """Take one reading now: over Modbus the instrument is asked."""
        return [self.read()]

    def tare(self) -> None:
        """Tare semi-automatically (command 7), proven by the net flag, which an earlier tare is made to drop first."""
        if self.read().status & Status.NET_SHOWN:
            self.show_gross()
        self._command(Command.TARE, is_net=True)

    def zero(self) -> None:
        """Zero semi-automatically (command 8); the instrument allows it only in a small range."""
        self._command(Command.ZERO, is_net=None)

    def show_gross(self) -> None:
        """Leave the net display (command 9), proven by the net flag."""
        self._command(Command.GROSS, is_net=False)

    def _command(self, command: Command, is_net: bool | None, time_out_s: float = 1.0) -> None:
        try:
            self._link.write_registers(COMMAND_REGISTER, [int(command)])  # FC16 always: FC06 is refused by some models
        except LinkLostError as error:
            if is_net is None:
                raise  # nothing shows whether it was carried out, and it must not be carried out twice
            logger.warning("%s Command %s is not repeated; its outcome is read back.", error, command.name.lower())
        deadline_s = self._clock.now_s() + time_out_s
        while is_net is not None and bool(self.read().status & Status.NET_SHOWN) != is_net:
            if self._clock.now_s() >= deadline_s:
                raise DeviceError(
                    f"{self._link.name} did not carry out command {command.value} ({command.name.lower()}) in "
                    f"{time_out_s:g} s; it was not repeated. Restart it if its display stands still, then continue the "
                    "batch."
                )
            self._clock.sleep(0.02)

    def _known_scale(self) -> Scale:
        if self._scale is None:
            raise DeviceError(f"{self._link.name} is not connected; connect before reading.")
        return self._scale
