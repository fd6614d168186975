"""The data of a search: measured grasps, the bank of simulations around them, and what is held out; split once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fast.models.gap.bank.bank import Bank
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.facts import Fact
from fast.models.gap.grasps import Grasps


@dataclass(frozen=True, eq=False)
class GapData:
    """Grasps and the bank of the same tools and objects.

    held_out_tools (t) and held_out_objects (o): masks, frozen before anything is looked at; a grasp that touches
    either is not used before the evaluation, but for the question whether anything is missing at all, which adds
    nothing to a simulator. facts: what persons measured of effects.
    """

    grasps: Grasps
    bank: Bank
    held_out_tools: np.ndarray
    held_out_objects: np.ndarray
    facts: tuple[Fact, ...] = ()

    @staticmethod
    def of_all(grasps: Grasps, bank: Bank, facts: tuple[Fact, ...] = ()) -> "GapData":
        """Take grasps of which none is held out."""
        tools, objects = (np.zeros(len(names), dtype=bool) for names in (grasps.tools, grasps.objects))
        return GapData(grasps, bank, tools, objects, facts)

    @property
    def is_held_out(self) -> np.ndarray:
        """Which grasps are kept for the evaluation, n."""
        return np.asarray(self.held_out_tools[self.grasps.tool] | self.held_out_objects[self.grasps.obj])

    @cached_property
    def surrogate(self) -> Surrogate:
        """The surrogate of all grasps, whose surfaces are fitted once for the whole search."""
        return Surrogate.of(self.bank, self.grasps)

    @cached_property
    def training(self) -> Surrogate:
        """The surrogate of the grasps that may be learnt from: not held out, finite, with simulations."""
        return self.surrogate.select(np.flatnonzero(self._is_usable & ~self.is_held_out))

    @cached_property
    def held_out(self) -> Surrogate:
        """The surrogate of the grasps that are kept for the evaluation: held out, finite, with simulations."""
        return self.surrogate.select(np.flatnonzero(self._is_usable & self.is_held_out))

    @cached_property
    def usable(self) -> Surrogate:
        """The surrogate of all grasps that are finite and have simulations, held out or not."""
        return self.surrogate.select(np.flatnonzero(self._is_usable))

    @property
    def _is_usable(self) -> np.ndarray:
        return self.surrogate.is_usable & np.isfinite(self.grasps.steps_n).all(axis=-1)
