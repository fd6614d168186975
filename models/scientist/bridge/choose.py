"""Choose designs by a BoTorch acquisition function, over FAST's candidates."""

from dataclasses import dataclass

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.exceptions import UnsupportedError
from botorch.models.model import Model
from torch import Tensor

from fast.models.errors import UsageError
from fast.models.own_code import call_own, is_own
from fast.models.scientist.acquisition.candidates import Pool
from fast.models.scientist.bridge.entropy import MaxValueEntropy
from fast.models.scientist.bridge.model import SurrogateModel
from fast.models.scientist.bridge.own_model import OwnSurrogate, own_draws
from fast.models.scientist.surrogate.observations import REAL

_ROWS_AT_ONCE = 256  # candidates that a rule is asked about together; bounds the memory


@dataclass(frozen=True)
class Situation:
    """What a rule may know besides the model. Points have ten columns: a design in the unit cube, then the fidelity.

    Attributes:
        fidelity: Of the designs that are chosen, 0 simulated or 1 measured.
        candidates: m x 10, the designs that are chosen from.
        measured: n x 10, the measured designs.
        pending: p x 10, designs under way at either fidelity.
        best_n: Largest predicted force of a measured design, N; None before the first measurement.
    """

    fidelity: int
    candidates: Tensor
    measured: Tensor
    pending: Tensor
    best_n: float | None


def select_by_rule(rule: str, pool: Pool, n: int, rng: np.random.Generator) -> list[tuple[int, float]]:
    """Select up to n rows of the pool by an acquisition function; what it chooses becomes pending.

    `rule` is the `module:function` that makes the acquisition function of (model, situation), or `mes`. One that cannot
    take pending points is made again on the model given their predicted outcomes.

    Raises:
        UsageError: the user's function is not found, fails, or gives something unusable.
    """
    with own_draws(int(rng.integers(2**31))):
        return _select(rule, pool, n)


def _select(rule: str, pool: Pool, n: int) -> list[tuple[int, float]]:
    surrogate, fidelity = pool.surrogate, pool.fidelity
    model = surrogate.model if isinstance(surrogate, OwnSurrogate) else SurrogateModel(surrogate)
    candidates, under_way = _tensor(pool.points, fidelity), torch.from_numpy(np.asarray(pool.pending, dtype=float))
    measured = _tensor(surrogate.data.x[surrogate.data.s == REAL], REAL)
    best_n = float(surrogate.mean(measured[:, :-1].numpy(), REAL).max()) if len(measured) else None
    situation = Situation(fidelity, candidates, measured, under_way, best_n)
    # A rule compares outcomes of one fidelity, so what is under way at the other is not among its pending points.
    waiting = under_way[under_way[:, -1] == fidelity] if is_own(rule) else under_way
    acquisition = _make(rule, model, situation)
    allowed = pool.spacing.allowed(pool.points)
    chosen: list[tuple[int, float]] = []
    while len(chosen) < n and allowed.any():  # a rule is asked about those alone that may be chosen
        rows = np.flatnonzero(allowed)
        acquisition = _with_pending(acquisition, rule, model, situation, waiting)
        values = _values(acquisition, rule, candidates[rows])
        best = int(values.argmax())
        row = int(rows[best])
        chosen.append((row, float(values[best])))
        waiting = torch.cat([waiting, candidates[row : row + 1]])
        pool.spacing.add(pool.points[row])
        allowed = pool.spacing.allowed(pool.points)
    return chosen


def _make(rule: str, model: Model, situation: Situation) -> AcquisitionFunction:
    if not is_own(rule):
        return MaxValueEntropy(model, situation.candidates, seed=torch.initial_seed())
    acquisition = call_own(rule, model, situation)
    if not isinstance(acquisition, AcquisitionFunction):
        raise UsageError(
            f"`{rule}` gave a {type(acquisition).__name__}; it must give a BoTorch AcquisitionFunction on the model."
        )
    return acquisition


def _with_pending(
    acquisition: AcquisitionFunction, rule: str, model: Model, situation: Situation, waiting: Tensor
) -> AcquisitionFunction:
    """Give the rule the points under way, p x 10."""
    if not len(waiting):
        return acquisition
    try:
        acquisition.set_X_pending(waiting)
    except UnsupportedError:
        with torch.no_grad():
            outcomes = model.posterior(waiting).mean
        return _make(rule, model.condition_on_observations(waiting, outcomes), situation)
    return acquisition


def _values(acquisition: AcquisitionFunction, rule: str, candidates: Tensor) -> Tensor:
    """Compute the values of single candidates (m x 10), m.

    Raises:
        UsageError: the rule fails, or its values have another shape or are not numbers.
    """
    try:
        with torch.no_grad():
            parts = [acquisition(part.unsqueeze(-2)) for part in candidates.split(_ROWS_AT_ONCE)]
    except UsageError:
        raise
    except Exception as error:
        raise UsageError(f"The rule of `{rule}` fails on the candidates ({type(error).__name__}: {error}).") from error
    sizes = [len(part) for part in candidates.split(_ROWS_AT_ONCE)]
    if [tuple(part.shape) for part in parts] != [(size,) for size in sizes]:
        raise UsageError(
            f"The rule of `{rule}` gives values of shape {tuple(parts[0].shape)} for {sizes[0]} candidates; its "
            f"`forward` takes batch x 1 x 10 and must give one value each."
        )
    values = torch.cat(parts)
    if torch.isnan(values).any():
        raise UsageError(f"The rule of `{rule}` gives values that are not numbers (NaN); look at its formula.")
    return values


def _tensor(points: np.ndarray, fidelity: int) -> Tensor:
    return torch.from_numpy(np.column_stack([points, np.full(len(points), float(fidelity))]))
