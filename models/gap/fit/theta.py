"""Theta of measured traces without any effect, for `fast calibrate --data trace`: of the simulator, and of the bench.

Of the simulator: the theta with which this simulator, on its own mesh, answers like the bench. Of the bench: the same
draws, with what the numerical error is worth in theta added. No data of the bench can tell the two apart.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.problem import THETA
from fast.models.calibration.traces.response_surface import ResponseSurfaces, n_terms
from fast.models.calibration.traces.theta_grid import ThetaGrid
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import CENTRE, DEEPER_MM, NUMERICAL, WIDER_MM, Bank
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.posterior import sample_posterior
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.grasps import Cells
from fast.models.units import spell_share

METHOD = "trace"
MIN_TOOLS = 3
# What mesh and contact law are worth in theta: in worlds of a finer mesh and another contact law, Young's modulus and
# friction (relative) and Poisson ratio are found off by so much (`python -m tests.studies calibration-traces`).
MODULUS_SHIFT, FRICTION_SHIFT, RATIO_SHIFT = 0.02, 0.03, 0.015
_OUTLYING = 0.2  # weight of a tool on an object, below which it is named
_NEAR_BOUND, _PILE = 0.02, 0.05  # share of the range, and of the draws in it


def make_grid_bank(cells: Cells, grid_steps_n: np.ndarray, grid_lead_n: np.ndarray) -> Bank:
    """Make a bank for theta alone, from `ThetaGrid` simulations: its surfaces at the centre, nothing (NaN) of the rest.

    grid_steps_n: t x k x g x 120; grid_lead_n: t x k x g x 12, before the lift; NaN where a simulation failed.

    Raises:
        UsageError: no cell has enough of the grid.
    """
    grid, (t, o, _, n_steps) = np.array(ThetaGrid().points), grid_steps_n.shape
    is_known = np.isfinite(grid_steps_n).all(axis=-1).sum(axis=2) > n_terms(grid)
    if not is_known.any():
        raise UsageError(
            f"none of the {t * o} pairs of a measured design and an object has the {n_terms(grid) + 1} simulations "
            f"around it that a calibration on traces needs; simulate the {len(grid)} points of the grid for them."
        )
    every = np.ones(n_steps, dtype=bool)
    surfaces = ResponseSurfaces.fitted(grid, grid_steps_n, is_known, CENTRE.young_modulus_mpa, every)
    at_centre = surfaces.rows(np.array([CENTRE.friction]), CENTRE.poisson_ratio) @ surfaces.coefficients
    return Bank(
        targets=cells.targets,
        centre=CENTRE,
        grid=grid,
        grid_steps_n=grid_steps_n,
        grid_lead_n=grid_lead_n,
        centre_steps_n=np.where(is_known[..., None], at_centre[..., 0, :], np.nan),
        numerical_steps_n=np.full((t, o, len(NUMERICAL), n_steps), np.nan),
        placed_steps_n=np.full((t, o, len(DEEPER_MM), n_steps), np.nan),
        wider_steps_n=np.full((t, o, len(WIDER_MM), n_steps), np.nan),
        effects={},
        failed_share=float(np.isnan(grid_steps_n[cells.is_wanted][..., 0]).mean()),
    )


def calibrate_theta(
    training: Surrogate, settings: CalibrationSettings, progress: Callable[[str], None] | None = None
) -> CalibrationResult:
    """Sample the posterior of the simulator's theta given training grasps (`GapData.training`); see `of_bench`.

    Uses priors, chains, draws, tune, target_accept, seed and workers of the settings.

    Raises:
        UsageError: fewer than `MIN_TOOLS` tools are left, or the grid and the prior of Poisson's ratio do not meet.
    """
    _check(training, settings)
    fit = recalibrate(training)
    result = sample_posterior(fit, settings, progress)
    sentences = (*result.warnings, *_outlier_sentences(fit), *_range_sentences(training, result))
    return replace(result, method=METHOD, warnings=sentences)


def of_bench(result: CalibrationResult, grid: np.ndarray) -> CalibrationResult:
    """Turn theta of the simulator in a result into theta of the bench: the same diagnostics, wider draws.

    grid: g x 2, friction and Poisson ratio of the simulations; draws are reflected at the ends of their range there.
    """
    rng = np.random.default_rng([result.settings.seed, 2])
    draws, place = result.draws.copy(), [result.names.index(name) for name in THETA]
    theta = draws[..., place]
    shift = rng.standard_normal(theta.shape) * np.array([MODULUS_SHIFT, FRICTION_SHIFT, RATIO_SHIFT])
    shift[..., :2] *= theta[..., :2]
    theta = theta + shift
    low, high = _limits(grid, result.settings)
    theta[..., 1:] = high - np.abs(high - (low + np.abs(theta[..., 1:] - low)))
    draws[..., place] = theta
    return replace(result, draws=draws)


def _limits(grid: np.ndarray, settings: CalibrationSettings) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and greatest friction and Poisson ratio (2, 2), where both the grid and the priors are."""
    priors = settings.priors
    low = np.maximum(grid.min(axis=0), [0.0, priors.poisson_ratio_lower])
    return low, np.minimum(grid.max(axis=0), [np.inf, priors.poisson_ratio_upper])


def _check(training: Surrogate, settings: CalibrationSettings) -> None:
    n_tools = len(np.unique(training.grasps.tool))
    if n_tools < MIN_TOOLS:
        raise UsageError(
            f"{n_tools} tools have measured traces with simulations, a calibration on traces needs at least "
            f"{MIN_TOOLS}; measure more."
        )
    low, high = _limits(training.bank.grid, settings)
    if low[1] >= high[1]:
        raise UsageError(
            f"the grid's Poisson ratios end at {training.bank.grid[:, 1].max():g} and the prior's begin at "
            f"{settings.priors.poisson_ratio_lower:g}; give a prior that meets the grid."
        )


def _outlier_sentences(fit: Fit) -> list[str]:
    """Name the pair of a tool and an object that counts for least, if some count for little."""
    features = fit.features
    rows, weight = np.flatnonzero(features.is_mean), fit.weight[:, 0] ** 2
    outlying = rows[weight[rows] < _OUTLYING]
    if len(outlying) == 0:
        return []
    grasps, worst = features.surrogate.grasps, outlying[np.argmin(weight[outlying])]
    return [
        f"{len(outlying)} of {len(rows)} pairs of a tool and an object lie far from what theta explains, most of all "
        f"{grasps.tools[features.tool[worst]]} on object {grasps.objects[features.obj[worst]]}; they count for little."
    ]


def _range_sentences(training: Surrogate, result: CalibrationResult) -> list[str]:
    """Tell where draws pile up at an end of their range."""
    found = []
    for name, low, high in zip(THETA[1:], *_limits(training.bank.grid, result.settings), strict=True):
        share = (result.of(name) - low) / (high - low)
        for bound, near in ((low, share < _NEAR_BOUND), (high, share > 1.0 - _NEAR_BOUND)):
            if near.mean() > _PILE:
                found.append(
                    f"{spell_share(near.mean())} of the draws of {name} lie at the end of its range, {bound:g}; "
                    "the traces want to go beyond, or say nothing about it."
                )
    return found
