"""The joint posterior by blocks: NUTS on psi given phi, alternated with moves of the emulator's parameters phi.

For problems too large for NUTS on everything whose importance weights fail. A step of NUTS on psi costs the emulator's
factor nothing; phi moves by preconditioned Crank-Nicolson steps (Cotter et al. 2013, Statistical Science 28:424) of its
normal approximation, phi' = mean + sqrt(1 - b^2) (phi - mean) + b xi, accepted by the ratio of target to normal.
"""

import numpy as np

from models.blas import one_blas_thread
from models.calibration.inference.diagnostics import diagnose
from models.calibration.inference.nuts import ChangingDensity
from models.calibration.inference.optimise import Optimum, starts_around
from models.calibration.inference.parallel_chains import Progress, sample
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means import conditional_density as conditional
from models.calibration.means.conditional_density import Setting
from models.calibration.means.emulator import Factor, factorise
from models.calibration.means.factorised import Steps, find_peak
from models.calibration.means.joint_density import JointDensity
from models.calibration.means.laplace import NormalPhi, approximate_phi
from models.calibration.means.parameters import Layout
from models.calibration.means.problem import CalibrationProblem, Standardised

MOVES = (1.0, 0.5, 0.2)  # b of the moves of phi before each step of NUTS: a draw afresh, a half, a nudge


def calibrate_blocked(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None = None
) -> CalibrationResult:
    """Posterior of every parameter (Eq. 12), exact for long chains; a draw costs some gradients and three factors."""
    data = Standardised.of(problem)
    setting = Setting.of(data, Layout.of(data, settings))
    steps = Steps(progress or (lambda line: None))
    with one_blas_thread():
        peak = find_peak(setting, settings, steps)
        with steps("curvature"):
            normal_phi, cpu_s = approximate_phi(
                JointDensity(data, setting.layout), peak.vector, settings.workers, progress
            )
            steps.add("curvature", cpu_s)
        with steps("sampling"):
            density = GivenPhi(setting, normal_phi, peak.factor)
            psi = peak.vector[setting.layout.n_phi :]
            rng = np.random.default_rng([settings.seed, 3])
            starts = starts_around(density, [Optimum(psi, density(psi)[0])], peak.psi_covariance, settings.chains, rng)
            samples = sample(density, starts, settings, scale=peak.psi_covariance, progress=progress)
            steps.add("sampling", samples.cpu_s if settings.workers > 1 else 0.0)
    draws = setting.layout.constrain(samples.draws, data.force_scale_n)
    found = diagnose(problem, setting.layout.names, draws, settings, samples.n_divergences, samples.n_deepest)
    return CalibrationResult(
        names=setting.layout.names,
        draws=draws,
        settings=settings,
        method="blocked",
        r_hat=found.r_hat,
        ess_bulk=found.ess_bulk,
        ess_tail=found.ess_tail,
        n_divergences=samples.n_divergences,
        n_gradients=samples.n_gradients,
        warnings=found.warnings,
        cpu_s=sum(steps.cpu_s.values()),
        steps=steps.cpu_s,
    )


class GivenPhi(ChangingDensity):
    """log p(y_R | psi, phi) + log p(psi) at a phi that moves."""

    def __init__(self, setting: Setting, normal_phi: NormalPhi, factor: Factor) -> None:
        self._setting, self._normal, self._factor = setting, normal_phi, factor
        self._white = np.zeros(len(normal_phi.mean))

    def __call__(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient by psi (n_psi)."""
        return conditional.log_posterior(values, self._factor, self._setting)

    @property
    def state(self) -> np.ndarray:
        """Phi, vector form."""
        return np.asarray(self._normal.mean + self._normal.root @ self._white)

    def begin(self, rng: np.random.Generator) -> None:
        """Draw phi from half its normal approximation; where the covariance is singular, begin at the mean."""
        self._white = 0.5 * rng.standard_normal(len(self._white))
        factor = self._at(self._white)
        if factor is None:
            self._white = np.zeros_like(self._white)
            factor = self._at(self._white)
        if factor is not None:
            self._factor = factor

    def move(self, values: np.ndarray, rng: np.random.Generator) -> None:
        """Crank-Nicolson moves of phi given psi."""
        here = self.log_ratio(self._white, self._factor, values)
        for b in MOVES:
            white = np.sqrt(1.0 - b**2) * self._white + b * rng.standard_normal(len(self._white))
            chance = np.log(rng.random())
            factor = self._at(white)
            if factor is None:
                continue
            there = self.log_ratio(white, factor, values)
            if chance < there - here:
                self._white, self._factor, here = white, factor, there

    def _at(self, white: np.ndarray) -> Factor | None:
        phi = self._normal.mean + self._normal.root @ white
        return factorise(self._setting.layout.phi(phi), self._setting.data)

    def log_ratio(self, white: np.ndarray, factor: Factor, psi: np.ndarray) -> float:
        """Log of the joint density over that of the normal approximation."""
        phi = self._normal.mean + self._normal.root @ white
        prior = self._setting.layout.log_prior_phi(phi)[0]
        measured = conditional.log_likelihood(psi, factor, self._setting)
        return float(factor.log_density + prior + measured + 0.5 * white @ white)
