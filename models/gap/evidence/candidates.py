"""What may be missing, each candidate with its evidence: effects of the catalogue, and patterns without a name.

An effect is tried at its secants: what it changes at single amplitudes, scaled by a factor of about 1. Its law is never
exactly the catalogue's, so that change may be larger or smaller by some 30 % smoothly along the lift, with the force of
a grasp, and from print to print (`_free_law`). A pattern is a smooth force or factor over the lift that all grasps, an
object, or a tool have for themselves. The evidence is the log of how much more probable the data are than with nothing
missing, in nats, sizes and laws integrated out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.evidence.reading import MIDDLES_MM, N_BINS
from fast.models.gap.naming.rank_effects import list_secants
from fast.models.records import EffectValue
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import CATALOGUE

LAW_SD = 0.3  # of a law, relative, along the lift and with the force of a grasp; the same from print to print
_SCALES = np.array([0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.3, 1.7])  # of a secant's amplitude
_KNOTS_MM = np.array([0.0, 1.5, 5.0, 12.0, 25.0, 45.0])
_SIZES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of patterns, of the force
_N_FREED = 2  # secants of an effect whose law is freed


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that may be missing. name: of an effect, or of a pattern. nats: its evidence over nothing. value: the
    effect as it is likeliest. size_n: root mean square of what it changes, N. z: how many standard deviations its best
    amplitude is from nothing, its law as in the catalogue.
    """

    name: str
    kind: str
    nats: float
    value: EffectValue | None = None
    size_n: float = 0.0
    z: float = 0.0


def list_names(surrogate: Surrogate, in_model: Sequence[EffectValue]) -> list[str]:
    known = {value.effect for value in in_model}
    return [name for name in surrogate.names if name not in known]


def weigh_effects(fit: EvidenceFit, names: Sequence[str]) -> list[Candidate]:
    """Effects with their evidence, the most first."""
    problem = fit.problem
    base, first = problem.predict_steps(fit.theta), problem.first
    base_first = first.predict_steps(fit.theta, problem.in_model)
    factor, grasp_factor = np.exp(fit.moduli)[problem.tool][:, None], np.exp(fit.moduli)[problem.reading.grasps.tool][:, None]
    found = []
    for name in names:
        has_memory = CATALOGUE[name].kind.in_grasp is not Effect.in_grasp
        values = list_secants(name)
        if has_memory:
            changes = [grasp_factor * (problem.predict_steps(fit.theta, [value]) - base) for value in values]
            means = np.array([problem.reading.average(change) for change in changes])
            contrasts = fit.whiten_contrasts(np.array([problem.reading.contrast(change) for change in changes]))
        else:
            changes = [factor * (first.predict_steps(fit.theta, [*problem.in_model, value]) - base_first) for value in values]
            means = np.array([change @ OFB.T for change in changes])
            contrasts = None
        found.append(_weigh(fit, name, values, means, contrasts))
    return sorted(found, key=lambda one: -one.nats)


from fast.models.gap.evidence.reading import OF_BINS as OFB


def _weigh(fit, name, values, means, contrasts) -> Candidate:
    white = fit.whiten(means)
    products, along = fit.gram(white, contrasts)
    own = np.maximum(np.diag(products), 1e-12)
    plain = along[:, None] * _SCALES - 0.5 * own[:, None] * _SCALES**2
    z = float((along / np.sqrt(own)).max())
    order = np.argsort(-plain.max(axis=1))[:_N_FREED]
    nats, best = [], None
    for place in order:
        freed = _free_law(fit, means[place])
        wide = np.concatenate([white[place : place + 1], fit.whiten(freed)])
        # the law of a memory is free in the means alone; of contrasts the size decides
        c = None if contrasts is None else np.concatenate([contrasts[place : place + 1], np.zeros((len(freed), contrasts.shape[1]))])
        g, b = fit.gram(wide, c)
        for scale in _SCALES:
            v = scale * (b[1:] - scale * g[1:, 0])
            m = np.eye(len(v)) + scale**2 * g[1:, 1:]
            value = scale * b[0] - 0.5 * scale**2 * g[0, 0] + 0.5 * v @ np.linalg.solve(m, v) - 0.5 * np.linalg.slogdet(m)[1]
            nats.append(value)
            if best is None or value > best[0]:
                best = value, place, scale
    place, scale = best[1:]
    prior = np.log(len(_SCALES) * len(order))
    total = float(np.logaddexp.reduce(nats) - prior)
    size = scale * float(np.sqrt((means[place] ** 2).mean()))
    return Candidate(name, "effect", total, values[place], size, z)


