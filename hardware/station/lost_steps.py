"""Lost steps: what the gantry's count has missed since it was last homed, and the limit.

GRBL has no encoder: a carriage that slipped is wrong until the next homing, and grasps are made beside their objects.
It is looked for with an empty head after every batch, and after so many tools as the config asks.
"""

import logging

from fast.hardware.parts.gantry import Gantry, Place
from fast.hardware.safety.supervisor import Supervisor
from fast.hardware.tools.changer import ToolChanger
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)

SLIP_LIMIT_MM = 0.1  # homing switches repeat within a few hundredths; a mount places its object within 0.2


class LostStepsError(DeviceError):
    """The carriage was not where the controller counted it.

    Attributes:
        slip_mm: true place minus count, x, y, z.
    """

    def __init__(self, slip_mm: Place) -> None:
        self.slip_mm = slip_mm
        off = ", ".join(f"{slip:+.2f} mm in {axis}" for axis, slip in zip("xyz", slip_mm, strict=True)
                        if abs(slip) > SLIP_LIMIT_MM)  # fmt: skip
        super().__init__(
            f"The gantry has lost steps: the carriage stood {off} from where it was counted, limit {SLIP_LIMIT_MM:g} "
            "mm. It is homed again; the grasps since the last check may have been made beside their objects. Look at "
            "belts, couplings and what the head may have touched, then continue the batch."
        )


class PositionCheck:
    """Finds the home switches by the old count, homes again, compares."""

    def __init__(self, gantry: Gantry, changer: ToolChanger, supervisor: Supervisor) -> None:
        self._gantry = gantry
        self._changer = changer
        self._supervisor = supervisor

    def run(self) -> Place:
        """Return the slip by axis, mm, within the limit; a tool on the head is docked first.

        Raises:
            LostStepsError: beyond the limit; the bench is latched in its safe state, homed.
            DeviceError: a device failed on the way; the bench is in its safe state.
        """
        with self._supervisor.guard():
            self._changer.dock()
            slip_mm = self._gantry.slip_mm()
            logger.info("Position checked: slip %s mm", slip_mm)
            if max(map(abs, slip_mm)) > SLIP_LIMIT_MM:
                raise LostStepsError(slip_mm)
        return slip_mm
