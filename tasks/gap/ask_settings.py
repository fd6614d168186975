"""What a gap search may ask a bench for."""

from dataclasses import dataclass

from fast.hardware.parts.limits import BenchLimits

USUAL_BUDGET = 24  # grasps, as usual and changed


@dataclass(frozen=True)
class AskSettings:
    """How many grasps a search may ask for, within what the bench can do; nothing if there may be none."""

    most_grasps: int = USUAL_BUDGET
    limits: BenchLimits = BenchLimits()
