"""Made-up worlds of the panel at hand, from the bank's own forces, so that a world costs no simulation.

A world has the lab's own tools, objects, repeats, order and noise. Every other one hides nothing but another mesh,
contact, placement and prints. The others hide, in turn, an effect of the catalogue, by its own law or by one that
differs along the lift, from print to print and from object to object, and a cause of no catalogue: a force or factor
of all grasps, objects, tools or single cells, or a drift. A third of the worlds with an effect hides a second one, of
another family. Sizes are drawn from a hundredth to a fifth of the force.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.models.gap.evidence.errors import PLACEMENT_SD_MM, TARE_SD_N, Scatter
from fast.models.gap.evidence.facts import Fact
from fast.models.gap.evidence.laws import list_secants, scale_value
from fast.models.gap.evidence.likelihood import SHARED_SD, THETA_STEPS, Problem
from fast.models.gap.evidence.reading import KNOTS_MM, OF_BINS, compute_rms
from fast.models.gap.fit.law_freedom import LAW_SD
from fast.models.gap.fit.recalibrate import TOOL_SD
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import N_STEPS, STEP_MM

SCATTER = Scatter()  # of cells and repeats of made-up worlds
SMALLEST, LARGEST = 0.01, 0.2  # of the force: sizes of what is hidden
_SOLVER_SD = 0.4  # of ln of how many times larger than the bank's variants a solver's errors are
_OTHER_SOLVER = 0.3  # of what a variant changes: by how much another solver differs from cell to cell and over the lift
_MODULUS_SD = 0.25  # of ln E
_INNER = 0.1  # of the grid: thetas lie farther from its ends
_PAIRS = 1.0 / 3.0  # of worlds with an effect: they hide two
_LEAST_ERROR = 0.01  # of the peak: what no likelihood weighs finer, when theta is fitted to a change

Group = Literal["nothing", "listed", "unlisted"]
NOTHING: Group = "nothing"
LISTED: Group = "listed"
UNLISTED: Group = "unlisted"
_LIFT_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)


@dataclass(frozen=True, eq=False)
class World:
    """A made-up world. steps_n: n x 120. cause: an effect or a kind of unlisted cause, empty for nothing.

    second: another effect beside it, mostly empty. facts: as persons would measure them there.
    size: root mean square of what is changed and theta and prints cannot make up for, as a share of the force.
    """

    group: Group
    steps_n: np.ndarray
    cause: str = ""
    size: float = 0.0
    facts: tuple[Fact, ...] = ()
    second: str = ""


def make_world(problem: Problem, names: Sequence[str], rng: np.random.Generator, number: int) -> World:
    """Make the world of a number: nothing in every other; an effect and a cause of no catalogue in turn."""
    theta = _draw_theta(problem, rng)
    base_n = problem.predict_steps(theta, problem.effects)
    group = (NOTHING, LISTED, NOTHING, UNLISTED)[number % 4]
    cause, second, change_n, hidden = "", "", np.zeros_like(base_n), list(problem.effects)
    size = _draw_size(rng)
    if group == LISTED:
        cause = names[(number // 4) % len(names)]
        if rng.uniform() < _PAIRS:
            others = [name for name in names if CATALOGUE[name].family != CATALOGUE[cause].family]
            second = others[int(rng.integers(len(others)))] if others else ""
        for name, own in ((cause, size), (second, _draw_size(rng))) if second else ((cause, size),):
            has_other_law = rng.uniform() < 0.5
            value = _draw_effect(problem, theta, base_n, name, own, rng)
            own_n = problem.predict_steps(theta, [*hidden, value]) - problem.predict_steps(theta, hidden)
            hidden.append(value)
            change_n = change_n + (own_n * _draw_law(problem, rng) if has_other_law else own_n)
    elif group == UNLISTED:
        cause = tuple(_UNLISTED)[(number // 4) % len(_UNLISTED)]
        change_n = _UNLISTED[cause](_Draw.of(problem, theta, base_n, rng))
        change_n = change_n * size * compute_rms(base_n) / max(compute_rms(change_n), 1e-9)
    steps_n = _measure(problem, base_n + change_n, base_n, rng)
    visible = _measure_visible(problem, theta, base_n, change_n) if cause else 0.0
    return World(group, steps_n, cause, visible, tuple(fact.draw(hidden, rng) for fact in problem.facts), second)


def _draw_size(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))


def _measure_visible(problem: Problem, theta: np.ndarray, base_n: np.ndarray, change_n: np.ndarray) -> float:
    """Measure the size of a change (n x 120) of forces (n x 120) left when theta and print moduli are fitted to it."""
    grasps, cell = problem.reading.grasps, problem.reading.cell
    weight = 1.0 / np.hypot(_LEAST_ERROR * np.abs(base_n).max(axis=1, keepdims=True), TARE_SD_N)
    bare_n, slopes = problem.predict_cells(theta, problem.effects), []
    for place, by in enumerate(THETA_STEPS, start=1):
        moved = theta + by * (np.arange(3) == place)
        slopes.append((problem.predict_cells(moved, problem.effects) - bare_n)[cell])
    prints = [TOOL_SD * base_n * (grasps.tool == one)[:, None] for one in np.unique(grasps.tool)]
    free = np.array([((one * weight) @ OF_BINS.T).ravel() for one in (base_n, *slopes, *prints)])
    target = ((change_n * weight) @ OF_BINS.T).ravel()
    held = np.diag([1e-9] * (1 + len(slopes)) + [1.0] * len(prints))
    left = target - np.linalg.solve(free @ free.T + held, free @ target) @ free
    share = np.linalg.norm(left) / max(float(np.linalg.norm(target)), 1e-12)
    return float(share) * compute_rms(change_n) / compute_rms(base_n)


def _draw_theta(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    bank = problem.surrogate.bank
    low, high = bank.grid.min(axis=0), bank.grid.max(axis=0)
    inside = rng.uniform(_INNER, 1.0 - _INNER, 2)
    modulus = bank.centre.young_modulus_mpa * np.exp(_MODULUS_SD * rng.standard_normal())
    return np.array([modulus, *(low + inside * (high - low))])


def _measure(problem: Problem, true_n: np.ndarray, base_n: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return what a lab would measure of true forces (n x 120), by a solver that is not the simulator."""
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


