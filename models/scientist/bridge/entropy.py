"""Max-value entropy search as a BoTorch acquisition function, over any model of both fidelities.

The closed form of `models.scientist.acquisition.mes`, in torch so that it has gradients. Draws of the best outcome f*
are joint posterior paths over the candidates; each path carries its own values of the pending outcomes.
"""

import math

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.models.model import Model
from botorch.utils.transforms import t_batch_mode_transform
from torch import Tensor

from fast.models.scientist.acquisition.mes import N_PATHS
from fast.models.scientist.acquisition.paths import draw_deviations
from fast.models.scientist.surrogate.observations import REAL

_MAX_CORRELATION_2 = 1.0 - 1e-12


class MaxValueEntropy(AcquisitionFunction):
    """Information in nats that one observation gives about the best measured outcome; `forward` takes batch x 1 x 10.

    Args:
        model: Any BoTorch model with one outcome whose last input is the fidelity (0 simulated, 1 measured).
        candidates: Designs over which the best outcome is looked for, m x 10; their fidelity does not matter.
        X_pending: Points under way, p x 10, of either fidelity.
        n_paths: Draws of the best outcome.
        seed: Of the draws.
    """

    def __init__(
        self, model: Model, candidates: Tensor, X_pending: Tensor | None = None, n_paths: int = N_PATHS, seed: int = 0
    ) -> None:
        super().__init__(model)
        self._candidates, self._n_paths, self._seed = _as_real(candidates), n_paths, seed
        self.set_X_pending(X_pending)

    def set_X_pending(self, X_pending: Tensor | None = None) -> None:
        """Draw paths over the candidates and these points, p x 10, whose outcomes are promised path by path."""
        none = self._candidates[:0]
        self.X_pending = none if X_pending is None else X_pending.detach()
        points = torch.cat([self._candidates, self.X_pending])
        rng = np.random.default_rng(self._seed)
        with torch.no_grad():
            posterior = self.model.posterior(points)
            covariance = posterior.distribution.covariance_matrix.numpy().copy()
            deviations = draw_deviations(covariance, self._n_paths, rng)
            paths = posterior.mean[:, 0].numpy()[:, None] + deviations
            m = len(self._candidates)
            self._pending_noise = _noise_at(self.model, self.X_pending)
            errors = rng.normal(size=(len(self.X_pending), self._n_paths))
            self._promised = torch.from_numpy(paths[m:]) + self._pending_noise.sqrt()[:, None] * torch.from_numpy(
                errors
            )
            self._best = torch.from_numpy(paths[:m].max(axis=0))

    @t_batch_mode_transform(expected_q=1)
    def forward(self, X: Tensor) -> Tensor:
        """Compute the information gain at each of b points (b x 1 x 10), b."""
        pending = self.X_pending.expand(*X.shape[:-2], *self.X_pending.shape)
        posterior = self.model.posterior(torch.cat([_as_real(X), X, pending], dim=-2))
        mean, covariance = posterior.mean[..., 0], posterior.distribution.covariance_matrix
        means, covariance = self._given_promises(mean, covariance)
        noisy = self.model.posterior(X, observation_noise=True).variance[..., 0, 0]
        noise = (noisy - posterior.variance[..., 1, 0]).detach().clamp_min(0.0)
        variance = covariance[..., 0, 0].clamp_min(1e-14)
        of_observation = (covariance[..., 1, 1] + noise).clamp_min(1e-14)
        correlation_2 = (covariance[..., 0, 1] ** 2 / (variance * of_observation)).clamp(0.0, _MAX_CORRELATION_2)
        gamma = (self._best - means) / variance.sqrt().unsqueeze(-1)
        return truncation_gain(gamma, correlation_2.unsqueeze(-1)).mean(dim=-1)

    def _given_promises(self, mean: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
        """Compute path-by-path means of the real outcome, b x n_paths, and 2 x 2 covariances given pending outcomes."""
        promised = covariance[..., 2:, 2:] + torch.diag_embed(self._pending_noise)
        factor = torch.linalg.cholesky(promised)
        cross = torch.linalg.solve_triangular(factor, covariance[..., 2:, :2], upper=False)
        deviations = torch.linalg.solve_triangular(factor, self._promised - mean[..., 2:, None], upper=False)
        means = mean[..., :1] + (cross[..., :1].mT @ deviations)[..., 0, :]
        return means, covariance[..., :2, :2] - cross.mT @ cross


def truncation_gain(gamma: Tensor, correlation_2: Tensor) -> Tensor:
    """Compute an observation's information about f <= f*, nats, elementwise (`models.scientist.acquisition.mes`)."""
    log_density = -0.5 * gamma**2 - 0.5 * math.log(2.0 * math.pi)
    ratio = torch.exp(log_density - torch.special.log_ndtr(gamma))
    shrinkage = (ratio * (gamma + ratio)).clamp(0.0, 1.0)
    return -0.5 * torch.log1p(-correlation_2 * shrinkage)


def _noise_at(model: Model, points: Tensor) -> Tensor:
    """Compute the variance of one observation around the outcome at `points` (p x 10), p, N^2."""
    if not len(points):
        return torch.zeros(0, dtype=torch.float64)
    noise = model.posterior(points, observation_noise=True).variance - model.posterior(points).variance
    return noise[:, 0].clamp_min(0.0)


def _as_real(X: Tensor) -> Tensor:
    return torch.cat([X[..., :-1], torch.full_like(X[..., -1:], REAL)], dim=-1)
