"""What the force sensor needs of a weight transmitter, however it is connected."""

from typing import Protocol

from fast.hardware.laumas.codec import Reading
from fast.models.units import force_n_from_kg

# Newtons of one unit of the instrument, for the units a load cell of force can be set to
NEWTON_PER_UNIT = {"kg": force_n_from_kg(1.0), "g": force_n_from_kg(1e-3), "t": force_n_from_kg(1e3), "N": 1.0}


class WeightSource(Protocol):
    """A weight transmitter over Modbus (asked) or in continuous mode (it sends by itself)."""

    mode: str

    @property
    def newton_per_unit(self) -> float:
        """Newtons of one unit of the readings."""
        ...

    @property
    def resolution_n(self) -> float:
        """Force of one division, in N."""
        ...

    def connect(self) -> None:
        """Open the line and prove that weights come."""
        ...

    def close(self) -> None:
        """Close the line."""
        ...

    def read_new(self) -> list[Reading]:
        """Take readings since the last call, oldest first, in the instrument's unit. The caller judges their faults."""
        ...

    def tare(self) -> None:
        """Make the present weight the zero of the net readings, as well as this line allows."""
        ...
