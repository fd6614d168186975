"""What changes from grasp to grasp: what repeats of a cell differ by, in which no simulator has a part.

Pressure falls and comes back, a tool wears, a finger warms up. A drift says how much a quantity has changed at a time:
c ~ GP(0, size^2 k), with k a Matern kernel of order 3/2 along a clock. It need not obey any law. Only differences of
repeats of a cell are looked at, whose mean is free: mesh, contact law, prints and placements are the same in all of
them, so what honest simulators differ by does not count here, and much smaller changes can be told.

Which quantity changes is told by how the change differs between tools, objects and phases of the lift, as the bank has
it. Along which clock it changes is told less well: within a tool's grasps all clocks run alike.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.bank.bank import DEEPER_MM
from fast.models.gap.bank.surrogate import N_BINS, with_own_lead
from fast.models.gap.findings import LawCurve
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.law_freedom import solve_step
from fast.models.gap.fit.whitened_features import OF_OFFSET
from fast.models.gap.grasps import Grasps
from fast.models.gap.naming.candidates import Score
from fast.models.gap.naming.patterns import Pattern, weigh
from fast.models.records import GraspContext
from fast.models.simulation.effects.catalogue import CATALOGUE

LENGTHS = (10.0, 30.0, 100.0, 300.0)  # of a drift, in grasps: all are tried
_REPEATS_LENGTH = 1.0
_SPACING = 0.4  # of knots, in lengths
_MOST_KNOTS = 60  # of a batch
_STEP = 0.02  # of finite differences: relative, or mm
_JITTER = 1e-6
_Z90, _N_STATES = 1.645, 40

Field = Callable[[Fit], np.ndarray]


@dataclass(frozen=True)
class Changing:
    """A quantity that may change. field: what one unit more changes in the features (m x f).

    words: as a person would say that it changes; name, with its unit; neutral: its value without a change.
    """

    words: str
    name: str
    neutral: float
    field: Field


@dataclass(frozen=True)
class Clock:
    """Along what a quantity changes. is_by_batch: every batch has a drift of its own; else all tools have the same.

    words: when it changes; name: what the clock counts.
    """

    words: str
    name: str
    read: Callable[[GraspContext], float]
    lengths: tuple[float, ...]
    is_by_batch: bool = False

    def place(self, grasps: Grasps) -> tuple[np.ndarray, np.ndarray]:
        """Which drift each grasp is on, and where, n each."""
        at = np.array([self.read(context) for context in grasps.contexts], dtype=float)
        return (find_batches(grasps) if self.is_by_batch else np.zeros(len(at), dtype=int)), at


@dataclass(frozen=True, eq=False)
class Drift:
    """A quantity that changes along a clock, at a fit.

    pattern: with its evidence; its columns are 0 for means of cells. share: of the force that one unit of the quantity
    changes. knots: of each drift.
    """

    quantity: str
    clock: str
    length: float
    pattern: Pattern
    share: float
    knots: Mapping[int, np.ndarray]

    @property
    def nats(self) -> float:
        """Log evidence over no change."""
        return self.pattern.nats

    @property
    def effect(self) -> str:
        """The effect of the catalogue that does this; empty if there is none."""
        return find_effect(self.quantity, self.clock)

    @property
    def words(self) -> str:
        """What changes, in words."""
        return f"repeats of the same grasps differ, {CHANGING[self.quantity].words} {CLOCKS[self.clock].words}"


def rank_drifts(fit: Fit) -> list[Drift]:
    """Drifts of every quantity along every clock, the one with the greatest evidence first; none without repeats.

    Where an effect of the fit changes a quantity, its law is never exact: what is left of it is fitted along, and is no
    drift of its own.
    """
    if fit.features.is_mean.all():
        return []
    found = {name: changing.field(fit) for name, changing in CHANGING.items()}
    fields = {name: field for name, field in found.items() if field.any()}
    own = {value.effect for value in fit.effects}
    places = [(name, clock) for name in fields for clock in CLOCKS]
    free = fit
    for name, clock in places:
        if find_effect(name, clock) in own:
            free = _weigh_drift(fit, name, clock, fields[name]).pattern.add_to(free)
    others = [place for place in places if find_effect(*place) not in own]
    drifts = [_weigh_drift(free, name, clock, fields[name]) for name, clock in others]
    return sorted(drifts, key=lambda drift: -drift.nats)


def average_evidence(drifts: Sequence[Drift]) -> float:
    """Log evidence that something changes from grasp to grasp, all drifts as probable as each other.

    The best of many drifts has some evidence by chance; their mean has not.
    """
    nats = np.array([drift.nats for drift in drifts])
    return float(np.logaddexp.reduce(nats) - np.log(len(nats))) if drifts else -np.inf


def compute_contrast_r2(fit: Fit, base: Score, other: Score) -> float:
    """Share of the squares of contrasts, for object classes left out, that the other explains. fit: of the base.

    Tools are measured one after the other: nothing is known of a drift at the grasps of a tool that is left out.
    """
    rows = ~fit.features.is_mean
    before, after = base.by_class[rows], other.by_class[rows]
    return 1.0 - float((after**2).sum() / max((before**2).sum(), 1e-12))


def share_evidence(drifts: Sequence[Drift], names: Collection[str], temperature: float) -> dict[str, float]:
    """Probability of each effect, and of "" for any other, if one of the drifts is there; likeliest first.

    names: effects that may be named. temperature: of evidence in nats.
    """
    nats = np.array([drift.nats for drift in drifts]) / temperature
    shares = np.exp(nats - nats.max())
    found: dict[str, float] = {}
    for drift, share in zip(drifts, shares / shares.sum(), strict=True):
        effect = drift.effect if drift.effect in names else ""
        found[effect] = found.get(effect, 0.0) + float(share)
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def find_strongest(drifts: Sequence[Drift], names: Collection[str]) -> dict[str, Drift]:
    """Of each effect that may be named the drift with the greatest evidence, the strongest effect first.

    drifts: the strongest first.
    """
    found: dict[str, Drift] = {}
    for drift in drifts:
        if drift.effect in names:
            found.setdefault(drift.effect, drift)
    return found


def draw_drift(fit: Fit, drift: Drift) -> LawCurve:
    """How the quantity changed since the first grasp, in the batch with most grasps, with its 90 % band."""
    changing, clock = CHANGING[drift.quantity], CLOCKS[drift.clock]
    group, at = clock.place(fit.features.surrogate.grasps)
    longest = int(np.argmax(np.bincount(group)))
    states = np.linspace(at[group == longest].min(), at[group == longest].max(), _N_STATES)
    freed = drift.pattern.add_to(fit)
    place = len(fit.columns) - fit.n_effect_columns
    place += sum(len(knots) for other, knots in drift.knots.items() if other < longest)
    basis = make_basis(drift.knots[longest], states, drift.length)
    basis = (basis - basis[:, :1]).T / drift.share
    columns = slice(place, place + basis.shape[1])
    median = basis @ solve_step(freed)[columns]
    half = _Z90 * np.sqrt(((basis @ freed.deflated_covariance[columns, columns]) * basis).sum(axis=1))
    median = changing.neutral + median
    return LawCurve(
        quantity=changing.name,
        state=f"{clock.name} before",
        at=tuple(states.tolist()),
        median=tuple(median.tolist()),
        low=tuple((median - half).tolist()),
        high=tuple((median + half).tolist()),
    )


def find_batches(grasps: Grasps) -> np.ndarray:
    """Batch of each grasp, n.

    Every batch counts its grasps anew, so a tool that begins before the last one ended is of another batch. Tools of a
    batch are measured one after the other, in the order of their numbers.
    """
    made = np.array([context.batch_grasps for context in grasps.contexts], dtype=int)
    batch, number, end = np.zeros(len(made), dtype=int), -1, np.inf
    for tool in np.unique(grasps.tool):
        own = grasps.tool == tool
        number += int(made[own].min() <= end)
        batch[own], end = number, made[own].max()
    return batch


def _weigh_drift(fit: Fit, quantity: str, clock: str, field: np.ndarray) -> Drift:
    """The drift with its evidence, of the likelier length."""
    grasps = fit.features.surrogate.grasps
    group, at = CLOCKS[clock].place(grasps)
    force = fit.predict_features()[:, :N_BINS]
    share = float(np.sqrt((field[:, :N_BINS] ** 2).mean() / max(float((force**2).mean()), 1e-12)))
    found = []
    for length in CLOCKS[clock].lengths:
        bases, knots = [], {}
        for one in np.unique(group):
            own = group == one
            knots[int(one)] = place_knots(at[own], length)
            bases.append(make_basis(knots[int(one)], at, length) * own)
        columns = fit.features.whiten(np.concatenate(bases)[:, :, None] * field / max(share, 1e-12)) * fit.weight
        columns[:, fit.features.is_mean] = 0.0
        words = CHANGING[quantity].words, CLOCKS[clock].words
        found.append(Drift(quantity, clock, length, weigh(fit, *words, columns), share, knots))
    return max(found, key=lambda drift: drift.nats)


def place_knots(at: np.ndarray, length: float) -> np.ndarray:
    """Knots of a drift of this length between grasps at places (n)."""
    n = int(np.ceil(np.ptp(at) / (_SPACING * length))) + 1
    return np.linspace(at.min(), at.max(), min(max(n, 2), _MOST_KNOTS))


def make_basis(knots: np.ndarray, at: np.ndarray, length: float) -> np.ndarray:
    """What each weight of unit variance adds to a drift at places (n), k x n."""
    length = max(length, _SPACING * float(knots[1] - knots[0]))

    def kernel(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        away = np.sqrt(3.0) * np.abs(first[:, None] - second) / length
        return np.asarray((1.0 + away) * np.exp(-away))

    root = np.linalg.cholesky(kernel(knots, knots) + _JITTER * np.eye(len(knots)))
    return np.asarray(np.linalg.solve(root, kernel(knots, at)))


def _by_theta(place: int) -> Field:
    """What a quantity of theta changes, relative."""

    def read(fit: Fit) -> np.ndarray:
        factor = np.ones(3)
        factor[place] -= _STEP
        less = fit.features.surrogate.predict_features(fit.theta * factor, fit.effects, fit.tool_factor)
        return np.asarray((fit.predict_features() - less) / _STEP)

    return read


def _by_moved(fit: Fit, change_n: np.ndarray) -> np.ndarray:
    """What a change of step means per mm (m x 120), at the bank's modulus, changes in features."""
    surrogate = fit.features.surrogate
    moved_n = _STEP * with_own_lead(change_n)
    known_n = 0.0 if surrogate.moved_n is None else surrogate.moved_n
    moved = replace(surrogate, moved_n=known_n + moved_n)
    return np.asarray(
        (moved.predict_features(fit.theta, fit.effects, fit.tool_factor) - fit.predict_features()) / _STEP
    )


