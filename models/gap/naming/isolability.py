"""What these data could tell apart, whatever they say: computed from the design of the experiment alone.

Fields of effects, freed of what theta, tools and numerical error can do; their cosines; and how many nats apart two
effects of a plausible size would be (notes/gap.md section 3, ii-2).
"""

from dataclasses import dataclass

import numpy as np

from models.gap.naming.screen import Screen

INVISIBLE = 0.1  # of the size of a field that survives theta: below, the effect is an alias of theta
LEAST_NATS = 3.0  # below, two effects are confusable
# Features of a cell and cells of a tool are no independent witnesses, though whitened: this share of them counts.
DEFLATION = 0.25
LEAST_SNR2 = 2.0 * LEAST_NATS  # below, an effect of a plausible size is not told from none


@dataclass(frozen=True, eq=False)
class Isolability:
    """e effects at a plausible size.

    visible: e, share of the field that theta leaves. snr2: e, squared signal to noise, deflated. cosines: e x e.
    nats: e x e, expected evidence for the one against the other at its best amplitude; not symmetric.
    """

    effects: tuple[str, ...]
    visible: np.ndarray
    snr2: np.ndarray
    cosines: np.ndarray
    nats: np.ndarray

    @property
    def invisible(self) -> tuple[str, ...]:
        """Effects that theta makes up for, or that are lost in the noise at a plausible size."""
        is_lost = (self.visible < INVISIBLE) | (self.snr2 < LEAST_SNR2)
        return tuple(name for name, lost in zip(self.effects, is_lost, strict=True) if lost)

    def confusable(self, effect: str) -> tuple[str, ...]:
        """Other effects that could stand for this one, or this one for them."""
        place = self.effects.index(effect)
        apart = np.minimum(self.nats[place], self.nats[:, place])
        return tuple(name for other, name in enumerate(self.effects) if other != place and apart[other] < LEAST_NATS)

    def apart(self, first: str, second: str) -> float:
        """Expected nats by which the worse of the two directions is told."""
        i, j = self.effects.index(first), self.effects.index(second)
        return float(min(self.nats[i, j], self.nats[j, i]))


def isolability(screen: Screen) -> Isolability:
    """Isolability of the screen's effects, each at the secant of which theta leaves the largest field.

    The best stand-in among all secants of another effect counts: effects have shapes.
    """
    flat = screen.own.reshape(len(screen.own), -1)
    size = np.sqrt((flat**2).sum(axis=1))
    unit = flat / np.maximum(size, 1e-12)[:, None]
    names = screen.names
    of_effect = np.array([names.index(name) for name in screen.effects])
    chosen = np.array([_largest(size, of_effect == number) for number in range(len(names))])
    every = np.clip(unit[chosen] @ unit.T, -1.0, 1.0)
    cosines = np.array([[row[of_effect == number].max() for number in range(len(names))] for row in every])
    snr2 = DEFLATION * size[chosen] ** 2
    nats = 0.5 * snr2[:, None] * (1.0 - np.maximum(cosines, 0.0) ** 2)
    return Isolability(names, screen.visible[chosen], snr2, cosines, nats)


def _largest(size: np.ndarray, is_own: np.ndarray) -> int:
    return int(np.argmax(np.where(is_own, size, -1.0)))
