"""What may be missing, each candidate with its evidence: effects, patterns without a name, and drifts.

An effect is tried at its secants: what it changes at single amplitudes, scaled by a factor of about 1. Its law is never
exactly the catalogue's, so that change may be larger or smaller by some 30 % smoothly along the lift, with the force of
a grasp, and from print to print. A pattern is a smooth force or factor over the lift that all grasps, an object, or a
tool have for themselves. A drift is a quantity that changes from grasp to grasp along a clock. The evidence is the log
of how much more probable the data are than with nothing missing, in nats; sizes and laws are integrated out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.evidence.reading import MIDDLES_MM, OF_BINS, OF_CONTRASTS, SMOOTH, compute_rms
from fast.models.gap.fit.fit import axes_of
from fast.models.gap.fit.law_freedom import LAW_SD
from fast.models.gap.naming.drifts import CLOCKS, find_effect, make_basis, place_knots
from fast.models.gap.naming.rank_effects import list_secants
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import STEP_MM

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
    makes; empty without one. value: the effect at its likeliest. change_n: c x b, what it then changes in the means, in
    N; None for a drift.
    """

    name: str
    kind: str
    nats: float
    effect: str = ""
    value: EffectValue | None = None
    change_n: np.ndarray | None = None


def weigh_candidates(fit: EvidenceFit, names: Sequence[str]) -> list[Candidate]:
    """Effects of these names, patterns and drifts with their evidence, the most first."""
    found = [*(_weigh_effect(fit, name) for name in names), *_weigh_patterns(fit), *_weigh_drifts(fit)]
    return sorted(found, key=lambda one: -one.nats)


def scale_value(value: EffectValue, scale: float) -> EffectValue:
    """An effect with its amplitudes scaled on their axes, from neutral; what shapes it stays."""
    found = CATALOGUE[value.effect].neutral.parameters | dict(value.parameters)
    for spec, axis in zip(CATALOGUE[value.effect].parameters, axes_of(value.effect), strict=True):
        if spec.neutral != spec.prior_median:
            neutral = axis.inner(spec.neutral)
            found[spec.name] = axis.value(neutral + scale * (axis.inner(found[spec.name]) - neutral))
    return EffectValue(effect=value.effect, parameters=found)


def _weigh_effect(fit: EvidenceFit, name: str) -> Candidate:
    values = list_secants(name)
    means_n, contrasts_n = _predict_changes(fit, values)
    white = fit.whiten(means_n, contrasts_n)
    products, along = fit.multiply(white)
    plain = (along[:, None] * SCALES - 0.5 * np.diag(products)[:, None] * SCALES**2).max(axis=1)
    places, tried = np.argsort(-plain)[:_N_FREED].tolist(), []
    for place in places:
        law = fit.whiten(_list_law_changes(fit, means_n[place]))
        products, along = fit.multiply(np.concatenate([white[place : place + 1], law]))
        for scale in SCALES:
            pull = scale * (along[1:] - scale * products[1:, 0])
            nats = scale * along[0] - 0.5 * scale**2 * products[0, 0]
            tried.append((nats + _integrate(scale**2 * products[1:, 1:], pull), place, scale))
    all_nats = np.array([nats for nats, _, _ in tried])
    _, place, scale = tried[int(np.argmax(all_nats))]
    return Candidate(
        name=name,
        kind="effect",
        nats=float(np.logaddexp.reduce(all_nats) - np.log(len(tried) * len(values) / len(places))),
        effect=name,
        value=scale_value(values[place], float(scale)),
        change_n=scale * means_n[place],
    )


def _list_law_changes(fit: EvidenceFit, change_n: np.ndarray) -> np.ndarray:
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


def _predict_changes(fit: EvidenceFit, values: Sequence[EffectValue]) -> tuple[np.ndarray, np.ndarray | None]:
    """What an effect at s values changes in means (s x c x b), and in contrasts (s x r x ...) if it has a memory."""
    problem, reading = fit.problem, fit.problem.reading
    if not CATALOGUE[values[0].effect].kind.overrides("in_grasp"):
        base_n = problem.predict_cells(fit.theta)
        found = [problem.predict_cells(fit.theta, [value]) - base_n for value in values]
        return np.array([fit.factor[:, None] * (change_n @ OF_BINS.T) for change_n in found]), None
    base_n = problem.predict_steps(fit.theta)
    factor = np.exp(fit.moduli)[reading.grasps.tool][:, None]
    found = [factor * (problem.predict_steps(fit.theta, [value]) - base_n) for value in values]
    return np.array([reading.average(one) for one in found]), np.array([reading.contrast(one) for one in found])


def _weigh_patterns(fit: EvidenceFit) -> list[Candidate]:
    def weigh(name: str, kind: str, columns_n: np.ndarray) -> Candidate:
        nats, coefficients = _weigh_sizes(*fit.multiply(fit.whiten(columns_n)))
        return Candidate(name, kind, nats, change_n=np.tensordot(coefficients, columns_n, 1))

    problem, force_n = fit.problem, fit.force_n
    peak_n = float(np.median(np.abs(force_n).max(axis=1)))
    level = _find_level(force_n)[:, None]
    alike = np.linalg.cholesky(ALIKE + (1.0 - ALIKE) * np.eye(len(SMOOTH)))
    factor_n = SMOOTH[:, None] * force_n
    constant_n = np.broadcast_to(SMOOTH[:, None] * peak_n, factor_n.shape)
    changes = {"a factor on the force": factor_n, "a force": constant_n}
    found = []
    for words, change_n in changes.items():
        found.append(weigh(f"{words} over the lift, in every grasp", "common", change_n))
        found.append(weigh(f"{words} over the lift, growing with the force of the grasp", "common", change_n * level))
    changes["a factor on the force, much the same all along the lift"] = np.tensordot(alike.T, factor_n, 1)
    for kind, group, how in (
        ("by object", problem.obj, "another on each object"),
        ("by tool", problem.tool, "another for each tool"),
    ):
        for words, change_n in changes.items():
            rows_n = np.concatenate([change_n * (group == one)[:, None] for one in np.unique(group)])
            found.append(weigh(f"{words}, {how}", kind, rows_n))
    return found


def _weigh_drifts(fit: EvidenceFit) -> list[Candidate]:
    """Quantities that change from grasp to grasp, told by what repeats of the same cells differ by."""
    problem, reading, errors = fit.problem, fit.problem.reading, fit.problem.errors
    if not len(reading.mix):
        return []
    theta, cells = fit.theta, problem.of_cells
    force_n = fit.factor[:, None] * problem.predict_cells(theta)
    more_n, less_n = (problem.predict_cells(theta * np.array([1.0, by, 1.0])) for by in (1.01, 0.99))
    grows = errors.grow(fit.force_n)[:, None]
    tool, column = cells.grasps.tool, cells.column
    closing_n = np.nan_to_num(cells.wider_n[tool, column, 1:]) * theta[0] / cells.centre.young_modulus_mpa
    size_n = compute_rms(force_n)
    fields = [
        ("modulus", force_n),
        ("friction", fit.factor[:, None] * (more_n - less_n) / 0.02),
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
                share = compute_rms(own) / size_n
                if share < 1e-9:
                    continue
                columns = mixed[:, :, None] * own[reading.of_cell] / share
                nats, _ = _weigh_sizes(*fit.multiply_contrasts(fit.whiten_contrasts(columns)))
                effect = find_effect(quantity, clock)
                found.append(Candidate(f"{quantity} {clock}", "drift", nats, effect=effect))
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
