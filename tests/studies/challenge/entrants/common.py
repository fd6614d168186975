"""What entrants share: theta fitted to a world, what is left of its cells, and lines from made-up worlds.

An entrant sees the folder of a world and nothing else. Made-up worlds are those of FAST's rehearsal, so every method
that needs a line for its score gets it from the same worlds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from fast.flows.challenge.answers import LIFT_MM
from fast.flows.challenge.world_folder import GivenWorld
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.evidence.rehearsal import NOTHING, make_world
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.where.strata import list_tool_features, make_object_table, make_tool_table
from fast.models.records import EffectValue

N_MADE_UP = 40
EVERY = 4  # steps of 0.5 mm that methods average over
N_BINS = len(LIFT_MM) // EVERY
MIDDLES_MM = LIFT_MM.reshape(-1, EVERY).mean(axis=1)
_RIDGE = 0.1


@dataclass(frozen=True, eq=False)
class Opinion:
    """What a method says of a world; forces_n: m x 80, of its asked grasps."""

    missing: bool
    probability: float
    forces_n: np.ndarray
    effect: str = ""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A world with theta and the prints' moduli fitted; c cells, m asked grasps.

    rest: c x 20, measured less predicted means over 2 mm, over the peak of the cell. force, slope, friction: c x 20,
    the predicted force, what 1 mm more of lift and 1 % more of friction change in it, over the same peak.
    """

    world: GivenWorld
    problem: Problem
    theta: np.ndarray
    tool_factor: np.ndarray
    cells: "Columns"
    rest: np.ndarray

    @staticmethod
    def of(world: GivenWorld, problem: Problem | None = None, measured_n: np.ndarray | None = None) -> "Fitted":
        """The fit of a world, or of a made-up one with its tools and objects (measured_n: n x 120)."""
        problem = Problem.of(world.data.usable) if problem is None else problem
        steps_n = problem.surrogate.grasps.steps_n if measured_n is None else measured_n
        fit = fit_evidence(problem if measured_n is None else problem.measured(measured_n))
        tool_factor = np.exp(fit.moduli)
        cells = Columns.of(problem.of_cells, fit.theta, tool_factor)
        total = np.zeros((problem.reading.n_cells, steps_n.shape[1]))
        np.add.at(total, problem.reading.cell, steps_n)
        means = average(total / problem.reading.n_repeats[:, None]) / cells.peak_n
        return Fitted(world, problem, fit.theta, tool_factor, cells, means - cells.force)

    @cached_property
    def asked(self) -> "Columns":
        """The same columns of the asked grasps."""
        return Columns.of(self.world.data.surrogate.at(self.world.asked), self.theta, self.tool_factor)

    def foretell_with(self, effects: Sequence[EffectValue] = ()) -> np.ndarray:
        """Forces of the asked grasps (m x 80, N) with effects added and all fitted anew, as a search does."""
        found = recalibrate(self.world.data.usable, effects)
        asked = self.world.data.surrogate.at(self.world.asked)
        return asked.predict_steps(found.theta, found.effects, found.tool_factor)[:, : len(LIFT_MM)]

    def foretell(self, rest: np.ndarray | float = 0.0) -> np.ndarray:
        """Forces of the asked grasps (m x 80, N) with what is left added (m x 20, over the peak)."""
        more_n = np.broadcast_to(rest * self.asked.peak_n, (len(self.asked.steps_n), N_BINS))
        smooth_n = np.array([np.interp(LIFT_MM, MIDDLES_MM, row) for row in more_n])
        return np.asarray(self.asked.steps_n + smooth_n)

    @cached_property
    def inputs(self) -> np.ndarray:
        """Design and shape of each cell, c x k, scaled over the panel's."""
        return self._scale(self.problem.tool, self.problem.obj)

    @cached_property
    def asked_inputs(self) -> np.ndarray:
        """The same of the asked grasps, m x k."""
        return self._scale(self.world.asked.tool, self.world.asked.obj)

    def _scale(self, tool: np.ndarray, obj: np.ndarray) -> np.ndarray:
        grasps = self.world.data.grasps
        tools = make_tool_table(grasps.designs, list_tool_features(grasps.designs))
        objects = make_object_table(grasps.objects)
        scaled = [(table - table.mean(axis=0)) / np.maximum(table.std(axis=0), 1e-9) for table in (tools, objects)]
        return np.hstack([scaled[0][tool], scaled[1][obj]])


