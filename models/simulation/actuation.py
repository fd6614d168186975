"""A jaw that gives way: it closes until the finger pushes back as hard as it can push there, and stays there."""

import math
from dataclasses import dataclass

from fast.models.simulation.solver.stepping import Step

FIRST_STEP_MM = 0.25  # before a stiffness is known
SHORTEST_STEP_MM = 0.005
REACHED = 0.995  # share of the limit at which the jaw is taken to stall


@dataclass(frozen=True)
class Jaw:
    """What holds the modelled part of one finger, at the reference modulus.

    It pushes with `max_force_n` at most, through a spring of `compliance_mm_per_n`: at a force N the finger is that
    much times N behind the travel of the drive.
    """

    max_force_n: float = math.inf
    compliance_mm_per_n: float = 0.0

    @property
    def is_rigid(self) -> bool:
        """True if it arrives wherever it is sent."""
        return math.isinf(self.max_force_n) and self.compliance_mm_per_n == 0.0


class ClosingStall:
    """Watches the closing force of one finger and shortens the steps towards the balance with its jaw.

    The drive travels `stroke_mm`; none of the steps is longer than `longest_mm`.
    """

    def __init__(self, jaw: Jaw, stroke_mm: float, longest_mm: float) -> None:
        self._jaw, self._stroke_mm, self._longest_mm = jaw, stroke_mm, longest_mm
        self._travel_mm = self._force_n = 0.0
        self._stiffness_n_per_mm = math.nan

    def longest_step_mm(self, travel_mm: float) -> float:
        """Return the step that should reach the balance at the present stiffness, within the solver's own limit."""
        if self._jaw.is_rigid:
            return self._longest_mm
        stiffness = self._stiffness_n_per_mm
        if not stiffness > 0.0:
            return min(FIRST_STEP_MM, self._longest_mm)
        to_stall_mm = (self._jaw.max_force_n - self._force_n) / stiffness
        compliance = self._jaw.compliance_mm_per_n
        to_balance_mm = (self._stroke_mm - travel_mm - compliance * self._force_n) / (1.0 + compliance * stiffness)
        return min(max(min(to_stall_mm, to_balance_mm), SHORTEST_STEP_MM), self._longest_mm)

    def has_stalled(self, step: Step) -> bool:
        """Take note of a step; True once the finger pushes back with what the jaw can push with there."""
        force_n = -float(step.clamp_n[0])
        self._stiffness_n_per_mm = (force_n - self._force_n) / (step.travel_mm - self._travel_mm)
        self._travel_mm, self._force_n = step.travel_mm, force_n
        behind_mm = self._jaw.compliance_mm_per_n * force_n
        is_balanced = behind_mm > 0.0 and behind_mm >= REACHED * (self._stroke_mm - step.travel_mm)
        return is_balanced or force_n >= REACHED * self._jaw.max_force_n
