"""What may be missing, each candidate with its evidence: effects, patterns without a name, and drifts.

An effect is tried at its secants: what it changes at single amplitudes, scaled by a factor of about 1. Its law is never
exactly the catalogue's, so that change may be larger or smaller by some 30 % smoothly along the lift, with the force of
a grasp, and from print to print (`free_law`). A pattern is a smooth force or factor over the lift that all grasps, an
object, or a tool have for themselves. A drift is a quantity that changes from grasp to grasp along a clock. The
evidence is the log of how much more probable the data are than with nothing missing, in nats; sizes and laws are
integrated out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.evidence.reading import MIDDLES_MM, OF_BINS, OF_CONTRASTS, SMOOTH
from fast.models.gap.fit.fit import axes_of
from fast.models.gap.naming.drifts import CLOCKS, find_effect, make_basis, place_knots
from fast.models.gap.naming.rank_effects import list_secants
from fast.models.records import EffectValue
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import STEP_MM

LAW_SD = 0.3  # of a law, relative, along the lift and with the force of a grasp; the same from print to print
SCALES = np.array([0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.3, 1.7])  # of a secant's amplitude, as probable as each other
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of patterns and drifts, of the force
ALIKE = 0.9  # correlation of an object's or a tool's coefficients along the lift, where they are alike
_N_FREED = 2  # secants of an effect whose law is freed: those that fit best
_N_KNOTS = 5
_LENGTHS = {"batch": (30.0, 100.0, 300.0), "tool": (10.0, 30.0), "repeat": (1.0,)}  # of drifts, in grasps


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that may be missing, and its evidence over nothing in nats.

    name: of an effect, or a pattern or drift in words. effect: of the catalogue, also of a drift that one of them
    makes; empty without one. value: the effect at its likeliest, a scaled secant of this place. size_n: root mean
    square of what it changes in the means, N. z: standard deviations of its best amplitude from nothing, with the
    catalogue's law. change_n: c x b, at its likeliest, in N; None for a drift.
    """

    name: str
    kind: str
    nats: float
    effect: str = ""
    value: EffectValue | None = None
    place: int = 0
    size_n: float = 0.0
    z: float = 0.0
    change_n: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class EffectDirections:
    """What an effect changes at its secants (s): values, means_n (s x c x b), and white (s x d) as it is weighed."""

    name: str
    values: Sequence[EffectValue]
    means_n: np.ndarray
    white: np.ndarray

    @staticmethod
    def of(fit: EvidenceFit, name: str) -> "EffectDirections":
        """The directions of an effect at a fit."""
        values = list_secants(name)
        means_n, contrasts_n = predict_changes(fit, values)
        return EffectDirections(name, values, means_n, fit.whiten(means_n, contrasts_n))

    def free_law(self, fit: EvidenceFit, place: int) -> np.ndarray:
        """Directions (k x d) by which a secant and its law may differ, the secant first."""
        return np.concatenate([self.white[place : place + 1], fit.whiten(free_law(fit, self.means_n[place]))])

    def weigh(self, fit: EvidenceFit) -> Candidate:
        """The effect with its evidence."""
        products, along = fit.multiply(self.white)
        own = np.maximum(np.diag(products), 1e-12)
        plain = (along[:, None] * SCALES - 0.5 * own[:, None] * SCALES**2).max(axis=1)
        places, tried = np.argsort(-plain)[:_N_FREED], []
        for place in places.tolist():
            products, along_law = fit.multiply(self.free_law(fit, place))
            for scale in SCALES:
                pull = scale * (along_law[1:] - scale * products[1:, 0])
                nats = scale * along_law[0] - 0.5 * scale**2 * products[0, 0]
                tried.append((nats + _integrate(scale**2 * products[1:, 1:], pull), place, scale))
        all_nats = np.array([one[0] for one in tried])
        _, place, scale = tried[int(np.argmax(all_nats))]
        change_n = scale * self.means_n[place]
        return Candidate(
            name=self.name,
            kind="effect",
            nats=float(np.logaddexp.reduce(all_nats) - np.log(len(tried) * len(self.values) / len(places))),
            effect=self.name,
            value=scale_value(self.values[place], float(scale)),
            place=place,
            size_n=float(np.sqrt((change_n**2).mean())),
            z=float((along / np.sqrt(own)).max()),
            change_n=change_n,
        )