@dataclass(frozen=True, eq=False)
class Columns:
    """Predictions of n grasps; steps_n: n x 80, N; the others n x 20, over the peak (n x 1, N)."""

    steps_n: np.ndarray
    peak_n: np.ndarray
    force: np.ndarray
    slope: np.ndarray
    friction: np.ndarray

    @staticmethod
    def of(surrogate: Surrogate, theta: np.ndarray, tool_factor: np.ndarray) -> "Columns":
        """Those of a surrogate's grasps."""
        predict = surrogate.predict_steps
        steps_n = predict(theta, (), tool_factor)
        more_n, less_n = (predict(theta * np.array([1.0, by, 1.0]), (), tool_factor) for by in (1.01, 0.99))
        peak_n = np.maximum(np.abs(steps_n).max(axis=1, keepdims=True), 0.1)
        slope_n = np.gradient(steps_n, LIFT_MM[1] - LIFT_MM[0], axis=1)
        kept = [average(one) / peak_n for one in (steps_n, slope_n, 0.5 * (more_n - less_n))]
        return Columns(steps_n[:, : len(LIFT_MM)], peak_n, *kept)


def average(steps_n: np.ndarray) -> np.ndarray:
    """Means over 2 mm up to 40 mm (n x 20) of step means (n x 120)."""
    return np.asarray(steps_n[:, : len(LIFT_MM)].reshape(len(steps_n), N_BINS, EVERY).mean(axis=2))


def list_folds(fitted: Fitted) -> list[np.ndarray]:
    """Masks of cells to leave out: halves of the objects, then halves of the tools."""
    problem = fitted.problem
    return [group % 2 == fold for group in (problem.obj, problem.tool) for fold in range(2)]


def measure_left_out(fitted: Fitted, predict: Callable[[Fitted, np.ndarray, np.ndarray], np.ndarray]) -> float:
    """Share of what is left that is foretold of cells left out, of objects or of tools, whichever is more; -1 at least.

    predict: what is left of the cells of the second mask, learnt from those of the first.
    """
    shares = []
    masks = list_folds(fitted)
    for folds in (masks[:2], masks[2:]):
        wrong = sum(float(((fitted.rest[out] - predict(fitted, ~out, out)) ** 2).sum()) for out in folds if out.any())
        shares.append(1.0 - wrong / max(float((fitted.rest**2).sum()), 1e-12))
    return max(*shares, -1.0)


@dataclass(frozen=True)
class Line:
    """From which score on something is missing, and how probable it is by a score: at * score + intercept, logistic."""

    score: float
    intercept: float
    at: float

    def judge(self, score: float) -> tuple[bool, float]:
        """Whether something is missing, and the probability of that."""
        return score > self.score, float(expit(self.intercept + self.at * score))


def draw_lines(world: GivenWorld, scores: Sequence[Callable[[Fitted], float]], n: int = N_MADE_UP) -> list[Line]:
    """Lines of methods by their scores: the largest score of made-up worlds of a panel that hide nothing."""
    problem = Problem.of(world.data.usable)
    names = problem.surrogate.names
    found, hides = [], []
    for number in range(n):
        made = make_world(problem, names, np.random.default_rng([17, number]), number)
        fitted = Fitted.of(world, problem, made.steps_n)
        found.append([score(fitted) for score in scores])
        hides.append(made.group != NOTHING)
    is_hidden = np.array(hides)
    return [_draw_line(column, is_hidden) for column in np.array(found).T]


def _draw_line(scores: np.ndarray, is_hidden: np.ndarray) -> Line:
    scale = max(float(scores.std()), 1e-9)
    sign = np.where(is_hidden, 1.0, -1.0)
    columns = np.column_stack([np.ones(len(scores)), scores / scale])

    def loss(at: np.ndarray) -> float:
        return float(np.logaddexp(0.0, -sign * (columns @ at)).sum() + _RIDGE * at[1] ** 2)

    intercept, slope = minimize(loss, np.zeros(2), method="BFGS").x
    return Line(float(scores[~is_hidden].max()), float(intercept), float(slope / scale))
