"""Actuation effects: how the jaws really close."""

from models.effects.base import Effect


class ForceLimitedClosing(Effect):
    """Pneumatic jaws that stall: closing ends where the finger pushes back with `max_force_n` per jaw.

    The cylinder's force is pressure times piston area times efficiency (30 psi = 0.207 MPa on a 16 to 32 mm bore:
    10 to 60 N a jaw, notes/gap.md A1). Breaks the scaling of forces with Young's modulus. Infinite force changes
    nothing.
    """

    def __init__(self, max_force_n: float) -> None:
        self.max_force_n = max_force_n

    def closing_force_limit_n(self) -> float:
        """The stall force of one jaw, N."""
        return self.max_force_n