@dataclass(frozen=True, eq=False)
class PatternDirections:
    """Columns of a pattern: columns_n (k x c x b), and white (k x d) as they are weighed."""

    name: str
    kind: str
    columns_n: np.ndarray
    white: np.ndarray

    def weigh(self, fit: EvidenceFit) -> Candidate:
        """The pattern with its evidence."""
        nats, coefficients = _weigh_sizes(*fit.multiply(self.white))
        change_n = np.tensordot(coefficients, self.columns_n, 1)
        size_n = float(np.sqrt((change_n**2).mean()))
        return Candidate(self.name, self.kind, nats, size_n=size_n, change_n=change_n)


@dataclass(frozen=True, eq=False)
class DriftDirections:
    """Columns of a drift: white, k x (r ...), of contrasts alone."""

    name: str
    effect: str
    white: np.ndarray

    def weigh(self, fit: EvidenceFit) -> Candidate:
        """The drift with its evidence."""
        nats, _ = _weigh_sizes(*fit.multiply_contrasts(self.white))
        return Candidate(self.name, "drift", nats, effect=self.effect)


Directions = EffectDirections | PatternDirections | DriftDirections


def list_directions(fit: EvidenceFit, names: Sequence[str]) -> list[Directions]:
    """All that is tried on a fit: effects of these names, patterns and drifts."""
    return [*(EffectDirections.of(fit, name) for name in names), *_list_patterns(fit), *_list_drifts(fit)]


def weigh_all(fit: EvidenceFit, directions: Sequence[Directions]) -> list[Candidate]:
    """Candidates with their evidence, the most first."""
    return sorted((one.weigh(fit) for one in directions), key=lambda one: -one.nats)


def weigh_candidates(fit: EvidenceFit, names: Sequence[str]) -> list[Candidate]:
    """Effects of these names, patterns and drifts with their evidence, the most first."""
    return weigh_all(fit, list_directions(fit, names))


def scale_value(value: EffectValue, scale: float) -> EffectValue:
    """An effect with its amplitudes scaled on their axes, from neutral; what shapes it stays."""
    found = CATALOGUE[value.effect].neutral.parameters | dict(value.parameters)
    for spec, axis in zip(CATALOGUE[value.effect].parameters, axes_of(value.effect), strict=True):
        if spec.neutral != spec.prior_median:
            neutral = axis.inner(spec.neutral)
            found[spec.name] = axis.value(neutral + scale * (axis.inner(found[spec.name]) - neutral))
    return EffectValue(effect=value.effect, parameters=found)


def free_law(fit: EvidenceFit, change_n: np.ndarray) -> np.ndarray:
    """Changes (k x c x b) by which that of an effect (c x b) may differ, prior standard deviation 1."""
    place = np.log1p(MIDDLES_MM)
    knots = np.linspace(0.0, place.max(), _N_KNOTS)
    near = place.max() / 3.0

    def kernel(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * ((first[:, None] - second) / near) ** 2))

    along = np.linalg.solve(np.linalg.cholesky(kernel(knots, knots) + 1e-6 * np.eye(_N_KNOTS)), kernel(knots, place))
    level = _find_level(fit.force_n)
    tools = (fit.problem.tool == np.arange(len(fit.moduli))[:, None])[:, :, None]
    by_level = np.stack([level, 0.7 * level**2])[:, :, None]
    return np.asarray(LAW_SD * np.concatenate([along[:, None] * change_n, by_level * change_n, tools * change_n]))


def predict_changes(fit: EvidenceFit, values: Sequence[EffectValue]) -> tuple[np.ndarray, np.ndarray | None]:
    """What an effect at s values changes in means (s x c x b), and in contrasts (s x r x ...) if it has a memory."""
    problem = fit.problem
    if CATALOGUE[values[0].effect].kind.in_grasp is Effect.in_grasp:
        base_n = problem.of_cells.predict_steps(fit.theta, problem.in_model)
        found = [problem.of_cells.predict_steps(fit.theta, [*problem.in_model, value]) - base_n for value in values]
        return np.array([fit.factor[:, None] * (change_n @ OF_BINS.T) for change_n in found]), None
    base_n, reading = problem.predict_steps(fit.theta), problem.reading
    factor = np.exp(fit.moduli)[reading.grasps.tool][:, None]
    found = [factor * (problem.predict_steps(fit.theta, [value]) - base_n) for value in values]
    return np.array([reading.average(one) for one in found]), np.array([reading.contrast(one) for one in found])