def _close_less(fit: Fit) -> np.ndarray:
    """Jaws that stop early: each by half of what their gap is wider."""
    surrogate = fit.features.surrogate
    change_n = surrogate.wider_n[surrogate.grasps.tool, surrogate.column, 1] / (0.5 * surrogate.wider_mm[1])
    return _by_moved(fit, np.nan_to_num(change_n))


def _raise_objects(fit: Fit) -> np.ndarray:
    surrogate = fit.features.surrogate
    lower_n, higher_n = np.moveaxis(surrogate.bank.placed_steps_n[surrogate.grasps.tool, surrogate.column], 1, 0)
    return _by_moved(fit, np.nan_to_num((higher_n - lower_n) / (DEEPER_MM[1] - DEEPER_MM[0])))


def _shift_zero(fit: Fit) -> np.ndarray:
    return np.broadcast_to(OF_OFFSET, fit.modelled.shape)


CHANGING: Mapping[str, Changing] = {
    "closing": Changing("as if the jaws closed less or more far", "how far a jaw stays back, mm", 0.0, _close_less),
    "modulus": Changing("as if the fingers grew softer or stiffer", "modulus over that at first", 1.0, _by_theta(0)),
    "friction": Changing("as if friction changed", "friction over that at first", 1.0, _by_theta(1)),
    "zero": Changing("as if the zero of the load cell moved", "zero of the load cell, N", 0.0, _shift_zero),
    "height": Changing(
        "as if the objects stood higher or lower", "how much higher the objects stand, mm", 0.0, _raise_objects
    ),
}
CLOCKS: Mapping[str, Clock] = {
    "batch": Clock("over the batch", "grasps of the batch", lambda c: c.batch_grasps, LENGTHS, is_by_batch=True),
    "tool": Clock("from grasp to grasp of a tool", "grasps of the tool", lambda c: c.tool_grasps, LENGTHS),
    "repeat": Clock("from repeat to repeat", "repeats", lambda c: c.repeat, (_REPEATS_LENGTH,)),
}


def find_effect(quantity: str, clock: str) -> str:
    """The effect of the catalogue by which a quantity changes along a clock; empty if there is none."""
    drifts = ((name, spec.drift) for name, spec in CATALOGUE.items() if spec.drift is not None)
    return next((name for name, drift in drifts if drift.quantity == quantity and clock in drift.clocks), "")
