"""An effect of the bank at any amplitude: between the simulated amplitudes, and for any Young's modulus.

In one of its shapes (a slip scale), an effect is piecewise linear in its amplitude through the simulated ones and
nothing at the neutral value; beyond the last it goes on in a straight line. Between shapes it is linear in the
logarithm, beyond them constant. A force, pressure or compliance that an effect brings in acts as one that is smaller
in a stiffer finger, by dimensional analysis: F(E, a) = E / E_c F(E_c, a E_c / E).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.bank import EffectRuns
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import unit_of

# What a quantity of this unit is in a finger k times as stiff, for the same shape of all forces: a power of k.
_POWER_OF_MODULUS = {"N": -1, "MPa": -1, "mm/N": 1}


@dataclass(frozen=True, eq=False)
class Shape:
    """Amplitudes of one shape: at (a + 1, increasing, 0 is neutral) and changes of step means (t x o x a + 1 x 120)."""

    shape: float
    at: np.ndarray
    change_n: np.ndarray


@dataclass(frozen=True, eq=False)
class EffectSurface:
    """Changes of step means by one effect; `shapes` in increasing order."""

    effect: str
    shapes: tuple[Shape, ...]

    @staticmethod
    def of(runs: EffectRuns, centre_steps_n: np.ndarray) -> "EffectSurface":
        """Make the surface of an effect's runs; where its simulation or the centre's failed, it changes nothing."""
        name, shape_name = name_axes(runs.effect)
        rows = [_whole(runs.effect, parameters) for parameters in runs.parameters]
        change_n = np.nan_to_num(runs.steps_n - centre_steps_n[:, :, None])
        shapes = []
        for value in sorted({row[shape_name] if shape_name else 1.0 for row in rows}):
            places = [i for i, row in enumerate(rows) if not shape_name or row[shape_name] == value]
            at = np.array([0.0, *(find_amplitude(runs.effect, rows[place][name]) for place in places)])
            order = np.argsort(at)
            nothing = np.zeros((*change_n.shape[:2], 1, change_n.shape[-1]))
            change = np.concatenate([nothing, change_n[:, :, places]], axis=2)
            shapes.append(Shape(value, at[order], change[:, :, order]))
        return EffectSurface(runs.effect, tuple(shapes))

    def change_n(
        self, parameters: Mapping[str, float], stiffer: np.ndarray, tool: np.ndarray, obj: np.ndarray
    ) -> np.ndarray:
        """Compute changes of step means of grasps (n x 120) at the bank's modulus, `stiffer` (n) over it being theirs.

        Where what the effect brings in is larger in a setup, the fingers are softer against it.
        """
        name, shape_name = name_axes(self.effect)
        values = _whole(self.effect, parameters)
        power = 0 if CATALOGUE[self.effect].scales_with_modulus else _POWER_OF_MODULUS.get(unit_of(name) or "", 0)
        power = -power if CATALOGUE[self.effect].parameters[0].is_limit else power
        amplitude = find_amplitude(self.effect, values[name]) * stiffer**power
        shares = self._shares(values[shape_name] if shape_name else 1.0)
        total = np.zeros((len(tool), self.shapes[0].change_n.shape[-1]))
        for share, shape in zip(shares, self.shapes, strict=True):
            if share == 0.0:
                continue
            low = np.clip(np.searchsorted(shape.at, amplitude, side="right") - 1, 0, len(shape.at) - 2)
            part = ((amplitude - shape.at[low]) / (shape.at[low + 1] - shape.at[low]))[:, None]
            total += share * (1.0 - part) * shape.change_n[tool, obj, low]
            total += share * part * shape.change_n[tool, obj, low + 1]
        return total

    def _shares(self, value: float) -> np.ndarray:
        """Return how much of each shape there is at a value of it."""
        if len(self.shapes) == 1:
            return np.ones(1)
        at = np.log([shape.shape for shape in self.shapes])
        return np.array([np.interp(np.log(value), at, row) for row in np.eye(len(at))])


def _whole(effect: str, parameters: Mapping[str, float]) -> dict[str, float]:
    return CATALOGUE[effect].neutral.parameters | dict(parameters)


def name_axes(effect: str) -> tuple[str, str | None]:
    """Name an effect's amplitude and what shapes it, along which it has runs."""
    names = [p.name for p in CATALOGUE[effect].parameters if p.has_runs]
    return names[0], names[1] if len(names) > 1 else None


def find_amplitude(effect: str, value: float) -> float:
    """Return the first parameter of an effect on an axis on which 0 is neutral."""
    first = CATALOGUE[effect].parameters[0]
    return 1.0 / value - 1.0 / first.neutral if first.is_limit else value - first.neutral
