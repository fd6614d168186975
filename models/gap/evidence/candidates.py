"""What may be missing, each candidate with its evidence: effects, patterns without a name, and drifts.

An effect is tried at its secants: what it changes at single amplitudes, scaled by a factor of about 1, its law free. A
pattern is a smooth force or factor over the lift that all grasps, an object, or a tool have for themselves, or a
friction of their own. A drift is a quantity that changes from grasp to grasp along a clock. The evidence is the log of
how much more probable the data are than with nothing missing, in nats; sizes and laws are integrated out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.evidence.drifts import CLOCKS, QUANTITIES, describe_drift, find_effect, make_basis, place_knots
from fast.models.gap.evidence.facts import weigh_facts
from fast.models.gap.evidence.laws import find_level, has_memory, list_law_changes, list_secants, scale_value
from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.evidence.reading import OF_BINS, OF_CONTRASTS, SMOOTH, compute_rms
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import STEP_MM

SCALES = np.array([0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.3, 1.7])  # of a secant's amplitude, as probable as each other
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of patterns and drifts, of the force
ALIKE = 0.9  # correlation of an object's or a tool's coefficients along the lift, where they are alike
QUANTITY = "quantity"  # kind of a pattern that is as if a quantity were otherwise than told
STATIC = ("closing", "height", "delay")  # quantities of a pattern that repeats share
_FRICTION = "a factor on friction"
_LEAST_FIELD = 1e-9  # of the force: below it a quantity changes nothing
STIFFER = (1.5, 2.0, 3.0)  # than fitted, of a finger whose force something keeps from growing
_N_FREED = 2  # secants of an effect whose law is freed: those that fit best


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that may be missing, with its evidence."""

    name: str
    """Of an effect, or a pattern or drift in words."""
    kind: str
    """`effect`, `drift`, `quantity`, or whose a pattern is: `common`, `by object` or `by tool`."""
    nats: float
    """Evidence over nothing."""
    effect: str = ""
    """Of the catalogue, also of a drift that one of them makes; empty without one."""
    value: EffectValue | None = None
    """The effect at its likeliest."""
    change_n: np.ndarray | None = None
    """c x b, what it then changes in the means, in N; None for a drift."""
    visible: float | None = None
    """Of an effect, the share of its change that theta, prints and variants cannot make."""
    is_sure: bool = False
    """Whether solvers of the same physics do not differ by such a thing, so that less evidence is an alarm."""
    starts: tuple[tuple[EffectValue, float], ...] = ()
    """Values of the effect from which it is fitted, and how many times stiffer than fitted the finger is then."""


def weigh_candidates(fit: EvidenceFit, names: Sequence[str]) -> list[Candidate]:
    """Weigh effects of these names, patterns and drifts by their evidence, the most first."""
    found = [*weigh_effects(fit, names), *weigh_patterns(fit), *weigh_drifts(fit)]
    return sorted(found, key=lambda one: -one.nats)


def weigh_effects(fit: EvidenceFit, names: Sequence[str]) -> list[Candidate]:
    """Weigh the effects of these names, each alone."""
    return [_weigh_effect(fit, name) for name in names]


def _weigh_effect(fit: EvidenceFit, name: str) -> Candidate:
    values = list_secants(name)
    means_n, contrasts_n = predict_changes(fit, values)
    white = fit.whiten(means_n, contrasts_n)
    products, along = fit.multiply(white)
    gains = _weigh_facts(fit, values)
    plain = along[:, None] * SCALES - 0.5 * np.diag(products)[:, None] * SCALES**2 + gains
    places, tried = np.argsort(-plain.max(axis=1))[:_N_FREED].tolist(), []
    for place in places:
        law_n = list_law_changes(fit.problem.tool, len(fit.moduli), fit.force_n, means_n[place])
        law = fit.whiten(law_n)
        freed, pulls = fit.multiply(np.concatenate([white[place : place + 1], law]))
        for scale, gain in zip(SCALES, gains[place], strict=True):
            pull = scale * (pulls[1:] - scale * freed[1:, 0])
            nats = gain + scale * pulls[0] - 0.5 * scale**2 * freed[0, 0]
            tried.append((nats + _integrate(scale**2 * freed[1:, 1:], pull), place, scale))
    all_nats = np.array([nats for nats, _, _ in tried])
    _, place, scale = tried[int(np.argmax(all_nats))]
    whole = float((white[place] ** 2 * fit.value_weights).sum())
    value = scale_value(values[place], float(scale))
    found = Candidate(
        name=name,
        kind="effect",
        nats=float(np.logaddexp.reduce(all_nats) - np.log(len(tried) * len(values) / len(places))),
        effect=name,
        value=value,
        change_n=scale * means_n[place],
        visible=_see(products[place, place], whole),
        starts=((value, 1.0),),
    )
    if not CATALOGUE[name].softens:
        return found
    stiffer = _weigh_stiffer(fit, values)
    return replace(max(found, stiffer, key=lambda one: one.nats), starts=(*found.starts, *stiffer.starts))


