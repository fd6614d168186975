"""What the law of an effect runs along: its state, and what the law is of where that is a known quantity.

The law of an effect says how much of it there is in a state: friction after so much slip, modulus after so many
repeats. Where the state is not in the data, what goes with it stands for it: the lift for the slip of a sliding point,
the force level of a grasp for its contact pressure and its closing force. An effect that is a plain number, such as a
zero that is off, has no state.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.models.records import Design, GraspContext, GraspSetup

_HOUR_S = 3600.0

# What a state may be along a grasp: the lift in mm, the time since the end of closing in s, the force in N, and the
# root mean square force of the whole grasp in N.
Along = Literal["lift", "held", "force", "level"]
OfGrasp = Callable[[Design, GraspSetup, GraspContext], float]


@dataclass(frozen=True)
class State:
    """The state that an effect's law runs along.

    name: in words, with its unit. read: what it is along every grasp, or of a grasp as a whole. scale: in the state's
    unit; a law is taken to be smooth along an axis that is linear up to it and logarithmic beyond.
    """

    name: str
    read: Along | OfGrasp
    scale: float

    def place(self, state: np.ndarray) -> np.ndarray:
        """Place states on the axis along which the law is smooth."""
        return np.asarray(np.log1p(state / self.scale))

    def state_at(self, place: np.ndarray) -> np.ndarray:
        """Invert `place`."""
        return np.asarray(self.scale * np.expm1(place))


@dataclass(frozen=True)
class Quantity:
    """What a law is of (`Effect.law`): in words with its unit, and its value without the effect."""

    name: str
    neutral: float


def of_context(name: str, unit: float = 1.0) -> OfGrasp:
    """Make a state that a grasp has from those before it, in units of so much."""
    return lambda design, setup, context: float(getattr(context, name)) / unit


def of_design(name: str) -> OfGrasp:
    """Make a state from a parameter of the design; fingers of families without it all stand at 0."""
    return lambda design, setup, context: float(getattr(design, name, 0.0))


LEVEL = State("force level of the grasp, N", "level", 0.5)
FORCE = State("force, N", "force", 2.0)
LIFT = State("lift, mm", "lift", 1.0)
RIBS = State("ribs of the finger", of_design("rib_count"), 5.0)
CLOCK = State("time since the batch began, h", of_context("clock_s", _HOUR_S), 2.0)
