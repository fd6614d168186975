"""What a calibration is fitted to, and its standardised form."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fast.models.calibration.means.trend import FRICTION_OFFSET, ForceTrend
from fast.models.design.space import PARAMETERS
from fast.models.errors import UsageError

THETA = ("young_modulus_mpa", "friction", "poisson_ratio")
# Ranges of the paper's Latin hypercube; they scale the simulator's inputs, and bound no posterior.
THETA_LOWER = np.array([2.0, 0.02, 0.2])
THETA_UPPER = np.array([200.0, 2.0, 0.5])
MIN_SIMULATIONS, MIN_DESIGNS = 20, 5


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """Simulated and measured mean peak forces of designs (Eq. 9-10)."""

    x_sim: np.ndarray
    """Simulated designs, n x 9, unit cube."""
    theta_sim: np.ndarray
    """n x 3: young_modulus_mpa, friction, poisson_ratio."""
    y_sim: np.ndarray
    """Simulated means, n, N."""
    variance_sim: np.ndarray
    """Known extra variance of them (objects without a result), n, N^2."""
    x_real: np.ndarray
    """Measured designs, m x 9, unit cube."""
    y_real: np.ndarray
    """Measured means, m, N."""
    variance_real: np.ndarray
    """Known extra variance of them, m, N^2."""
    scales_with_modulus: bool = False
    """Simulated forces are proportional to Young's modulus, F = E phi(friction, Poisson ratio, design), so that E is a
    factor instead of an input."""

    def __post_init__(self) -> None:
        """Check shapes, values and counts once, at the boundary.

        Raises:
            UsageError: shapes differ, a value is not finite, a variance is negative, forces do not vary, or there
                are too few simulations or designs.
        """
        self._check_shapes()
        self._check_values()
        self._check_counts()

    @property
    def n_sim(self) -> int:
        """Number of simulated designs."""
        return len(self.y_sim)

    @property
    def n_real(self) -> int:
        """Number of measured designs."""
        return len(self.y_real)

    def take_real(self, rows: np.ndarray) -> "CalibrationProblem":
        """Return the same simulations with some of the measured designs (row numbers or a mask)."""
        return CalibrationProblem(
            self.x_sim,
            self.theta_sim,
            self.y_sim,
            self.variance_sim,
            self.x_real[rows],
            self.y_real[rows],
            self.variance_real[rows],
            self.scales_with_modulus,
        )

    def _check_shapes(self) -> None:
        n, m, d = self.n_sim, self.n_real, len(PARAMETERS)
        wanted = {
            "x_sim": (n, d),
            "theta_sim": (n, len(THETA)),
            "variance_sim": (n,),
            "x_real": (m, d),
            "variance_real": (m,),
        }
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise UsageError(f"{name} has shape {found}; give {shape} for {n} simulations and {m} designs.")

    def _check_values(self) -> None:
        for name in ("x_sim", "theta_sim", "y_sim", "variance_sim", "x_real", "y_real", "variance_real"):
            values = getattr(self, name)
            is_bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
            if is_bad.any():
                row = int(np.flatnonzero(is_bad)[0])
                raise UsageError(f"row {row} of {name} is not finite; leave that design out or impute its force.")
        if min(self.variance_sim.min(initial=0.0), self.variance_real.min(initial=0.0)) < 0:
            raise UsageError("a known variance is negative; variances are in N^2 and at least 0.")
        if self.n_sim and (self.theta_sim[:, 0] <= 0).any():
            raise UsageError("a simulation has a Young's modulus of 0 MPa or less; it must be above 0.")

    def _check_counts(self) -> None:
        if self.n_sim < MIN_SIMULATIONS:
            raise UsageError(
                f"a calibration has {self.n_sim} simulations, it needs at least {MIN_SIMULATIONS} with different "
                "Young's modulus, friction and Poisson ratio; simulate more designs."
            )
        if self.n_real < MIN_DESIGNS:
            raise UsageError(
                f"a calibration has {self.n_real} measured designs, it needs at least {MIN_DESIGNS}; measure more."
            )
        for name, values in (("simulated", self.y_sim), ("measured", self.y_real)):
            if np.ptp(values) <= 1e-9 * max(1.0, float(np.abs(values).max())):
                raise UsageError(f"all {name} forces are {values[0]:.4g} N; a calibration needs forces that vary.")


@dataclass(frozen=True, eq=False)
class Standardised:
    """The problem without units, for a zero-mean, unit-scale process g over the simulator's inputs z.

        y_sim = g(z) + nugget,    y_real = a tau (mean + g([x_real, t])) + eps(x_real) + noise,

    with a = amplitude(theta) and tau the trend over designs.
    """

    z_sim: np.ndarray
    """n x d: the nine design variables, then ln E unless it is a factor, friction, Poisson ratio, all scaled to the
    unit cube."""
    y_sim: np.ndarray
    """Simulated means, n, standardised."""
    variance_sim: np.ndarray
    """Known extra variance of them, n."""
    x_real: np.ndarray
    """Measured designs, m x 9, unit cube."""
    y_real: np.ndarray
    """Measured means, m, standardised."""
    variance_real: np.ndarray
    """Known extra variance of them, m."""
    mean: float
    """Of the process, in units of y_sim."""
    force_scale_n: float
    """The unit of y_real, eps and noise."""
    sim_scale_n: float
    """The unit of y_sim and nugget (N, or N per MPa where E is a factor)."""
    center_n: float
    """Taken from both forces; 0 where E is a factor."""
    scales_with_modulus: bool
    """Whether E is a factor."""
    trend: ForceTrend
    """Where E is a factor, forces per MPa are emulated in units of this, of which a has the part of theta; else tau is
    1."""

    @staticmethod
    def of(problem: CalibrationProblem) -> "Standardised":
        """Standardise a problem. Where E is a factor, forces per MPa are emulated."""
        if problem.scales_with_modulus:
            modulus_mpa, friction, poisson_ratio = problem.theta_sim.T
            trend = ForceTrend.fit(problem.x_sim, friction, poisson_ratio, problem.y_sim / modulus_mpa)
            unit = modulus_mpa * trend.of_designs(problem.x_sim) * trend.of_theta(friction, poisson_ratio)
            y, variance = problem.y_sim / unit, problem.variance_sim / unit**2
            sim_scale, force_scale = float(np.std(y, ddof=1)), float(np.std(problem.y_real, ddof=1))
            mean, center, y_sim = float(np.mean(y)) / sim_scale, 0.0, (y - np.mean(y)) / sim_scale
        else:
            y, variance, trend = problem.y_sim, problem.variance_sim, ForceTrend()
            sim_scale = force_scale = float(np.std(y, ddof=1))
            mean, center = 0.0, float(np.mean(y))
            y_sim = (y - center) / sim_scale
        return Standardised(
            z_sim=np.column_stack([problem.x_sim, unit_theta(problem.theta_sim, problem.scales_with_modulus)]),
            y_sim=y_sim,
            variance_sim=variance / sim_scale**2,
            x_real=problem.x_real,
            y_real=(problem.y_real - center) / force_scale,
            variance_real=problem.variance_real / force_scale**2,
            mean=mean,
            force_scale_n=force_scale,
            sim_scale_n=sim_scale,
            center_n=center,
            scales_with_modulus=problem.scales_with_modulus,
            trend=trend,
        )

    @cached_property
    def trend_real(self) -> np.ndarray:
        """Trend tau of the measured designs, m."""
        return self.trend.of_designs(self.x_real)

    @property
    def n_inputs(self) -> int:
        """Number d of the simulator's inputs: 12, or 11 where E is a factor."""
        return self.z_sim.shape[1]

    def take_sim(self, rows: np.ndarray) -> "Standardised":
        """Return the same measurements with some of the simulations (row numbers or a mask), in the same units."""
        return replace(self, z_sim=self.z_sim[rows], y_sim=self.y_sim[rows], variance_sim=self.variance_sim[rows])

    def to_newton(
        self, mean: np.ndarray, variance: np.ndarray, extra: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return means (N) and variances (N^2) of standardised measured forces; `extra` (N^2) adds to the variance."""
        return self.center_n + self.force_scale_n * mean, self.force_scale_n**2 * variance + extra

    def amplitude(self, theta: np.ndarray, rho: float) -> float:
        """Return the factor a between the emulated process and measured forces at theta (3, physical)."""
        if not self.scales_with_modulus:
            return rho
        return rho * float(theta[0] * self.trend.of_theta(theta[1], theta[2])) * self.sim_scale_n / self.force_scale_n

    def amplitude_slopes(self, theta: np.ndarray) -> np.ndarray:
        """Return the slopes of ln a by theta (3, physical)."""
        if not self.scales_with_modulus:
            return np.zeros(3)
        return np.array([1.0 / theta[0], *self.trend.log_slopes(float(theta[1]))])


def unit_theta(theta: np.ndarray, scales_with_modulus: bool) -> np.ndarray:
    """Return theta (n x 3, physical) as inputs of the emulator in unit-cube scale.

    ln E, friction and Poisson's ratio, n x 3; where E is a factor ln(friction + offset) and Poisson's ratio, n x 2.
    """
    values = _inputs(np.array(theta, dtype=float), scales_with_modulus)
    lower, upper = _inputs(np.array([THETA_LOWER, THETA_UPPER]), scales_with_modulus)
    return np.asarray((values - lower) / (upper - lower))


def unit_theta_slopes(theta: np.ndarray, scales_with_modulus: bool) -> np.ndarray:
    """Return each slope of `unit_theta` by its own physical parameter at a theta (3); 3, or 2 where E is a factor."""
    lower, upper = _inputs(np.array([THETA_LOWER, THETA_UPPER]), scales_with_modulus)
    by_friction = 1.0 / (theta[1] + FRICTION_OFFSET) if scales_with_modulus else 1.0
    slopes = np.array([1.0 / theta[0], by_friction, 1.0])
    return (slopes[1:] if scales_with_modulus else slopes) / (upper - lower)


def _inputs(theta: np.ndarray, scales_with_modulus: bool) -> np.ndarray:
    modulus_mpa, friction, poisson_ratio = theta.T
    if scales_with_modulus:
        return np.column_stack([np.log(friction + FRICTION_OFFSET), poisson_ratio])
    return np.column_stack([np.log(modulus_mpa), friction, poisson_ratio])


def friction_at(unit: np.ndarray) -> np.ndarray:
    """Return friction at places `unit` (0 to 1, any shape) of the paper's range, even in ln(friction + offset).

    Where E is a factor, simulations spread like this leave the emulator as sure at one end of the ridge of E and
    friction as at the other; spread evenly in friction they draw the posterior to high friction.
    """
    lower, upper = np.log(THETA_LOWER[1] + FRICTION_OFFSET), np.log(THETA_UPPER[1] + FRICTION_OFFSET)
    return np.asarray(np.exp(lower + unit * (upper - lower)) - FRICTION_OFFSET)


def drop_repeats(problem: CalibrationProblem) -> tuple[CalibrationProblem, tuple[str, ...]]:
    """Return the problem with each row once, and a sentence for every kind of row left out.

    A row is left out when its design, theta, force and variance all repeat an earlier one: a deterministic simulator
    run twice, or a measurement entered twice, tells nothing new, while a second copy would be taken for proof that
    nugget and noise are zero. The same design with another force stays: that is what nugget and noise are for.
    """
    sim = np.column_stack([problem.x_sim, problem.theta_sim, problem.y_sim, problem.variance_sim])
    real = np.column_stack([problem.x_real, problem.y_real, problem.variance_real])
    first_sim, first_real = _first_rows(sim), _first_rows(real)
    sentences = []
    for what, n_all, kept in (("simulations", len(sim), first_sim), ("measured designs", len(real), first_real)):
        if len(kept) < n_all:
            repeated = int(np.setdiff1d(np.arange(n_all), kept)[0])
            sentences.append(
                f"{n_all - len(kept)} of {n_all} {what} repeat another in design and force (the first is row "
                f"{repeated}) and were left out; check whether they were entered twice."
            )
    if not sentences:
        return problem, ()
    fewer = CalibrationProblem(
        x_sim=problem.x_sim[first_sim],
        theta_sim=problem.theta_sim[first_sim],
        y_sim=problem.y_sim[first_sim],
        variance_sim=problem.variance_sim[first_sim],
        x_real=problem.x_real[first_real],
        y_real=problem.y_real[first_real],
        variance_real=problem.variance_real[first_real],
        scales_with_modulus=problem.scales_with_modulus,
    )
    return fewer, tuple(sentences)


def _first_rows(rows: np.ndarray) -> np.ndarray:
    """Return the numbers of the rows that repeat no earlier one, ascending."""
    _, first = np.unique(rows, axis=0, return_index=True)
    return np.sort(first)
