"""Families: effects that the data cannot tell apart once neither has to obey the catalogue's law to the letter.

A transmitter that lags, a clock that is late and a gantry that starts slowly all delay the force. Two of them with
their catalogue laws may lie hundreds of nats apart, but so does the bench from either. So the distance of two fitted
candidates is what is left of the difference of their predictions when theta, tools, numerical error, the parameters of
the one that stands in, and the laws of both may move (`models.gap.fit.law_freedom`), each at the cost of its prior.
Where that is below `LEAST_NATS`, they are kin. Membership is measured in these data; only the words for a family are
fixed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.gap.fit.fit import DEFLATION, Fit
from models.gap.fit.law_freedom import LAW_SD, LawFreedom, compute_change
from models.gap.naming.candidates import FittedCandidate
from models.gap.naming.rank_effects import LEAST_NATS, list_secants
from models.records import EffectValue
from models.simulation.effects.catalogue import CATALOGUE

_DELAY, _ZERO = "delay between lift and force", "constant force of the load cell"
_SLIDING, _PRESSURE = "friction that varies with sliding", "friction or adhesion that varies with pressure"
_CLOSING, _FINGER = "closing force that gives way", "shape of the printed finger"
_MATERIAL, _MEMORY = "stiffness of the material", "stiffness that changes from grasp to grasp"
# What an effect is one form of, in plain words.
WORDS: Mapping[str, str] = {
    "wall_thickness_offset": _FINGER,
    "rib_imperfection": _FINGER,
    "stress_relaxation": "force that fades while it is held",
    "mullins_softening": _MEMORY,
    "hyperelastic_stiffening": _MATERIAL,
    "temperature_softening": _MEMORY,
    "batch_ageing": _MATERIAL,
    "print_anisotropy": _MATERIAL,
    "static_kinetic_friction": _SLIDING,
    "velocity_strengthening_friction": _SLIDING,
    "pressure_dependent_friction": _PRESSURE,
    "shear_adhesion": _PRESSURE,
    "friction_wear": "friction that changes from grasp to grasp",
    "object_edge_radius": "shape of the objects' edges",
    "finger_finger_contact": "contact between the fingers",
    "object_post_compliance": "compliance in series",
    "base_compliance": _CLOSING,
    "force_limited_closing": _CLOSING,
    "pressure_droop": _CLOSING,
    "lift_start_error": _DELAY,
    "lift_misalignment": _DELAY,
    "load_cell_lag": _DELAY,
    "load_cell_gain": "scale of the load cell",
    "load_cell_offset": _ZERO,
    "load_cell_drift": _ZERO,
    "tool_weight": _ZERO,
}


@dataclass(frozen=True)
class Family:
    """Effects that hang together by kinship, with a name in plain words."""

    name: str
    members: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Families:
    """What the data can tell apart among n candidates, with freedom of their laws.

    effects: n, of each candidate. nats: n x n, between their predictions.
    """

    effects: tuple[tuple[str, ...], ...]
    nats: np.ndarray

    def kin_of(self, effect: str) -> tuple[str, ...]:
        """The single effects that the data cannot tell from this one, the nearest first; without itself."""
        place = self.effects.index((effect,))
        near = [other for other in np.argsort(self.nats[place]) if other != place]
        return tuple(
            self.effects[other][0]
            for other in near
            if self.nats[place, other] < LEAST_NATS and len(self.effects[other]) == 1
        )

    def family_of(self, effect: str) -> Family:
        """The family of a single effect: all that hang together with it."""
        return next(family for family in self.groups if effect in family.members)

    @property
    def groups(self) -> tuple[Family, ...]:
        """All families of single effects."""
        single = [place for place, effects in enumerate(self.effects) if len(effects) == 1]
        return group_families([self.effects[place][0] for place in single], self.nats[np.ix_(single, single)])


def find_families(base: Fit, candidates: Sequence[FittedCandidate]) -> Families:
    """Which of the candidates these data cannot tell apart. base: the fit without them."""
    return Families(tuple(candidate.effects for candidate in candidates), compute_kinship(base, candidates))


def compute_kinship(base: Fit, candidates: Sequence[FittedCandidate]) -> np.ndarray:
    """Nats between the predictions of n candidates, n x n, the less of the two ways; 0 of each from itself.

    base: the fit without them; its effects are in every candidate.
    """
    known = {value.effect for value in base.effects}
    models = [
        _Model.of(candidate.fit, [name for name in candidate.effects if name not in known]) for candidate in candidates
    ]
    nats = np.array([[0.0 if a is b else b.nats_from(a) for b in models] for a in models])
    return np.minimum(nats, nats.T)


def separates(first: Fit, second: Fit) -> float:
    """Nats between the predictions of two fits of the same grasps, the less of the two ways; 0 without a difference.

    What is not in both of them may have another law and, where it stands in for the other, other parameters and shapes.
    """
    names = [{value.effect for value in fit.effects} for fit in (first, second)]
    a = _Model.of(first, sorted(names[0] - names[1]))
    b = _Model.of(second, sorted(names[1] - names[0]))
    return min(a.nats_from(b), b.nats_from(a))


def group_families(effects: Sequence[str], nats: np.ndarray) -> tuple[Family, ...]:
    """Connected groups of n effects whose distances (n x n) are below `LEAST_NATS`, in the order of their first."""
    left, families = list(range(len(effects))), []
    while left:
        group = [left.pop(0)]
        for place in group:
            near = [other for other in left if nats[place, other] < LEAST_NATS]
            group += near
            left = [other for other in left if other not in near]
        members = tuple(effects[place] for place in sorted(group))
        families.append(Family(name_family(members), members))
    return tuple(families)


def name_family(members: Sequence[str]) -> str:
    """The words for a family: those of its members, each once."""
    return ", or ".join(dict.fromkeys(WORDS[member] for member in members))


@dataclass(frozen=True, eq=False)
class _Shape:
    """One way in which a model may look: features without its new effects (m x f), and what each of them changes."""

    without: np.ndarray
    changes: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class _Model:
    """A fit with new effects, as it is and in the other shapes that the catalogue's parameters give it.

    free: c x m x f, whitened slopes by theta, tools, numerical error and effects that are not new; precision: c.
    own: p x m x f, slopes by the new effects' parameters.
    """

    fit: Fit
    effects: tuple[str, ...]
    free: np.ndarray
    precision: np.ndarray
    own: np.ndarray
    fitted: _Shape
    others: tuple[_Shape, ...]

    @staticmethod
    def of(fit: Fit, effects: Sequence[str]) -> "_Model":
        columns, first = fit.columns / fit.weight, len(fit.columns) - fit.n_effect_columns
        names = [value.effect for value in fit.effects for _ in CATALOGUE[value.effect].parameters]
        is_own = np.array([*[False] * first, *(name in effects for name in names)])
        changes = tuple(compute_change(fit, effect) for effect in effects)
        without = fit.modelled - sum(changes, np.zeros_like(fit.modelled))
        others: list[_Shape] = []
        if len(effects) == 1:
            rest = [value for value in fit.effects if value.effect != effects[0]]
            alone = fit.predict_features(rest)
            for value in _list_shapes(fit, effects[0]):
                others.append(_Shape(without, (fit.predict_features([*rest, value]) - alone,)))
        return _Model(
            fit=fit,
            effects=tuple(effects),
            free=columns[~is_own],
            precision=fit.precision[~is_own],
            own=columns[is_own],
            fitted=_Shape(without, changes),
            others=tuple(others),
        )

    def nats_from(self, target: "_Model") -> float:
        """What is left of another model's prediction when this one, in its best shape, stands in for it."""
        weight = np.sqrt(0.5 * (self.fit.weight**2 + target.fit.weight**2))
        whiten = self.fit.features.whiten
        laws = [target.law_columns(target.fitted.changes), self.law_columns(self.fitted.changes)]
        tied = np.full(len(self.own), 0.25)
        columns = np.concatenate([self.free, self.own, *laws])
        found = [self._solve(whiten(target.fit.modelled - self.fit.modelled), columns, tied, weight)]
        for shape in self.others:
            (change,) = shape.changes
            difference, line = whiten(target.fit.modelled - shape.without), whiten(change)[None]
            share = self._scale(difference, line, weight)
            if share <= 0.0:
                continue
            columns = np.concatenate([self.free, line, laws[0], self.law_columns((share * change,))])
            found.append(self._solve(difference, columns, np.full(1, 0.25), weight))
        return min(found)

    def law_columns(self, changes: Sequence[np.ndarray]) -> np.ndarray:
        """Columns of the freedom of the new effects' laws, whitened, in units of their priors."""
        found = [np.zeros((0, *self.fit.raw.shape))]
        for effect, change in zip(self.effects, changes, strict=True):
            freedom = LawFreedom.of(self.fit, effect, change)
            if freedom is not None:
                found.append(LAW_SD * freedom.columns(self.fit) / self.fit.weight)
        return np.concatenate(found)

    def _scale(self, difference: np.ndarray, line: np.ndarray, weight: np.ndarray) -> float:
        """How much of a shape explains a difference best, besides theta and tools."""
        columns = np.concatenate([line, self.free]) * weight
        flat, precision = columns.reshape(len(columns), -1), np.concatenate([[1e-9], self.precision])
        gram = flat @ flat.T + np.diag(precision)
        return float(np.linalg.solve(gram, flat @ (difference * weight).ravel())[0])

    def _solve(self, difference: np.ndarray, columns: np.ndarray, tied: np.ndarray, weight: np.ndarray) -> float:
        """Least of the deflated squares of what columns leave of a whitened difference, with their priors, in nats."""
        flat, goal = (columns * weight).reshape(len(columns), -1), (difference * weight).ravel()
        n_laws = len(columns) - len(self.precision) - len(tied)
        precision = np.concatenate([self.precision, tied, np.ones(n_laws)])
        along = DEFLATION * flat @ goal
        gram = DEFLATION * flat @ flat.T + np.diag(precision)
        return float(0.5 * (DEFLATION * goal @ goal - along @ np.linalg.solve(gram, along)))


def _list_shapes(fit: Fit, effect: str) -> list[EffectValue]:
    """Secants of an effect, largest amplitude of each sign, whose shape is not the fit's."""
    spec = CATALOGUE[effect]
    if len(spec.parameters) == 1:
        return []
    best: dict[tuple[object, ...], EffectValue] = {}
    first = spec.parameters[0]
    for value in list_secants(effect):
        size = value.parameters.get(first.name, first.neutral) - first.neutral
        shape = tuple(number for name, number in sorted(value.parameters.items()) if name != first.name)
        key = (size > 0, shape)
        known = best.get(key)
        if known is None or abs(size) > abs(known.parameters.get(first.name, first.neutral) - first.neutral):
            best[key] = value
    return list(best.values())
