"""What a night makes of the simulator: theta and effects that were named, fitted to traces of the initial tools alone.

A night never sees a law that is hidden. It knows the traces of `N_INITIAL` random tools, with the scatter of prints and
noise, and the names of the laws. As gap discovery does, it takes them one after the other, first the one that explains
most, and leaves out one that explains nothing. How often discovery finds names is in `tests.studies.landscapes.study`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.landscapes.make_bank import (
    BELIEF,
    HIGH_FRICTION,
    LOW_FRICTION,
    LOW_RATIO,
    SEED,
    THETA_NODES,
    Grasps,
    Simulator,
)

N_INITIAL = 10
TOOL_SD, NOISE_N, MODEL_SHARE = 0.04, 0.1, 0.05  # prints; a bin's mean; what no theta explains, of the peak
LEAST_GAIN = 5.0  # of the logarithm of the density, for one more effect: as odds of 150
N_CORRECTIONS = 2
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


@dataclass(frozen=True)
class _Fit:
    """Theta and strengths of effects of largest density. `cost`: half the sum of squares there."""

    names: tuple[str, ...]
    p: np.ndarray  # ln E, ln friction, Poisson's ratio, a strength for each name
    cost: float

    @property
    def simulator(self) -> Simulator:
        """With theta as a person would write it."""
        values = [_value(name, float(strength)) for name, strength in zip(self.names, self.p[3:], strict=True)]
        effects = [_effect(name, value) for name, value in zip(self.names, values, strict=True)]
        return Simulator(_rounded(_theta_of(self.p)), effects=tuple(effects))


@dataclass(eq=False)
class Night:
    """The first night of a campaign on one truth. `names`: effects that gap discovery may name."""

    grasps: Grasps
    model: ThetaModel
    truth: Simulator
    x: np.ndarray
    names: tuple[str, ...]
    print_seed: int

    def __post_init__(self) -> None:
        """Measure the initial tools: the truth with the scatter of prints and with noise."""
        rng = np.random.default_rng([SEED, self.print_seed, 7])
        true_n = self.grasps.bins_n(self.truth, self.x[:N_INITIAL])
        prints = np.exp(TOOL_SD * rng.standard_normal((N_INITIAL, 1, 1)))
        self._measured_n = true_n * prints + NOISE_N * rng.standard_normal(true_n.shape)
        self._theta = self._fit((), lambda p: self.model.bins_n(_theta_of(p))[:N_INITIAL], _PRIOR_MEAN)

    def fit_theta(self) -> Theta:
        """Theta by largest posterior density, without any effect."""
        return self._theta.simulator.theta

    def fit_effects(self) -> Simulator:
        """Theta and strengths of the effects that explain something, corrected by simulations at what was found."""
        found = self._theta
        changes: dict[str, PchipInterpolator] = {}
        for _ in self.names:
            left = [name for name in self.names if name not in found.names]
            changes |= {name: self._change(name) for name in left if name not in changes}
            best = min((self._with_effects((*found.names, n), changes) for n in left), key=lambda fit: fit.cost)
            if found.cost - best.cost < LEAST_GAIN:
                break
            found = best
        for _ in range(N_CORRECTIONS if found.names else 0):
            missing = np.nan_to_num(self._initial_n(found.simulator) - self._forces_n(found.p, found.names, changes))
            found = self._with_effects(found.names, changes, missing, found.p)
        return found.simulator

    def _with_effects(
        self,
        names: tuple[str, ...],
        changes: dict[str, PchipInterpolator],
        missing: np.ndarray | float = 0.0,
        start: np.ndarray | None = None,
    ) -> _Fit:
        if start is None:
            start = np.array([*self._theta.p, *(_strength(name, TRIED[name][1][0]) for name in names)])
        return self._fit(names, lambda p: self._forces_n(p, names, changes) + missing, start)

    def _forces_n(self, p: np.ndarray, names: tuple[str, ...], changes: dict[str, PchipInterpolator]) -> np.ndarray:
        """Forces of the initial tools; what each effect changes is added, and grows with E as all forces do."""
        scale = np.exp(p[0] - self._theta.p[0])
        change = sum((changes[name](strength) for name, strength in zip(names, p[3:], strict=True)), 0.0)
        return np.asarray(self.model.bins_n(_theta_of(p))[:N_INITIAL] + scale * change)

    def _change(self, name: str) -> PchipInterpolator:
        """What an effect changes in the initial tools, N, by its strength; simulated at the theta found first."""
        first = self._theta.simulator.theta
        before_n = self.model.bins_n(first)[:N_INITIAL]
        _, tried = TRIED[name]
        changes = [np.zeros_like(before_n)]
        changes += [self._initial_n(Simulator(first, (_effect(name, value),))) - before_n for value in tried]
        return PchipInterpolator([0.0, *(_strength(name, value) for value in tried)], np.nan_to_num(changes), axis=0)

    def _initial_n(self, simulator: Simulator) -> np.ndarray:
        return self.grasps.bins_n(simulator, self.x[:N_INITIAL])

    def _fit(self, names: tuple[str, ...], model: Model, start: np.ndarray) -> _Fit:
        """Parameters of largest density; every tool has a modulus of its own."""
        n = len(start)
        sd_n = np.hypot(NOISE_N, MODEL_SHARE * self._measured_n[..., :1])

        def residuals(values: np.ndarray) -> np.ndarray:
            prints = np.exp(values[n:])[:, None, None]
            misfit = np.nan_to_num((model(values[:n]) * prints - self._measured_n) / sd_n)
            prior = (values[:3] - _PRIOR_MEAN) / _PRIOR_SD
            return np.concatenate([misfit.ravel(), prior, values[n:] / TOOL_SD])

        strongest = [_strength(name, TRIED[name][1][-1]) for name in names]
        lowest = np.array([*_LOWEST, *np.zeros(len(names)), *np.full(N_INITIAL, -0.3)])
        highest = np.array([*_HIGHEST, *strongest, *np.full(N_INITIAL, 0.3)])
        values = np.clip([*start, *np.zeros(N_INITIAL)], lowest + 1e-9, highest - 1e-9)
        found = least_squares(residuals, values, bounds=(lowest, highest))
        return _Fit(names, np.asarray(found.x[:n]), float(found.cost))


def _effect(name: str, value: float) -> EffectValue:
    """An effect of the catalogue with this value of its strength; its other parameters at their prior medians."""
    of_strength = TRIED[name][0]
    shapes = {p.name: p.prior_median for p in CATALOGUE[name].parameters if p.name != of_strength}
    return EffectValue(effect=name, parameters={of_strength: value, **shapes})


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
