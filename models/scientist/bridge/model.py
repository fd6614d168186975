"""FAST's surrogate as a BoTorch model: any acquisition function of BoTorch can be built on it.

The posterior is that of the numpy surrogate (cached Cholesky factor, closed forms), and so is its gradient. Inputs
have ten columns: a design in the unit cube, then the fidelity s (0 simulated, 1 measured). Outcomes are in the units
of its data: N, or logarithms.
"""

from typing import Any

import numpy as np
import torch
from botorch.models.model import FantasizeMixin, Model
from botorch.posteriors import GPyTorchPosterior
from gpytorch.distributions import MultivariateNormal
from linear_operator import to_linear_operator
from torch import Tensor

from fast.models.blas import one_blas_thread
from fast.models.errors import UsageError
from fast.models.scientist.surrogate.observations import REAL, SIM
from fast.models.scientist.surrogate.posterior import Surrogate, observation_variance, pull_back
from fast.models.validation import check_type

_SETS_AT_ONCE = 256  # sets of points whose covariances are computed together; bounds the memory


class SurrogateModel(Model, FantasizeMixin):
    """The fitted surrogate, and outcomes that it was conditioned on later (`condition_on_observations`).

    Args:
        surrogate: The fitted two-fidelity surrogate.
        extra_x: Points of later outcomes, `batch_shape x p x 10`; none: p is 0.
        extra_y: Their outcomes, `batch_shape x p`, N.
        extra_noise: Variance of each outcome, `batch_shape x p`, N^2.

    Example:
        >>> from fast.models.scientist.surrogate.fit import fit_surrogate
        >>> from fast.models.scientist.surrogate.observations import ObservationSet
        >>> x, s = np.linspace(0.0, 1.0, 90).reshape(10, 9), np.repeat([0, 1], 5)
        >>> surrogate = fit_surrogate(ObservationSet(x, s, x[:, 0] + s, np.zeros(10)))
        >>> SurrogateModel(surrogate).posterior(torch.ones(4, 2, 10)).mean.shape
        torch.Size([4, 2, 1])
    """

    def __init__(
        self,
        surrogate: Surrogate,
        extra_x: Tensor | None = None,
        extra_y: Tensor | None = None,
        extra_noise: Tensor | None = None,
    ) -> None:
        super().__init__()
        check_type(surrogate, Surrogate, "the surrogate", "what fast.fit_surrogate gives")
        self.surrogate = surrogate
        data = surrogate.data
        self.train_inputs = (torch.from_numpy(np.column_stack([data.x, data.s])),)
        self.train_targets = torch.from_numpy(data.y)
        n_columns = self.train_inputs[0].shape[1]
        self._extra_x = torch.zeros(0, n_columns, dtype=torch.float64) if extra_x is None else extra_x
        self._extra_y = torch.zeros(0, dtype=torch.float64) if extra_y is None else extra_y
        self._extra_noise = torch.zeros_like(self._extra_y) if extra_noise is None else extra_noise

    @property
    def num_outputs(self) -> int:
        """One: the mean grasping force."""
        return 1

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the sets of outcomes that the model was conditioned on; empty at first."""
        return torch.broadcast_shapes(self._extra_x.shape[:-2], self._extra_y.shape[:-1])

    def posterior(
        self,
        X: Tensor,
        output_indices: list[int] | None = None,
        observation_noise: bool | Tensor = False,
        posterior_transform: Any = None,
    ) -> GPyTorchPosterior:
        """Return the joint posterior of outcomes at `X` (batch x q x 10); with `observation_noise` of observations.

        Raises:
            UsageError: X has another number of columns, or a fidelity that is neither 0 nor 1.
        """
        self._check(X)
        q = X.shape[-2]
        points, p = self._with_extra(X), self._extra_x.shape[-2]
        mean, covariance = _joint(self.surrogate, points)
        if p:
            mean, covariance = _condition(mean, covariance, q, self._extra_y, self._extra_noise)
        if isinstance(observation_noise, Tensor):
            covariance = covariance + torch.diag_embed(observation_noise[..., 0].expand(mean.shape))
        elif observation_noise:
            covariance = covariance + torch.diag_embed(self._noise_at(X).expand(mean.shape))
        posterior = GPyTorchPosterior(MultivariateNormal(mean, to_linear_operator(covariance)))
        return posterior if posterior_transform is None else posterior_transform(posterior)

    def condition_on_observations(
        self, X: Tensor, Y: Tensor, noise: Tensor | None = None, **kwargs: Any
    ) -> "SurrogateModel":
        """Condition on outcomes `Y` (batch x p x 1, N) at `X` (batch x p x 10); `noise`: their variances, N^2."""
        self._check(X)
        y = Y[..., 0]
        variance = self._noise_at(X).expand(y.shape) if noise is None else noise[..., 0].expand(y.shape)
        if self._extra_x.shape[-2] == 0:
            return SurrogateModel(self.surrogate, X, y, variance)
        batch = torch.broadcast_shapes(self.batch_shape, X.shape[:-2], y.shape[:-1])
        return SurrogateModel(
            self.surrogate,
            torch.cat([_expand(self._extra_x, batch, 2), _expand(X, batch, 2)], dim=-2),
            torch.cat([_expand(self._extra_y, batch, 1), _expand(y, batch, 1)], dim=-1),
            torch.cat([_expand(self._extra_noise, batch, 1), _expand(variance, batch, 1)], dim=-1),
        )

    def fantasize(
        self, X: Tensor, sampler: Any, observation_noise: Tensor | None = None, **kwargs: Any
    ) -> "SurrogateModel":
        """Condition on outcomes at `X` that `sampler` draws from the model's own posterior, a batch entry per draw."""
        noise = True if observation_noise is None else observation_noise
        drawn = sampler(self.posterior(X, observation_noise=noise))
        return self.condition_on_observations(X, drawn)

    def _with_extra(self, X: Tensor) -> Tensor:
        """Join X and the points of later outcomes in one set each."""
        if self._extra_x.shape[-2] == 0:
            return X
        batch = torch.broadcast_shapes(X.shape[:-2], self._extra_x.shape[:-2])
        return torch.cat([_expand(X, batch, 2), _expand(self._extra_x, batch, 2)], dim=-2)

    def _noise_at(self, X: Tensor) -> Tensor:
        fidelity = X[..., -1].detach().round().numpy()
        return torch.from_numpy(observation_variance(self.surrogate.parameters, fidelity))

    def _check(self, X: Tensor) -> None:
        n_columns = self.train_inputs[0].shape[1]
        if X.shape[-1] != n_columns:
            raise UsageError(
                f"Points have {X.shape[-1]} columns, the surrogate takes {n_columns}: the design in the unit cube, "
                "then the fidelity."
            )
        if not torch.isin(X[..., -1], torch.tensor([SIM, REAL], dtype=X.dtype)).all():
            raise UsageError(
                "A point has a fidelity that is neither 0 (simulated) nor 1 (measured) in its last column; fix that "
                "column, for example with `fixed_features={9: 1.0}`."
            )