def _weigh_stiffer(fit: EvidenceFit, values: Sequence[EffectValue]) -> Candidate:
    """Weigh an effect together with a stiffer finger: what keeps force from growing makes a fit without it soft."""
    problem, tried = fit.problem, [(value, by) for value in values for by in STIFFER]
    means_n = [
        problem.predict_cells(fit.theta * np.array([by, 1.0, 1.0]), [*fit.effects, value]) @ OF_BINS.T
        for value, by in tried
    ]
    changes_n = fit.factor[:, None] * np.array(means_n) - fit.force_n
    white = fit.whiten(changes_n)
    products, along = fit.multiply(white)
    nats = along - 0.5 * np.diag(products)
    of_values = nats.reshape(len(values), len(STIFFER))
    most = np.argsort(-of_values.max(axis=1))[:_N_FREED].tolist()
    places = [at * len(STIFFER) + int(np.argmax(of_values[at])) for at in most]
    best = places[0]
    return Candidate(
        name=values[0].effect,
        kind="effect",
        nats=float(np.logaddexp.reduce(nats) - np.log(len(nats))),
        effect=values[0].effect,
        value=tried[best][0],
        change_n=changes_n[best],
        visible=_see(products[best, best], float((white[best] ** 2 * fit.value_weights).sum())),
        starts=tuple(tried[place] for place in places),
    )


def _see(product: float, whole: float) -> float:
    """Return the share of a change that is left of its whole square, what is free integrated out."""
    return float(np.sqrt(product / max(whole, 1e-12)))


def _weigh_facts(fit: EvidenceFit, values: Sequence[EffectValue]) -> np.ndarray:
    """Compute how much more probable facts are with an effect at s values times `SCALES` than without, s x 8, nats."""
    facts = [one for one in fit.problem.facts if one.effect == values[0].effect]
    gains = np.zeros((len(values), len(SCALES)))
    if facts:
        scaled = [[scale_value(value, float(scale)) for scale in SCALES] for value in values]
        gains += np.array([[weigh_facts(facts, [value]) for value in row] for row in scaled]) - weigh_facts(facts, ())
    return gains


def predict_changes(fit: EvidenceFit, values: Sequence[EffectValue]) -> tuple[np.ndarray, np.ndarray | None]:
    """Predict what an effect at s values changes in means (s x c x b), and contrasts (s x r x ...) if it has memory."""
    problem, reading, known = fit.problem, fit.problem.reading, fit.effects
    if not has_memory(values[0].effect):
        base_n = problem.predict_cells(fit.theta, known)
        found = [problem.predict_cells(fit.theta, [*known, value]) - base_n for value in values]
        return np.array([fit.factor[:, None] * (change_n @ OF_BINS.T) for change_n in found]), None
    base_n = problem.predict_steps(fit.theta, known)
    factor = np.exp(fit.moduli)[reading.grasps.tool][:, None]
    found = [factor * (problem.predict_steps(fit.theta, [*known, value]) - base_n) for value in values]
    return np.array([reading.average(one) for one in found]), np.array([reading.contrast(one) for one in found])


def weigh_patterns(fit: EvidenceFit) -> list[Candidate]:
    """Weigh smooth forces and factors over the lift, of all grasps, objects, and tools; friction of these two.

    By a force or factor of each object, solvers of the same physics differ: their contact and meshes do.
    """

    def weigh(name: str, kind: str, columns_n: np.ndarray, is_sure: bool) -> Candidate:
        nats, coefficients = _weigh_sizes(*fit.multiply(fit.whiten(columns_n)))
        change_n = np.tensordot(coefficients, columns_n, 1)
        return Candidate(name, kind, nats, change_n=change_n, is_sure=is_sure)

    problem, force_n = fit.problem, fit.force_n
    peak_n = float(np.median(np.abs(force_n).max(axis=1)))
    level = find_level(force_n)[:, None]
    alike = np.linalg.cholesky(ALIKE + (1.0 - ALIKE) * np.eye(len(SMOOTH)))
    factor_n = SMOOTH[:, None] * force_n
    constant_n = np.broadcast_to(SMOOTH[:, None] * peak_n, factor_n.shape)
    changes = {"a factor on the force": factor_n, "a force": constant_n}
    found = []
    for words, change_n in changes.items():
        found.append(weigh(f"{words} over the lift, in every grasp", "common", change_n, True))
        found.append(weigh(f"{words} over the lift, growing with the force", "common", change_n * level, True))
    changes["a steady factor on the force"] = np.tensordot(alike.T, factor_n, 1)
    slope_n = _find_friction_slope(fit) @ OF_BINS.T
    changes[_FRICTION] = (slope_n * compute_rms(force_n) / compute_rms(slope_n))[None]
    for kind, group, how in (
        ("by object", problem.obj, "another on each object"),
        ("by tool", problem.tool, "another for each tool"),
    ):
        for words, change_n in changes.items():
            rows_n = np.concatenate([change_n * (group == one)[:, None] for one in np.unique(group)])
            is_sure = kind == "by tool" or words == _FRICTION
            found.append(weigh(f"{words}, {how}", kind, rows_n, is_sure))
    return found


