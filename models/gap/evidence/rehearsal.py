"""Rehearsal: made-up worlds of the panel at hand, answered as the real one is, from which all lines are taken.

A world has the lab's own tools, objects, repeats, order and noise. A third hide nothing but another mesh, contact,
placement and prints; a third an effect of the catalogue, by its own law or by one that differs along the lift and from
print to print; a third a cause of no catalogue: a force or factor of all grasps, objects, tools or single cells, or a
drift. Sizes are drawn from a hundredth to a fifth of the force. Forces are the bank's, so that a world costs no
simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fast.models.gap.evidence.candidates import LAW_SD, Candidate, scale_value, weigh_candidates
from fast.models.gap.evidence.errors import PLACEMENT_SD_MM, TARE_SD_N, TOOL_SD
from fast.models.gap.evidence.likelihood import SHARED_SD, EvidenceFit, Problem, fit_evidence
from fast.models.gap.evidence.reading import KNOTS_MM, OF_BINS
from fast.models.gap.naming.rank_effects import list_secants
from fast.models.records import EffectValue, Record
from fast.models.traces.step_features import N_STEPS, STEP_MM

SMALLEST, LARGEST = 0.01, 0.2  # of the force: sizes of what is hidden
_SOLVER_SD = 0.4  # of ln of how many times larger than the bank's variants a solver's errors are
_OTHER_SOLVER = 0.3  # by how much another solver differs from cell to cell and along the lift, of what a variant changes
_MODULUS_SD = 0.25  # of ln E
_INNER = 0.1  # of the grid: thetas lie farther from its ends
_TRIES = 8

Group = str
NOTHING, LISTED, UNLISTED = "nothing", "listed", "unlisted"
_LIFT_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)


@dataclass(frozen=True, eq=False)
class World:
    """A made-up world. steps_n: n x 120. cause: an effect or a kind of unlisted cause, empty for nothing. size: root
    mean square of what it changes in means of cells, as a share of the force.
    """

    group: Group
    steps_n: np.ndarray
    cause: str = ""
    size: float = 0.0
    is_other_law: bool = False


class Rehearsed(Record):
    """What the likelihood said of a world: evidence of each candidate, and how much is left as a whole."""

    group: str
    cause: str
    size: float
    is_other_law: bool
    nats: dict[str, float]
    omnibus: float


def rehearse_world(problem: Problem, names: Sequence[str], seed: int, number: int) -> Rehearsed:
    """Make and answer a world; the same for a seed and a number."""
    world = make_world(problem, names, np.random.default_rng([seed, number]), number)
    fit = fit_evidence(problem.measured(world.steps_n))
    found = weigh_candidates(fit, names)
    return Rehearsed(
        group=world.group,
        cause=world.cause,
        size=world.size,
        is_other_law=world.is_other_law,
        nats=best_by_name(found),
        omnibus=fit.omnibus,
    )


def best_by_name(candidates: Sequence[Candidate]) -> dict[str, float]:
    """The largest evidence of each name; drifts of one quantity along one clock are one."""
    found: dict[str, float] = {}
    for one in candidates:
        found[one.name] = max(one.nats, found.get(one.name, -np.inf))
    return found


def make_world(problem: Problem, names: Sequence[str], rng: np.random.Generator, number: int) -> World:
    """The world of a number: nothing, an effect, or a cause of no catalogue in turn."""
    surrogate = problem.surrogate
    theta = _draw_theta(problem, rng)
    base_n = surrogate.predict_steps(theta)
    group = (NOTHING, LISTED, UNLISTED)[number % 3]
    cause, change_n, is_other = "", np.zeros_like(base_n), False
    size = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
    if group == LISTED:
        cause = names[(number // 3) % len(names)]
        is_other = bool(rng.uniform() < 0.5)
        change_n = _draw_effect(problem, theta, base_n, cause, size, rng)
        if is_other:
            change_n = change_n * _draw_law(problem, rng)
    elif group == UNLISTED:
        cause = _UNLISTED[(number // 3) % len(_UNLISTED)]
        change_n = _draw_unlisted(problem, theta, base_n, cause, rng)
        change_n = change_n * size * _rms(base_n) / max(_rms(change_n), 1e-9)
    steps_n = _measure(problem, base_n + change_n, base_n, rng)
    return World(group, steps_n, cause, _rms(change_n) / _rms(base_n), is_other)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def _draw_theta(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    bank = problem.surrogate.bank
    low, high = bank.grid.min(axis=0), bank.grid.max(axis=0)
    inside = rng.uniform(_INNER, 1.0 - _INNER, 2)
    modulus = bank.centre.young_modulus_mpa * np.exp(_MODULUS_SD * rng.standard_normal())
    return np.array([modulus, *(low + inside * (high - low))])


def _measure(problem: Problem, true_n: np.ndarray, base_n: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a lab would measure of true forces (n x 120), by a solver that is not the simulator."""
    reading, errors = problem.reading, problem.errors
    cells_n = base_n[reading.rows]
    grows = errors.grow(cells_n @ OF_BINS.T)[:, None]
    n_cells = reading.n_cells
    error_n = np.zeros_like(cells_n)
    solver = float(np.exp(_SOLVER_SD * rng.standard_normal()))
    for variant_n in np.moveaxis(errors.variants_n, 1, 0):
        differs = 1.0 + _OTHER_SOLVER * (rng.standard_normal((n_cells, 1)) + _draw_smooth(rng, n_cells))
        error_n += solver * rng.standard_normal() * variant_n * differs
    points = errors.missed_n[:, int(rng.integers(errors.missed_n.shape[1]))]
    error_n += solver * rng.standard_normal() * points
    error_n += PLACEMENT_SD_MM * rng.standard_normal((n_cells, 1)) * errors.placed_n
    heights = rng.standard_normal(len(reading.grasps.objects))[problem.obj][:, None]
    error_n += PLACEMENT_SD_MM * heights * errors.placed_n
    error_n = error_n * grows + SHARED_SD * _draw_smooth(rng, 1) * cells_n
    scatter = np.exp(
        TOOL_SD * rng.standard_normal(len(reading.grasps.tools))[reading.grasps.tool]
        + SCATTER.cell * rng.standard_normal(n_cells)[reading.cell]
        + SCATTER.repeat * rng.standard_normal(len(true_n))
    )
    noise = reading.grasps.noise
    root = np.linalg.cholesky(
        noise.step_covariance(N_STEPS, float(np.median(reading.grasps.lift_speed_mm_per_s))) + 1e-12 * np.eye(N_STEPS)
    )
    measured_n = (true_n + error_n[reading.cell]) * scatter[:, None]
    measured_n += rng.standard_normal(true_n.shape) @ root.T
    return np.asarray(measured_n + TARE_SD_N * rng.standard_normal((len(true_n), 1)))


