"""What a night makes of the simulator: theta and one named effect, fitted to traces of the initial tools alone.

A night never sees a law that is hidden. It knows the traces of `N_INITIAL` random tools, with the scatter of prints and
noise, and a name: that of one of the laws, drawn. How often gap discovery finds it is in `flows.scientist.landscape`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.scientist.landscape_bank import (
    BELIEF,
    HIGH_FRICTION,
    LOW_FRICTION,
    LOW_RATIO,
    OBJECTS,
    SEED,
    THETA_NODES,
    Grasps,
    Simulator,
)

N_INITIAL = 10
TOOL_SD, NOISE_N, MODEL_SHARE = 0.04, 0.1, 0.05  # prints; a bin's mean; what no theta explains, of the peak
# Parameter of the catalogue, and the three values that a night tries first, weakest first.
TRIED: dict[str, tuple[str, tuple[float, float, float]]] = {
    "static_kinetic_friction": ("kinetic_ratio", (0.9, 0.75, 0.55)),
    "force_limited_closing": ("max_force_n", (20.0, 12.0, 7.0)),
    "wall_thickness_offset": ("offset_mm", (0.04, 0.1, 0.18)),
    "pressure_dependent_friction": ("exponent", (0.04, 0.12, 0.25)),
    "base_compliance": ("compliance_mm_per_n", (0.02, 0.05, 0.09)),
    "print_anisotropy": ("rib_excess", (0.1, 0.25, 0.4)),
    "hyperelastic_stiffening": ("stiffening", (4.0, 10.0, 19.0)),
    "shear_adhesion": ("shear_strength_mpa", (0.0007, 0.002, 0.005)),
}
# ln E (MPa), ln friction, Poisson's ratio
_LOWEST, _HIGHEST = np.array([np.log(2.0), np.log(0.3), 0.25]), np.array([np.log(40.0), np.log(1.1), 0.49])
_PRIOR_MEAN, _PRIOR_SD = np.array([np.log(10.2), np.log(0.62), 0.35]), np.array([1.0, 0.4, 0.15])

Model = Callable[[np.ndarray], np.ndarray]  # parameters to peak and bins, initial tools x objects x 13


@dataclass(frozen=True, eq=False)
class ThetaModel:
    """Peak and bins (n x objects x 13) of the common designs at any theta, between simulations at four."""

    centre_n: np.ndarray
    low_friction_n: np.ndarray
    high_friction_n: np.ndarray
    low_ratio_n: np.ndarray

    def bins_n(self, theta: Theta) -> np.ndarray:
        """Quadratic in the logarithm of friction, linear in Poisson's ratio, proportional to E."""
        nodes = np.log([LOW_FRICTION, BELIEF.friction, HIGH_FRICTION])
        at, found = np.log(theta.friction), np.zeros_like(self.centre_n)
        for number, values in enumerate((self.low_friction_n, self.centre_n, self.high_friction_n)):
            others = np.delete(nodes, number)
            found += values * np.prod((at - others) / (nodes[number] - others))
        share = (theta.poisson_ratio - BELIEF.poisson_ratio) / (LOW_RATIO - BELIEF.poisson_ratio)
        found += share * (self.low_ratio_n - self.centre_n)
        return np.asarray(found * theta.young_modulus_mpa / BELIEF.young_modulus_mpa)

    def peaks_n(self, theta: Theta) -> np.ndarray:
        """Peaks, n x objects."""
        return self.bins_n(theta)[..., 0]


def theta_model(grasps: Grasps, x: np.ndarray) -> ThetaModel:
    """The model of the believed simulator at designs x (n x 9)."""
    found = [grasps.bins_n(Simulator(BELIEF), x)]
    for name, theta in THETA_NODES.items():
        grasps.tell(f"theta: {name}")
        found.append(grasps.bins_n(Simulator(theta), x))
    return ThetaModel(*found)


def draw_name(number: int, truth: Simulator) -> str:
    """The law of a truth that gap discovery names where it names one; never more than one in the first night."""
    rng = np.random.default_rng([SEED, number, 9])
    return truth.laws[int(rng.integers(len(truth.laws)))].effect