def _list_patterns(fit: EvidenceFit) -> list[PatternDirections]:
    def pattern(name: str, kind: str, columns_n: np.ndarray) -> PatternDirections:
        return PatternDirections(name, kind, columns_n, fit.whiten(columns_n))

    problem, force_n = fit.problem, fit.force_n
    peak_n = float(np.median(np.abs(force_n).max(axis=1)))
    level = _find_level(force_n)[:, None]
    alike = np.linalg.cholesky(ALIKE + (1.0 - ALIKE) * np.eye(len(SMOOTH)))
    factor_n, constant_n = (
        SMOOTH[:, None] * force_n,
        np.broadcast_to(SMOOTH[:, None] * peak_n, (len(SMOOTH), *force_n.shape)),
    )
    changes = {"a factor on the force": factor_n, "a force": constant_n}
    found = []
    for words, change_n in changes.items():
        found.append(pattern(f"{words} over the lift, in every grasp", "common", change_n))
        found.append(pattern(f"{words} over the lift, growing with the force of the grasp", "common", change_n * level))
    changes["a factor on the force, much the same all along the lift"] = np.tensordot(alike.T, factor_n, 1)
    for kind, group, how in (
        ("by object", problem.obj, "another on each object"),
        ("by tool", problem.tool, "another for each tool"),
    ):
        for words, change_n in changes.items():
            rows_n = np.concatenate([change_n * (group == one)[:, None] for one in np.unique(group)])
            found.append(pattern(f"{words}, {how}", kind, rows_n))
    return found


def _list_drifts(fit: EvidenceFit) -> list[DriftDirections]:
    """Quantities that change from grasp to grasp, told by what repeats of the same cells differ by."""
    problem, reading, errors = fit.problem, fit.problem.reading, fit.problem.errors
    if not len(reading.mix):
        return []
    theta, cells = fit.theta, problem.of_cells
    force_n = fit.factor[:, None] * cells.predict_steps(theta)
    more, less = (cells.predict_steps(theta * np.array([1.0, by, 1.0])) for by in (1.01, 0.99))
    grows = errors.grow(fit.force_n)[:, None]
    tool, column = cells.grasps.tool, cells.column
    closing_n = np.nan_to_num(cells.wider_n[tool, column, 1:]) * theta[0] / cells.centre.young_modulus_mpa
    size = float(np.sqrt((force_n**2).mean()))
    fields = [
        ("modulus", force_n),
        ("friction", fit.factor[:, None] * (more - less) / 0.02),
        ("zero", np.ones_like(force_n)),
        *(("closing", secant_n) for secant_n in np.moveaxis(closing_n, 1, 0)),
        ("height", -errors.placed_n * grows),
        ("delay", -np.gradient(force_n, STEP_MM, axis=1)),
    ]
    found = []
    for clock, lengths in _LENGTHS.items():
        group, at = CLOCKS[clock].place(reading.grasps)
        if np.ptp(at) == 0.0:
            continue
        for length in lengths:
            bases = []
            for one in np.unique(group):
                knots = place_knots(at[group == one], length)
                bases.append(make_basis(knots, at, length) * (group == one))
            mixed = np.concatenate(bases) @ reading.mix.T
            for quantity, field_n in fields:
                own = field_n @ OF_CONTRASTS.T
                share = float(np.sqrt((own**2).mean())) / size
                if share < 1e-9:
                    continue
                columns = mixed[:, :, None] * own[reading.of_cell] / share
                name, effect = f"{quantity} {clock}", find_effect(quantity, clock)
                found.append(DriftDirections(name, effect, fit.whiten_contrasts(columns)))
    return found


def _weigh_sizes(products: np.ndarray, along: np.ndarray) -> tuple[float, np.ndarray]:
    """Evidence of columns whose coefficients have a common size, averaged over `SIZES`, and the likeliest ones."""
    values, vectors = np.linalg.eigh(products)
    values, inner = np.maximum(values, 0.0), vectors.T @ along
    nats = [0.5 * float((s**2 * inner**2 / (1.0 + s**2 * values) - np.log1p(s**2 * values)).sum()) for s in SIZES]
    best = SIZES[int(np.argmax(nats))] ** 2
    mean = float(np.logaddexp.reduce(nats) - np.log(len(SIZES)))
    return mean, np.asarray(vectors @ (best * inner / (1.0 + best * values)))


def _integrate(products: np.ndarray, along: np.ndarray) -> float:
    """Log evidence of columns with coefficients of unit variance over none."""
    root = np.linalg.cholesky(np.eye(len(products)) + products)
    inner = np.linalg.solve(root, along)
    return float(0.5 * inner @ inner - np.log(np.diag(root)).sum())


def _find_level(force_n: np.ndarray) -> np.ndarray:
    """Logarithm of the force of cells (c x b), mean 0 and standard deviation 1."""
    level = np.log(np.maximum(np.sqrt((force_n**2).mean(axis=1)), 1e-6))
    return np.asarray((level - level.mean()) / max(float(level.std()), 1e-9))