from fast.models.gap.evidence.errors import Scatter

SCATTER = Scatter()


def _draw_smooth(rng: np.random.Generator, n: int) -> np.ndarray:
    """Smooth functions of the lift, n x 120, of unit variance at the knots."""
    knots = rng.standard_normal((n, len(KNOTS_MM)))
    return np.array([np.interp(_LIFT_MM, KNOTS_MM, row) for row in knots])


def _draw_effect(
    problem: Problem, theta: np.ndarray, base_n: np.ndarray, name: str, size: float, rng: np.random.Generator
) -> np.ndarray:
    """What an effect changes (n x 120) at an amplitude at which it changes about `size` of the force, or as near as it
    plausibly comes.
    """
    values = list_secants(name)
    value = values[int(rng.integers(len(values)))]
    scale, change_n = 1.0, np.zeros_like(base_n)
    for _ in range(3):
        change_n = problem.predict_steps(theta, [scale_value(value, scale)]) - base_n
        scale = float(np.clip(scale * size * _rms(base_n) / max(_rms(change_n), 1e-9), 0.05, 1.7))
    return problem.predict_steps(theta, [scale_value(value, scale)]) - base_n


def _draw_law(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """By what factor another law of an effect changes more, n x 120."""
    reading = problem.reading
    along = _draw_smooth(rng, 1)
    tools = rng.standard_normal(len(reading.grasps.tools))[reading.grasps.tool][:, None]
    return np.asarray(1.0 + LAW_SD * (along + tools))


_UNLISTED = (
    "a force in every grasp",
    "a factor that bends over the lift",
    "a factor of each object",
    "a force of each object",
    "a delay of each object",
    "a factor of each tool over the lift",
    "a force that grows with the force",
    "a zero that wanders",
    "objects that rise",
    "jaws that close less over the batch",
    "a factor of each cell",
    "a force of each cell",
)


def _draw_unlisted(
    problem: Problem, theta: np.ndarray, base_n: np.ndarray, cause: str, rng: np.random.Generator
) -> np.ndarray:
    """What a cause of no catalogue changes, n x 120, of any size."""
    reading = problem.reading
    grasps, cell = reading.grasps, reading.cell
    peak_n = float(np.median(np.abs(base_n).max(axis=1)))

    def per(group: np.ndarray, *, is_bent: bool) -> np.ndarray:
        n = int(group.max()) + 1
        level = rng.standard_normal((n, 1))
        return np.asarray((_draw_smooth(rng, n) if is_bent else level + 0.4 * _draw_smooth(rng, n))[group])

    clock = np.array([context.batch_grasps for context in grasps.contexts], dtype=float)
    rising = (1.0 - np.exp(-clock / max(float(clock.max()) * rng.uniform(0.15, 0.6), 1.0)))[:, None]
    errors = problem.errors
    if cause == "a force in every grasp":
        return np.asarray(peak_n * _draw_smooth(rng, 1) * np.ones_like(base_n))
    if cause == "a factor that bends over the lift":
        return np.asarray(base_n * _draw_smooth(rng, 1))
    if cause == "a factor of each object":
        return base_n * per(grasps.obj, is_bent=False)
    if cause == "a force of each object":
        return np.asarray(peak_n * per(grasps.obj, is_bent=False))
    if cause == "a delay of each object":
        return np.asarray(-np.gradient(base_n, STEP_MM, axis=1) * rng.standard_normal(len(grasps.objects))[grasps.obj][:, None])
    if cause == "a factor of each tool over the lift":
        return base_n * per(grasps.tool, is_bent=True)
    if cause == "a force that grows with the force":
        level = np.sqrt((base_n**2).mean(axis=1))[:, None]
        return np.asarray(level * (level / level.mean()) ** rng.uniform(0.5, 1.5) * _draw_smooth(rng, 1))
    if cause == "a zero that wanders":
        return np.asarray(np.ones_like(base_n) * rising)
    if cause == "objects that rise":
        return np.asarray(errors.placed_n[cell] * rising)
    if cause == "jaws that close less over the batch":
        surrogate = problem.surrogate
        return np.asarray(surrogate.wider_n[grasps.tool, surrogate.column, 1] * rising)
    if cause == "a factor of each cell":
        return base_n * per(cell, is_bent=False)
    return np.asarray(peak_n * per(cell, is_bent=False))