def _free_law(fit: EvidenceFit, change: np.ndarray) -> np.ndarray:
    """Changes (k x c x b) by which the law of an effect may differ, prior standard deviation 1."""
    place = np.log1p(MIDDLES_MM)
    knots = np.linspace(0, place.max(), 5)
    kernel = np.exp(-0.5 * ((knots[:, None] - knots) / (place.max() / 3)) ** 2) + 1e-6 * np.eye(5)
    along = np.linalg.solve(np.linalg.cholesky(kernel), np.exp(-0.5 * ((knots[:, None] - place) / (place.max() / 3)) ** 2))
    level = np.log(np.maximum(np.sqrt((fit.force_n**2).mean(axis=1)), 1e-3))
    level = (level - level.mean()) / max(level.std(), 1e-9)
    tools = (fit.problem.tool == np.arange(len(fit.moduli))[:, None])[:, :, None]
    parts = [along[:, None, :] * change, np.stack([level, 0.7 * level**2])[:, :, None] * change, tools * change]
    return LAW_SD * np.concatenate(parts)


def weigh_patterns(fit: EvidenceFit) -> list[Candidate]:
    """Patterns without a name with their evidence, the most first."""
    problem = fit.problem
    hats = np.array([np.interp(MIDDLES_MM, _KNOTS_MM, row) for row in np.eye(len(_KNOTS_MM))])
    force, peak = fit.force_n, float(np.median(np.abs(fit.force_n).max(axis=1)))
    level = np.sqrt((force**2).mean(axis=1))
    level = (level - level.mean()) / max(level.std(), 1e-9)
    factor = hats[:, None] * force
    constant = np.broadcast_to(hats[:, None] * peak, factor.shape)
    alike = np.linalg.cholesky(0.9 + 0.1 * np.eye(len(hats)))
    found = [
        _weigh_pattern(fit, "a force in every grasp", "common", constant),
        _weigh_pattern(fit, "a factor in every grasp", "common", factor),
        _weigh_pattern(fit, "a force that grows with the force", "common", constant * level[:, None]),
        _weigh_pattern(fit, "a factor that grows with the force", "common", factor * level[:, None]),
    ]
    for kind, group in (("by object", problem.obj), ("by tool", problem.tool)):
        for words, mixed in (("a factor", factor), ("a factor alike over the lift", np.tensordot(alike.T, factor, 1)), ("a force", constant)):
            rows = np.concatenate([mixed * (group == one)[:, None] for one in np.unique(group)])
            found.append(_weigh_pattern(fit, f"{words} {kind}", kind, rows))
    return sorted(found, key=lambda one: -one.nats)


def _weigh_pattern(fit, name, kind, columns) -> Candidate:
    g, b = fit.gram(fit.whiten(columns))
    values, vectors = np.linalg.eigh(g)
    inner = vectors.T @ b
    nats = [0.5 * (s**2 * inner**2 / (1 + s**2 * values)).sum() - 0.5 * np.log1p(s**2 * np.maximum(values, 0)).sum() for s in _SIZES]
    s = _SIZES[int(np.argmax(nats))]
    x = vectors @ (s**2 * inner / (1 + s**2 * values))
    size = float(np.sqrt((np.tensordot(x, columns, 1) ** 2).mean()))
    return Candidate(name, kind, float(np.logaddexp.reduce(nats) - np.log(len(_SIZES))), None, size)
