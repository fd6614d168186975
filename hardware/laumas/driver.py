"""Driver of a Laumas weight transmitter over Modbus (TCP or RTU)."""

import logging

from hardware.clock import Clock
from hardware.laumas.codec import (
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
from hardware.modbus import ModbusLink
from models.errors import DeviceError
from models.units import force_n_from_kg

logger = logging.getLogger(__name__)

# Newtons of one unit of the instrument, for the units a load cell of force can be set to
_NEWTON_PER_UNIT = {"kg": force_n_from_kg(1.0), "g": force_n_from_kg(1e-3), "t": force_n_from_kg(1e3), "N": 1.0}


class LaumasTransmitter:
    """A weight transmitter: status, gross, net and peak in one read; tare, zero and gross as commands."""

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
        if scale.unit not in _NEWTON_PER_UNIT:
            raise DeviceError(
                f"{self._link.name} measures in {scale.unit}, which is no force; set it to kg or N on the keypad."
            )
        self._scale = scale
        logger.info("%s: firmware, type, year, serial, program %s; division %s %s",
                    self._link.name, self.identity, scale.division, scale.unit)  # fmt: skip

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    @property
    def newton_per_unit(self) -> float:
        """Newtons of one unit of the instrument's readings."""
        return _NEWTON_PER_UNIT[self._known_scale().unit]

    @property
    def resolution_n(self) -> float:
        """Force of one division, in N."""
        return self._known_scale().division * self.newton_per_unit

    def read(self) -> Reading:
        """One reading, in the instrument's unit. The caller decides what a fault bit means.

        Raises:
            DeviceError: no answer, or somebody changed the scale on the keypad since `connect`.
        """
        registers = self._link.read_registers(3, FIRST_MEASURED_REGISTER, N_MEASURED)
        scale = self._known_scale()
        reading = decode_measured(registers, scale)
        if decode_scale(registers[-1]) != scale:
            raise DeviceError(f"The scale of {self._link.name} was changed on its keypad; connect again.")
        return reading

    def tare(self) -> None:
        """Semi-automatic tare (command 7), proven by the net flag."""
        self._command(Command.TARE, is_net=True)

    def zero(self) -> None:
        """Semi-automatic zero (command 8); the instrument allows it only in a small range."""
        self._command(Command.ZERO, is_net=None)

    def show_gross(self) -> None:
        """Leave the net display (command 9), proven by the net flag."""
        self._command(Command.GROSS, is_net=False)

    def _command(self, command: Command, is_net: bool | None, time_out_s: float = 1.0) -> None:
        self._link.write_registers(COMMAND_REGISTER, [int(command)])  # FC16 always: FC06 is refused by some models
        deadline_s = self._clock.now_s() + time_out_s
        while is_net is not None and bool(self.read().status & Status.NET_SHOWN) != is_net:
            if self._clock.now_s() >= deadline_s:
                raise DeviceError(
                    f"{self._link.name} did not carry out command {command.value} ({command.name.lower()}) in "
                    f"{time_out_s:g} s; it was not repeated. Check the display, then continue the batch."
                )
            self._clock.sleep(0.02)

    def _known_scale(self) -> Scale:
        if self._scale is None:
            raise DeviceError(f"{self._link.name} is not connected; connect before reading.")
        return self._scale
