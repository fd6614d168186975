"""One chain of PyMC's NUTS on any log density with a gradient. Imports PyMC: import this module late."""

import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fast.models.blas import one_blas_thread
from fast.models.calibration.inference.libraries import quiet_import
from fast.models.calibration.inference.optimise import LogDensity
from fast.models.calibration.inference.settings import CalibrationSettings

with quiet_import():
    import pymc as pm
import pytensor
from pymc.step_methods.hmc.quadpotential import QuadPotentialFull
from pytensor.compile.mode import Mode
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.tensor import TensorType

_FIRST_WINDOW, _WINDOW_GROWTH = 50, 2.0
_PYTHON = Mode(linker="py", optimizer="fast_run")  # the density is Python: a C compiler would gain nothing


class Chain(NamedTuple):
    """Draws of a chain after tuning (draws x k), and what happened on the way."""

    draws: np.ndarray
    n_divergences: int
    n_gradients: int
    n_deepest: int
    tree_depth: np.ndarray
    cpu_s: float


class DensityOp(Op):
    """A log density of k numbers as a PyTensor operation: its value, and its gradient as the second output."""

    def __init__(self, log_density: LogDensity) -> None:
        self.log_density = log_density
        self.n_calls = 0

    def make_node(self, *inputs: Any) -> Apply:
        """Make the node for value (scalar) and gradient (k) of one vector (k)."""
        (values,) = inputs
        return Apply(self, [values], [TensorType("float64", ())(), TensorType("float64", (None,))()])

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate both at once: NUTS never wants one without the other."""
        value, gradient = self.log_density(inputs[0])
        self.n_calls += 1
        output_storage[0][0] = np.asarray(value, dtype=np.float64)
        output_storage[1][0] = np.asarray(gradient, dtype=np.float64)

    def L_op(self, inputs: Sequence[Any], outputs: Sequence[Any], output_grads: Sequence[Any]) -> list[Any]:
        """Apply the reverse-mode rule of the value; the gradient itself is not differentiated."""
        return [output_grads[0] * outputs[1]]


class DenseMetric(QuadPotentialFull):
    """Dense metric of NUTS, learnt in growing windows of the tuning and shrunk towards the first covariance.

    Each window's covariance S of n draws becomes (n S + w C) / (n + w), with C the covariance given at the start and
    w = k + 10: a window shorter than the dimension is then no worse than C.
    """

    def __init__(self, covariance: np.ndarray) -> None:
        super().__init__(covariance)
        self._first = np.array(covariance)
        self._window: list[np.ndarray] = []
        self._length = float(_FIRST_WINDOW)

    def update(self, sample: np.ndarray, grad: np.ndarray, tune: bool) -> None:
        """Take one draw of the tuning; the metric changes at the end of a window."""
        if not tune:
            return
        self._window.append(np.array(sample))
        if len(self._window) < self._length:
            return
        n, weight = len(self._window), len(self._first) + 10.0
        self._cov = (n * np.cov(np.array(self._window), rowvar=False) + weight * self._first) / (n + weight)
        self._chol = np.linalg.cholesky(self._cov)
        self._window = []
        self._length *= _WINDOW_GROWTH

    def reset(self) -> None:
        """Begin the first window again."""
        self._window, self._length = [], float(_FIRST_WINDOW)


def run_chain(
    log_density: LogDensity,
    start: np.ndarray,
    scale: np.ndarray | None,
    settings: CalibrationSettings,
    seed: int,
    progress: Callable[[int, int], None],
) -> Chain:
    """Tune and draw one chain from `start` (k); `scale` (k x k) is a guess of the posterior covariance.

    `progress` hears how many draws, tuning included, are done, and the divergences after tuning.
    """
    started = time.process_time()
    operation = DensityOp(log_density)
    metric = DenseMetric(np.eye(len(start)) if scale is None else scale)

    def on_draw(trace: Any, draw: Any) -> None:
        progress(len(trace), int(draw.stats[0]["divergences"]))

    with warnings.catch_warnings(), one_blas_thread(), pytensor.config.change_flags(mode=_PYTHON, cxx=""):
        # What is wrong with a chain is counted and reported by the caller.
        warnings.simplefilter("ignore")
        with pm.Model():
            z = pm.Flat("z", shape=len(start))
            pm.Potential("log_density", operation.make_node(z).outputs[0])
            step = pm.NUTS(target_accept=settings.target_accept, potential=metric)
            operation.n_calls = 0
            trace = pm.sample(
                draws=settings.draws,
                tune=settings.tune,
                chains=1,
                cores=1,
                step=step,
                initvals={"z": start},
                random_seed=seed,
                callback=on_draw,
                quiet=True,
                progressbar=False,
                compute_convergence_checks=False,
                return_inferencedata=False,
            )
    return _chain(trace, operation.n_calls, time.process_time() - started)


def _chain(trace: Any, n_gradients: int, cpu_s: float) -> Chain:
    return Chain(
        draws=trace.get_values("z"),
        n_divergences=int(trace.get_sampler_stats("diverging").sum()),
        n_gradients=n_gradients,
        n_deepest=int(trace.get_sampler_stats("reached_max_treedepth").sum()),
        tree_depth=trace.get_sampler_stats("depth"),
        cpu_s=cpu_s,
    )