class _JointPosterior(torch.autograd.Function):
    """Mean and covariance of b sets of q points by numpy, with their gradient in closed form."""

    @staticmethod
    def forward(ctx: Any, surrogate: Surrogate, points: Tensor) -> tuple[Tensor, Tensor]:
        ctx.surrogate = surrogate
        ctx.save_for_backward(points)
        array = points.detach().numpy()
        b, q, n_columns = array.shape
        # The points that all sets share (pending, measured) are many; each is solved for once.
        unique, where = np.unique(array.reshape(-1, n_columns), axis=0, return_inverse=True)
        where = where.reshape(b, q)
        with one_blas_thread():
            if q == 1:
                mean, sd = surrogate.predict(unique[:, :-1], unique[:, -1])
                return torch.from_numpy(mean[where]), torch.from_numpy((sd**2)[where][:, :, None])
            mean, covariance = surrogate.posterior(unique[:, :-1], unique[:, -1])
        return torch.from_numpy(mean[where]), torch.from_numpy(covariance[where[:, :, None], where[:, None, :]])

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, Tensor]:
        (points,) = ctx.saved_tensors
        array = points.numpy()
        with one_blas_thread():
            gradient = pull_back(ctx.surrogate, array[..., :-1], array[..., -1], *(g.numpy() for g in gradients))
        return None, torch.from_numpy(np.concatenate([gradient, np.zeros_like(array[..., :1])], axis=-1))


def _joint(surrogate: Surrogate, points: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the mean (batch x q) and covariance (batch x q x q) at points (batch x q x 10)."""
    sets = points.double().reshape(-1, *points.shape[-2:])
    parts = [_JointPosterior.apply(surrogate, part) for part in sets.split(_SETS_AT_ONCE)]
    mean, covariance = (torch.cat(column) for column in zip(*parts, strict=True))
    return mean.reshape(points.shape[:-1]), covariance.reshape(*points.shape[:-1], points.shape[-2])


def _condition(mean: Tensor, covariance: Tensor, q: int, y: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Condition mean and covariance of the first q outcomes on the others' noisy `y`, with variances `noise`."""
    factor = torch.linalg.cholesky(covariance[..., q:, q:] + torch.diag_embed(noise))
    cross = torch.linalg.solve_triangular(factor, covariance[..., q:, :q], upper=False)
    deviation = torch.linalg.solve_triangular(factor, (y - mean[..., q:]).unsqueeze(-1), upper=False)
    new_mean = mean[..., :q] + (cross.mT @ deviation)[..., 0]
    new_covariance = covariance[..., :q, :q] - cross.mT @ cross
    return new_mean, new_covariance.expand(*new_mean.shape, q)


def _expand(tensor: Tensor, batch: torch.Size, n_last: int) -> Tensor:
    return tensor.expand(*batch, *tensor.shape[tensor.ndim - n_last :])