@dataclass(eq=False)
class Night:
    """The first night of a campaign on one truth; `named` is the effect that gap discovery names."""

    grasps: Grasps
    model: ThetaModel
    truth: Simulator
    x: np.ndarray
    named: str
    print_seed: int

    def __post_init__(self) -> None:
        """Measure the initial tools: the truth with the scatter of prints and with noise."""
        rng = np.random.default_rng([SEED, self.print_seed, 7])
        true_n = self.grasps.bins_n(self.truth, self.x[:N_INITIAL])
        prints = np.exp(TOOL_SD * rng.standard_normal((N_INITIAL, 1, 1)))
        self._measured_n = true_n * prints + NOISE_N * rng.standard_normal(true_n.shape)
        self._theta: np.ndarray = _PRIOR_MEAN

    def fit_theta(self) -> Theta:
        """Theta by largest posterior density, without any effect."""
        self._theta = self._fit(lambda p: self.model.bins_n(_theta_of(p))[:N_INITIAL], _PRIOR_MEAN, 0.0)
        return _rounded(_theta_of(self._theta))

    def fit_effect(self) -> Simulator:
        """Theta and strength of the named effect, corrected once by a simulation at what was found first."""
        first = _rounded(_theta_of(self._theta))
        _, tried = TRIED[self.named]
        strengths = np.array([0.0, *(_strength(self.named, value) for value in tried)])
        changes = [np.zeros((N_INITIAL, len(OBJECTS), self._measured_n.shape[2]))]
        for value in tried:
            changes.append(self._initial_n(self._simulator(first, value)) - self.model.bins_n(first)[:N_INITIAL])
        change = PchipInterpolator(strengths, np.nan_to_num(changes), axis=0)

        def model(p: np.ndarray) -> np.ndarray:
            scale = np.exp(p[0] - self._theta[0])
            return np.asarray(self.model.bins_n(_theta_of(p))[:N_INITIAL] + scale * change(p[3]))

        start = np.array([*self._theta, strengths[1]])
        found = self._fit(model, start, strengths[-1])
        made = self._initial_n(self._found(found))
        missing = np.nan_to_num(made - model(found))
        return self._found(self._fit(lambda p: model(p) + missing, found, strengths[-1]))

    def _found(self, p: np.ndarray) -> Simulator:
        return self._simulator(_rounded(_theta_of(p)), _value(self.named, float(p[3])))

    def _simulator(self, theta: Theta, value: float) -> Simulator:
        name, _ = TRIED[self.named]
        spec = CATALOGUE[self.named]
        shapes = {p.name: p.prior_median for p in spec.parameters if p.name != name}
        return Simulator(theta, effects=(EffectValue(effect=self.named, parameters={name: value, **shapes}),))

    def _initial_n(self, simulator: Simulator) -> np.ndarray:
        return self.grasps.bins_n(simulator, self.x[:N_INITIAL])

    def _fit(self, model: Model, start: np.ndarray, strongest: float) -> np.ndarray:
        """Parameters of largest density; every tool has a modulus of its own."""
        n = len(start)
        sd_n = np.hypot(NOISE_N, MODEL_SHARE * self._measured_n[..., :1])

        def residuals(values: np.ndarray) -> np.ndarray:
            prints = np.exp(values[n:])[:, None, None]
            misfit = np.nan_to_num((model(values[:n]) * prints - self._measured_n) / sd_n)
            prior = (values[:3] - _PRIOR_MEAN) / _PRIOR_SD
            return np.concatenate([misfit.ravel(), prior, values[n:] / TOOL_SD])

        lowest = np.array([*_LOWEST, 0.0][:n] + [-0.3] * N_INITIAL)
        highest = np.array([*_HIGHEST, strongest][:n] + [0.3] * N_INITIAL)
        values = np.clip([*start, *np.zeros(N_INITIAL)], lowest + 1e-9, highest - 1e-9)
        return np.asarray(least_squares(residuals, values, bounds=(lowest, highest)).x[:n])


def _rounded(theta: Theta) -> Theta:
    """Theta as a person would write it; a fit needs its slopes, and so all its digits."""
    return Theta(**{name: round(value, 4) for name, value in theta.model_dump().items()})


def _theta_of(p: np.ndarray) -> Theta:
    modulus, friction = np.exp(p[:2])
    return Theta(young_modulus_mpa=float(modulus), friction=float(friction), poisson_ratio=float(p[2]))


def _strength(effect: str, value: float) -> float:
    """A parameter as a number that is 0 without the effect and grows with it."""
    neutral = _neutral(effect)
    return 1.0 / value if effect == "force_limited_closing" else abs(value - neutral)


def _value(effect: str, strength: float) -> float:
    """The parameter of a strength; inverse of `_strength`."""
    if effect == "force_limited_closing":
        return round(1.0 / max(strength, 1e-3), 6)
    name, tried = TRIED[effect]
    neutral = _neutral(effect)
    return round(float(neutral + np.sign(tried[0] - neutral) * strength), 6)


def _neutral(effect: str) -> float:
    name, _ = TRIED[effect]
    return float(next(p.neutral for p in CATALOGUE[effect].parameters if p.name == name))
