"""A user's BoTorch model in the place of FAST's surrogate."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from fast.models.errors import UsageError
from fast.models.own_code import call_own
from fast.models.scientist.surrogate.observations import ObservationSet

if TYPE_CHECKING:
    from botorch.models.model import Model


class OwnSurrogate:
    """What the choice of designs asks of a surrogate, answered by a BoTorch model.

    Attributes:
        name: `module:function` that made the model.
        data: Observations that it was made from.
        model: The model; inputs have ten columns, a design in the unit cube and the fidelity, outcomes are in N.
    """

    def __init__(self, name: str, data: ObservationSet, model: "Model") -> None:
        self.name, self.data, self.model = name, data, model
        self.mean(data.x[:2], data.s[:2])

    def mean(self, x: np.ndarray, s: np.ndarray | int) -> np.ndarray:
        """Return the predictive mean at m points `x` (m x 9) of fidelity `s`, m, N.

        Raises:
            UsageError: the model's posterior has another shape, or is not finite.
        """
        import torch

        points = torch.from_numpy(np.column_stack([x, np.broadcast_to(s, len(x))]).astype(float))
        with torch.no_grad():
            mean = self.model.posterior(points).mean
        if mean.shape != (len(x), 1):
            raise UsageError(
                f"The model of `{self.name}` gives a posterior mean of shape {tuple(mean.shape)} for {len(x)} points, "
                f"it must be ({len(x)}, 1); give a model with one outcome."
            )
        if not torch.isfinite(mean).all():
            raise UsageError(f"The model of `{self.name}` predicts values that are not finite; look at its fit.")
        return np.asarray(mean[:, 0].numpy())


def make_own_surrogate(name: str, data: ObservationSet, seed: int) -> OwnSurrogate:
    """Make the model that the user's function `name` makes of (train_X, train_Y, train_Yvar).

    train_X: n x 10. train_Y: n x 1, N. train_Yvar: n x 1, the part of each variance that is known, N^2: that of
    imputed objects, 0 where every object has a value. `seed` is that of torch's draws.

    Raises:
        UsageError: the function is not found, fails, or gives something else than a usable BoTorch model.
    """
    import torch
    from botorch.models.model import Model

    columns = (np.column_stack([data.x, data.s]), data.y[:, None], data.noise_variance[:, None])
    with own_draws(seed):
        model: Any = call_own(name, *(torch.from_numpy(column.astype(float)) for column in columns))
    if not isinstance(model, Model):
        raise UsageError(f"`{name}` gave a {type(model).__name__}; it must give a fitted BoTorch model.")
    return OwnSurrogate(name, data, model.train(mode=False))


@contextmanager
def own_draws(seed: int) -> Iterator[None]:
    """Make torch draw from `seed` and compute on one thread within: the same numbers whatever ran before."""
    import torch

    n_threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(n_threads)
