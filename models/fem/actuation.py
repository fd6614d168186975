"""A jaw of limited force: it closes until the finger pushes back as hard as it can push, and stays there."""

import math

from models.fem.stepping import Step

FIRST_STEP_MM = 0.25  # before a stiffness is known
SHORTEST_STEP_MM = 0.02
REACHED = 0.99  # share of the limit at which the jaw is taken to stall


class ClosingStall:
    """Watches the closing force of one finger and shortens the steps towards `limit_n` (inf: never stalls)."""

    def __init__(self, limit_n: float, longest_mm: float) -> None:
        self._limit_n = limit_n
        self._longest_mm = longest_mm
        self._travel_mm = self._force_n = 0.0
        self._stiffness_n_per_mm = math.nan

    def longest_step_mm(self, travel_mm: float) -> float:
        """Step that should reach the limit at the present stiffness, within the solver's own limit."""
        if math.isinf(self._limit_n):
            return self._longest_mm
        if not self._stiffness_n_per_mm > 0.0:
            return min(FIRST_STEP_MM, self._longest_mm)
        to_limit_mm = (self._limit_n - self._force_n) / self._stiffness_n_per_mm
        return min(max(to_limit_mm, SHORTEST_STEP_MM), self._longest_mm)

    def has_stalled(self, step: Step) -> bool:
        """Take note of a step; True once the finger pushes back with the limit."""
        force_n = -float(step.clamp_n[0])
        self._stiffness_n_per_mm = (force_n - self._force_n) / (step.travel_mm - self._travel_mm)
        self._travel_mm, self._force_n = step.travel_mm, force_n
        return force_n >= REACHED * self._limit_n