def _draw_smooth(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw smooth functions of the lift, n x 120, of unit variance at the knots."""
    knots = rng.standard_normal((n, len(KNOTS_MM)))
    return np.array([np.interp(_LIFT_MM, KNOTS_MM, row) for row in knots])


def _draw_effect(
    problem: Problem, theta: np.ndarray, base_n: np.ndarray, name: str, size: float, rng: np.random.Generator
) -> EffectValue:
    """Draw an effect at an amplitude where it changes about `size` of the force, or as near as it plausibly comes."""
    values = list_secants(name)
    value = values[int(rng.integers(len(values)))]
    scale, change_n = 1.0, np.zeros_like(base_n)
    for _ in range(3):
        change_n = problem.predict_steps(theta, [*problem.effects, scale_value(value, scale)]) - base_n
        scale = float(np.clip(scale * size * compute_rms(base_n) / max(compute_rms(change_n), 1e-9), 0.05, 1.7))
    return scale_value(value, scale)


def _draw_law(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """Draw by what factor another law of an effect changes more, n x 120."""
    reading = problem.reading
    along = _draw_smooth(rng, 1)
    tools, objects = (
        rng.standard_normal(len(all_own))[own][:, None]
        for all_own, own in ((reading.grasps.tools, reading.grasps.tool), (reading.grasps.objects, reading.grasps.obj))
    )
    return np.asarray(1.0 + LAW_SD * (along + tools + objects))


@dataclass(frozen=True, eq=False)
class _Draw:
    """What causes of no catalogue are drawn from. base_n: n x 120; rising: n x 1, from 0 to 1 over the batch."""

    problem: Problem
    theta: np.ndarray
    base_n: np.ndarray
    rng: np.random.Generator
    rising: np.ndarray

    @staticmethod
    def of(problem: Problem, theta: np.ndarray, base_n: np.ndarray, rng: np.random.Generator) -> "_Draw":
        clock = np.array([context.batch_grasps for context in problem.reading.grasps.contexts], dtype=float)
        scale = max(float(clock.max()) * rng.uniform(0.15, 0.6), 1.0)
        return _Draw(problem, theta, base_n, rng, (1.0 - np.exp(-clock / scale))[:, None])

    @property
    def peak_n(self) -> float:
        """The median peak of the grasps."""
        return float(np.median(np.abs(self.base_n).max(axis=1)))

    @property
    def level_n(self) -> np.ndarray:
        """Root mean square force of each grasp, n x 1."""
        return np.asarray(np.sqrt((self.base_n**2).mean(axis=1))[:, None])

    def draw_smooth(self) -> np.ndarray:
        """Draw the same smooth function of the lift in every grasp, 1 x 120."""
        return _draw_smooth(self.rng, 1)

    def draw_each(self, group: np.ndarray) -> np.ndarray:
        """Draw a number for each group, that varies little over the lift, n x 120; group: n, of each grasp."""
        n = int(group.max()) + 1
        return np.asarray((self.rng.standard_normal((n, 1)) + 0.4 * _draw_smooth(self.rng, n))[group])

    @property
    def obj(self) -> np.ndarray:
        """Object of each grasp, n."""
        return self.problem.reading.grasps.obj

    @property
    def cell(self) -> np.ndarray:
        """Cell of each grasp, n."""
        return self.problem.reading.cell


def _delay_objects(draw: _Draw) -> np.ndarray:
    """Make a force come late on all objects, on each by another amount: as if they were larger than drawn."""
    own = draw.rng.uniform(0.2, 1.0)
    late = np.sqrt(1.0 - own**2) + own * draw.rng.standard_normal(len(draw.problem.reading.grasps.objects))
    return np.asarray(-np.gradient(draw.base_n, STEP_MM, axis=1) * late[draw.obj][:, None])


def _rub_objects(draw: _Draw) -> np.ndarray:
    """Draw surfaces that differ: on each object another friction, by as much for all grasps of it."""
    problem, by = draw.problem, np.array([0.0, THETA_STEPS[0], 0.0])
    more_n, less_n = (problem.predict_cells(draw.theta + side * by, problem.effects) for side in (1.0, -1.0))
    own = draw.rng.standard_normal(len(problem.reading.grasps.objects))[draw.obj][:, None]
    return np.asarray((more_n - less_n)[draw.cell] * own)


def _bend_tools(draw: _Draw) -> np.ndarray:
    grasps = draw.problem.reading.grasps
    return np.asarray(draw.base_n * _draw_smooth(draw.rng, len(grasps.tools))[grasps.tool])


def _grow_with_force(draw: _Draw) -> np.ndarray:
    power = draw.rng.uniform(0.5, 1.5)
    return np.asarray(draw.level_n * (draw.level_n / draw.level_n.mean()) ** power * draw.draw_smooth())


def _close_less(draw: _Draw) -> np.ndarray:
    surrogate = draw.problem.surrogate
    return np.asarray(surrogate.wider_n[surrogate.grasps.tool, surrogate.column, 1] * draw.rising)


# Drifts without a law of the catalogue's that are nevertheless what one of its effects does: the quantity that changes.
DRIFTS: Mapping[str, str] = {"a zero that wanders": "zero", "jaws that close less over the batch": "closing"}
# Causes of no catalogue: what each changes, n x 120, of any size.
_UNLISTED: Mapping[str, Callable[[_Draw], np.ndarray]] = {
    "a force in every grasp": lambda draw: draw.peak_n * draw.draw_smooth() * np.ones_like(draw.base_n),
    "a factor that bends over the lift": lambda draw: draw.base_n * draw.draw_smooth(),
    "a factor of each object": lambda draw: draw.base_n * draw.draw_each(draw.obj),
    "a force of each object": lambda draw: draw.peak_n * draw.draw_each(draw.obj),
    "a delay of each object": _delay_objects,
    "a friction of each object": _rub_objects,
    "a factor of each tool over the lift": _bend_tools,
    "a force that grows with the force": _grow_with_force,
    "a zero that wanders": lambda draw: np.ones_like(draw.base_n) * draw.rising,
    "objects that rise": lambda draw: draw.problem.errors.placed_n[draw.cell] * draw.rising,
    "jaws that close less over the batch": _close_less,
    "a factor of each cell": lambda draw: draw.base_n * draw.draw_each(draw.cell),
    "a force of each cell": lambda draw: draw.peak_n * draw.draw_each(draw.cell),
}
