"""The health card of a surrogate: how well it predicts what it has seen, and whether simulation helps it."""

import numpy as np
from scipy.special import bdtr

from fast.models.records import Record
from fast.models.scientist.surrogate.fit import fit_surrogate, refit_without
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS, REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import LeaveOneOut, Surrogate, observation_variance

Z_90 = 1.6448536269514722  # half width of the central 90 % of a standard normal
LEAST_GAIN = 0.15  # of the leave-one-out error: simulations of something else reach 0.1 by chance at 40 tools
LEAST_Q2 = 0.3
LEAST_COVERAGE, MOST_OUTSIDE_P = 0.9, 0.01
OUTLIER_SD = 4.0
N_GROUPS = 10  # of measured designs, each predicted by a fit to all others: one fit for each group
MANY = 200  # measured designs: parameters of all hardly know one of them (4 % of the error), and more fits take minutes


class SurrogateHealth(Record):
    """How well the surrogate predicts what it has seen, each observation left out in turn. None: fewer than two.

    Measured designs are predicted by `predict_left_out`, simulated ones with the parameters of all.
    """

    n_real: int
    """Measured designs."""
    n_sim: int
    """Simulated designs."""
    rho: float
    """Scale from simulation to measurement."""
    shared_variance: float
    """Share of the measured outcome's prior variance that comes through the simulator, rho^2 sd_h^2 / (rho^2 sd_h^2 +
    sd_e^2)."""
    loo_rmse_n: float | None
    """Error of measured designs that were left out."""
    loo_coverage_90: float | None
    """Share of them inside their own central 90 % interval: far below 0.9 is overconfident."""
    loo_q2: float | None
    """Share of their variance that is predicted."""
    sim_loo_rmse_n: float | None
    """The same of simulated designs."""
    sim_loo_coverage_90: float | None
    """The same of simulated designs."""
    sim_loo_q2: float | None
    """The same of simulated designs."""
    measured_only_loo_rmse_n: float | None
    """Error of a surrogate that was fitted to the measurements alone."""
    n_outliers: int = 0
    """Measured designs more than `OUTLIER_SD` from their prediction."""
    n_prior: int = 0
    """Designs measured in prior campaigns."""
    without_prior_loo_rmse_n: float | None = None
    """Error of a surrogate fitted without them."""

    @property
    def prior_gain(self) -> float | None:
        """Share by which prior campaigns reduce the error at measured designs; negative where they mislead."""
        if self.loo_rmse_n is None or not self.without_prior_loo_rmse_n:
            return None
        return 1.0 - self.loo_rmse_n / self.without_prior_loo_rmse_n

    @property
    def simulation_gain(self) -> float | None:
        """Share by which simulations reduce the error at measured designs; negative where they mislead."""
        if self.loo_rmse_n is None or not self.measured_only_loo_rmse_n:
            return None
        return 1.0 - self.loo_rmse_n / self.measured_only_loo_rmse_n


def is_overconfident(coverage_90: float, n: int) -> bool:
    """Return whether so few of n observations lie in their 90 % interval that chance explains it in < 1 % of cases."""
    return bool(bdtr(round(coverage_90 * n), n, LEAST_COVERAGE) < MOST_OUTSIDE_P)


def health_of(surrogate: Surrogate) -> SurrogateHealth:
    """Return the health card; costs a fit to the measurements alone, and those of `predict_left_out`."""
    loo, p, data = surrogate.leave_one_out(), surrogate.parameters, surrogate.data
    real, sim = _fidelity(surrogate, predict_left_out(surrogate), REAL), _fidelity(surrogate, loo, SIM)
    shared = p.rho**2 * p.sd_h**2
    return SurrogateHealth(
        n_real=data.n_real,
        n_sim=data.n_sim,
        rho=p.rho,
        shared_variance=shared / (shared + p.sd_e**2),
        loo_rmse_n=real[0],
        loo_coverage_90=real[1],
        loo_q2=real[2],
        sim_loo_rmse_n=sim[0],
        sim_loo_coverage_90=sim[1],
        sim_loo_q2=sim[2],
        measured_only_loo_rmse_n=_rmse_alone_n(data, data.n_sim, data.take(data.s != SIM)),
        n_outliers=int(np.count_nonzero(_outliers(surrogate, loo))),
        n_prior=data.n_prior,
        without_prior_loo_rmse_n=_rmse_alone_n(data, data.n_prior, data.of_this_campaign()),
    )


def predict_left_out(surrogate: Surrogate) -> LeaveOneOut:
    """Predict each measured design by a surrogate fitted without it, lengthscales and noise included, n.

    Up to `N_GROUPS` designs are left out one by one, more in as many groups. With the parameters of all, which know the
    design that is left out, twelve tools look predicted to two thirds of the error that new ones have; they are taken
    where there are more than `MANY` designs. NaN for others.
    """
    data, real = surrogate.data, np.flatnonzero(surrogate.data.s == REAL)
    if len(real) > MANY:
        loo, is_real = surrogate.leave_one_out(), data.s == REAL
        return LeaveOneOut(np.where(is_real, loo.mean, np.nan), np.where(is_real, loo.sd, np.nan))
    mean, variance = np.full((2, len(data)), np.nan)
    for first in range(min(N_GROUPS, len(real))):
        rows = real[first::N_GROUPS]
        others = refit_without(surrogate, rows)
        mean[rows], sd = others.predict(data.x[rows], REAL)
        variance[rows] = sd**2 + observation_variance(others.parameters, data.s[rows]) + data.noise_variance[rows]
    return LeaveOneOut(mean, np.sqrt(variance))


def _outliers(surrogate: Surrogate, loo: LeaveOneOut) -> np.ndarray:
    """Tell which observations are measured and far from their prediction with the parameters of all, n."""
    far = np.abs(surrogate.data.y - loo.mean) > OUTLIER_SD * loo.sd
    return np.asarray(far & (surrogate.data.s == REAL))


def _rmse_alone_n(data: ObservationSet, n_others: int, kept: ObservationSet) -> float | None:
    """Return the leave-one-out error of a fit to the kept observations; None without others, or of too few tools."""
    if n_others == 0 or data.n_real < MIN_OBSERVATIONS:
        return None
    alone = fit_surrogate(kept)
    return _fidelity(alone, predict_left_out(alone), REAL)[0]


def _fidelity(surrogate: Surrogate, loo: LeaveOneOut, fidelity: int) -> tuple[float | None, float | None, float | None]:
    """Return root mean square error (N), coverage and Q2 of the observations of one fidelity."""
    rows = surrogate.data.s == fidelity
    if np.count_nonzero(rows) < 2:
        return None, None, None
    y = surrogate.data.force_n(surrogate.data.y[rows])
    error = y - surrogate.data.force_n(loo.mean[rows])
    spread = float(np.var(y))
    q2 = 1.0 - float(np.mean(error**2)) / spread if spread > 0 else None
    return float(np.sqrt(np.mean(error**2))), _coverage(surrogate, loo, rows), q2


def _coverage(surrogate: Surrogate, loo: LeaveOneOut, rows: np.ndarray) -> float:
    return float(np.mean(np.abs(surrogate.data.y[rows] - loo.mean[rows]) <= Z_90 * loo.sd[rows]))
