"""Made-up grasps with a gap of one's choice, in closed form."""

from collections.abc import Callable

import numpy as np

from fast.models.design.space import PARAMETERS, from_unit, random_unit
from fast.models.gap.where.residuals import Residuals
from fast.models.gap.where.strata import object_shape

OBJECTS = (0, 2, 5, 9, 14, 17, 19, 24, 26, 29, 30, 31, 33, 34)
Gap = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
LIFT_MM = 0.5 * (np.arange(120) + 0.5)


def made_up_residuals(
    gap: Gap | None = None, n_tools: int = 12, seed: int = 0, *, tool_sd: float = 0.03, cell_sd: float = 0.02
) -> Residuals:
    """Three repeats of every tool on 14 objects; `gap(design, shape, repeat)` is a factor on the force over lift.

    `design` are the nine parameters, `shape` the numbers of the object. Other meshes change forces by a few per cent.
    """
    rng = np.random.default_rng(seed)
    designs = tuple(from_unit(random_unit(n_tools, rng)))
    table = np.array([[getattr(d, name) for name in PARAMETERS] for d in designs])
    shapes = np.array([object_shape(o).numbers for o in OBJECTS])
    tool, obj, repeat = (a.ravel() for a in np.indices((n_tools, len(OBJECTS), 3)))
    modulus = np.exp(tool_sd * rng.standard_normal(n_tools))
    placed = np.exp(cell_sd * rng.standard_normal((n_tools, len(OBJECTS))))
    cells = np.array([[_force(d, s) for s in shapes] for d in table])
    predicted = cells[tool, obj]
    factors = np.array([1.0 if gap is None else gap(table[t], shapes[o], r)
                        for t, o, r in zip(tool, obj, repeat, strict=True)]).reshape(len(tool), -1)  # fmt: skip
    factors = factors * (modulus[tool] * placed[tool, obj] * np.exp(0.01 * rng.standard_normal(len(tool))))[:, None]
    mesh = 0.01 * np.array([1.0, -0.5, 0.7])[:, None] * cells[:, :, None, :] * np.sin(shapes[:, :1] / 3.0)[..., None]
    return Residuals(
        tools=tuple(f"T{i}" for i in range(n_tools)),
        designs=designs,
        objects=OBJECTS,
        tool=tool,
        obj=obj,
        repeat=repeat,
        order=rng.permutation(len(tool)).astype(float),
        measured_n=factors * predicted + 0.08 * rng.standard_normal(predicted.shape),
        predicted_n=predicted,
        numerical_n=mesh[tool, obj],
    )


def _force(design: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """A dip, a rise, a peak that stays for some millimetres, and a fall: taller and wider objects hold longer."""
    peak = 8.0 + 8.0 * (design[6] - 2.0) + 0.2 * (shape[0] - 30.0) + 0.3 * design[7]
    end = 0.9 * shape[1]
    rise = 1.0 - np.exp(-LIFT_MM / (0.15 * end))
    fall = 1.0 / (1.0 + np.exp((LIFT_MM - end) / 1.5))
    return np.asarray(peak * rise * fall)