def weigh_quantities(fit: EvidenceFit) -> list[Candidate]:
    """Weigh patterns that are as if jaws, objects or clocks were otherwise than told, the same in all repeats."""
    problem, found = fit.problem, []
    one = np.zeros(len(problem.tool), dtype=int)
    groups = (
        (one, "in every grasp"),
        (problem.obj, "another on each object"),
        (problem.tool, "another for each tool"),
    )
    for quantity, field_n in _list_fields(fit):
        own_n = field_n @ OF_BINS.T
        share = compute_rms(own_n) / compute_rms(fit.force_n)
        if quantity not in STATIC or share < _LEAST_FIELD:
            continue
        for group, how in groups:
            columns_n = np.array([own_n * (group == one)[:, None] for one in np.unique(group)]) / share
            nats, coefficients = _weigh_sizes(*fit.multiply(fit.whiten(columns_n)))
            words = f"{QUANTITIES[quantity]}, {how}"
            found.append(Candidate(words, QUANTITY, nats, change_n=np.tensordot(coefficients, columns_n, 1)))
    return found


def _list_fields(fit: EvidenceFit) -> list[tuple[str, np.ndarray]]:
    """List what a unit more of each quantity changes in the cells, c x 120; of the closing at several strokes."""
    problem, theta, cells, known = fit.problem, fit.theta, fit.problem.of_cells, fit.effects
    force_n = fit.factor[:, None] * problem.predict_cells(theta, known)
    tool, column = cells.grasps.tool, cells.column
    closing_n = np.nan_to_num(cells.wider_n[tool, column, 1:]) * theta[0] / cells.centre.young_modulus_mpa
    return [
        ("modulus", force_n),
        ("friction", _find_friction_slope(fit)),
        ("zero", np.ones_like(force_n)),
        *(("closing", secant_n) for secant_n in np.moveaxis(closing_n, 1, 0)),
        ("height", -problem.errors.placed_n * problem.errors.grow(fit.force_n)[:, None]),
        ("delay", -np.gradient(force_n, STEP_MM, axis=1)),
    ]


def _find_friction_slope(fit: EvidenceFit) -> np.ndarray:
    """Compute what a share of friction changes in the cells, c x 120."""
    more_n, less_n = (
        fit.problem.predict_cells(fit.theta * np.array([1.0, by, 1.0]), fit.effects) for by in (1.01, 0.99)
    )
    return np.asarray(fit.factor[:, None] * (more_n - less_n) / 0.02)


def weigh_drifts(fit: EvidenceFit) -> list[Candidate]:
    """Weigh quantities that change from grasp to grasp, told by what repeats of the same cells differ by."""
    reading = fit.problem.reading
    if not len(reading.mix):
        return []
    fields = _list_fields(fit)
    size_n = compute_rms(fields[0][1])
    found = []
    for name, clock in CLOCKS.items():
        group, at = clock.place(reading.grasps)
        if np.ptp(at) == 0.0:
            continue
        for length in clock.lengths:
            bases = []
            for one in np.unique(group):
                knots = place_knots(at[group == one], length)
                bases.append(make_basis(knots, at, length) * (group == one))
            mixed = np.concatenate(bases) @ reading.mix.T
            for quantity, field_n in fields:
                own = field_n @ OF_CONTRASTS.T
                share = compute_rms(own) / size_n
                if share < _LEAST_FIELD:
                    continue
                columns = mixed[:, :, None] * own[reading.of_cell] / share
                nats, _ = _weigh_sizes(*fit.multiply_contrasts(fit.whiten_contrasts(columns)))
                words, effect = describe_drift(quantity, name), find_effect(quantity, name)
                found.append(Candidate(words, "drift", nats, effect=effect))
    return found


def _weigh_sizes(products: np.ndarray, along: np.ndarray) -> tuple[float, np.ndarray]:
    """Weigh columns whose coefficients have a common size: evidence averaged over `SIZES`, and the likeliest ones."""
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
