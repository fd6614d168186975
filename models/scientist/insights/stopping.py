"""Whether another batch is worth it: the rest of a campaign, rehearsed in every world that the data allow.

In a rehearsal one world is the bench; its parameters (lengthscales and the like) are its own, since the data do not
know them exactly. The learner is the surrogate. It chooses a batch as a campaign does, the most by the best design of
functions drawn from its posterior (Thompson sampling), a few by the largest predicted force; it is told the forces of
the world with noise, learns, and chooses again. How often a batch beats the best before it by the lab's margin is the
chance of that batch; and so on for the batches after it. A night of simulations first tells the learner what the
simulator of the world says at the most promising designs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fast.models.design.space import DesignSpace
from fast.models.records import Record
from fast.models.scientist.acquisition.candidates import CandidateSettings, candidate_points
from fast.models.scientist.acquisition.paths import draw_deviations
from fast.models.scientist.insights.rules import LEAST_CHANCE, MARGIN
from fast.models.scientist.insights.worlds import Worlds
from fast.models.scientist.surrogate.observations import REAL, SIM
from fast.models.scientist.surrogate.posterior import prior_covariance

N_AHEAD = 6  # batches that are rehearsed
CANDIDATES = CandidateSettings(n_random=200, n_local=500)
_N_GREEDY = 2  # of a batch, designs with the largest predicted force


class BatchAhead(Record):
    """What a batch to come brings, by the rehearsals.

    chance: that it beats the best before it by the margin. gain_n: in the median, how much it adds to the best, N.
    """

    chance: float
    gain_n: float


class Outlook(Record):
    """Whether another batch is worth it.

    best_n: the best finger so far, median over the worlds. ahead: the next batch, the one after it, and so on.
    after_night: the next batch, if a night of `n_night` simulations goes before it; None without a simulator.
    """

    margin: float
    best_n: float
    ahead: tuple[BatchAhead, ...]
    n_tools: int
    after_night: BatchAhead | None = None
    n_night: int = 0

    @property
    def chance(self) -> float:
        """Of the next batch."""
        return self.ahead[0].chance

    @property
    def n_worth(self) -> int | None:
        """Batches to come before the chance falls below the limit; None where it does not within those rehearsed."""
        below = [place for place, batch in enumerate(self.ahead) if batch.chance < LEAST_CHANCE]
        return below[0] if below else None

    @property
    def is_worth(self) -> bool:
        """Whether the chance of the next batch reaches the limit."""
        return self.chance >= LEAST_CHANCE


@dataclass(frozen=True, eq=False)
class _Stage:
    """Outcomes that can be asked for in a rehearsal: measured at the first m designs, then simulated at some."""

    worlds: np.ndarray
    """What every world says, k x n, in units of the data."""
    draws: np.ndarray
    """Functions that the learner thinks possible, k x n."""
    mean: np.ndarray
    """What the learner knows, k."""
    covariance: np.ndarray
    """Of that, k x k."""
    noise_sd: np.ndarray
    """Of what the learner is told, k."""
    forces_n: np.ndarray
    """What every world says of the designs, m x n, N."""
    n_measured: int
    """Designs that are measured already, the first ones."""

    @property
    def n_designs(self) -> int:
        """Designs that can be measured."""
        return len(self.forces_n)


@dataclass(frozen=True, eq=False)
class BatchPlan:
    """The batches to come that are rehearsed."""

    n_tools: int
    """Of each batch that the learner chooses."""
    n_ahead: int = N_AHEAD
    """Batches."""
    next_tools: np.ndarray | None = None
    """Designs that are proposed already, p x d, unit cube: they are the next batch; None: the learner chooses it."""
    n_night: int = 0
    """Simulations of a night, which may go before the next batch; 0 for none."""


def look_ahead(
    worlds: Worlds, space: DesignSpace, plan: BatchPlan, rng: np.random.Generator, margin: float = MARGIN
) -> Outlook:
    """Rehearse batches in each of the worlds; margin: by which a batch beats the best before it, as a share of it."""
    surrogate, next_tools = worlds.surrogate, plan.next_tools
    points = candidate_points(surrogate, rng, CANDIDATES, space)
    measured = surrogate.data.x[surrogate.data.s == REAL]
    own = np.zeros((0, space.n_dims)) if next_tools is None else next_tools
    designs = np.concatenate([measured, own, points])
    night_rows = np.argsort(-surrogate.mean(designs, REAL), kind="stable")[: plan.n_night]
    stage = _stage(worlds, designs, night_rows, len(measured), rng)
    first = np.arange(len(measured), len(measured) + len(own)) if len(own) else None
    best_n = _rehearse(stage, plan.n_tools, plan.n_ahead, rng, first)
    outlook = Outlook(
        margin=margin,
        best_n=float(np.median(best_n[0])),
        ahead=tuple(_batch(best_n[k], best_n[k + 1], margin) for k in range(plan.n_ahead)),
        n_tools=plan.n_tools,
    )
    if not plan.n_night:
        return outlook
    told = tuple(range(len(designs), len(designs) + len(night_rows)))
    after = _rehearse(stage, plan.n_tools, 1, rng, told=told)
    return outlook.model_copy(update={"after_night": _batch(after[0], after[1], margin), "n_night": plan.n_night})


def _batch(before_n: np.ndarray, after_n: np.ndarray, margin: float) -> BatchAhead:
    # What holds nothing yet may be a little below 0 in a world, and is not beaten by itself.
    is_beaten = (after_n > before_n) & (after_n - before_n >= margin * np.abs(before_n))
    return BatchAhead(chance=float(np.mean(is_beaten)), gain_n=float(np.median(after_n - before_n)))


def _stage(
    worlds: Worlds, designs: np.ndarray, night_rows: np.ndarray, n_measured: int, rng: np.random.Generator
) -> _Stage:
    surrogate = worlds.surrogate
    p, told = surrogate.parameters, worlds.at(designs)
    x = np.concatenate([designs, designs[night_rows]])
    s = np.repeat([REAL, SIM], [len(designs), len(night_rows)])
    explained = surrogate.whitened(x, s)
    mean, covariance = surrogate.mean(x, s), prior_covariance(p, x, s, x, s) - explained.T @ explained
    return _Stage(
        worlds=np.concatenate([told.real, told.sim[night_rows]]),
        draws=mean[:, None] + draw_deviations(covariance, worlds.n, rng),
        mean=mean,
        covariance=covariance,
        noise_sd=np.where(s == REAL, p.noise_sd, p.nugget),
        forces_n=surrogate.data.force_n(told.real),
        n_measured=n_measured,
    )


def _rehearse(
    stage: _Stage,
    n_tools: int,
    n_ahead: int,
    rng: np.random.Generator,
    first: np.ndarray | None = None,
    told: Sequence[int] = (),
) -> np.ndarray:
    """Rehearse the best force so far in every world before the first batch and after each, (n_ahead + 1) x n, N.

    first: rows of the first batch, if it is not chosen. told: rows that the learner is told before it.
    """
    forces, n_measured = stage.forces_n, stage.n_measured
    n_worlds = forces.shape[1]
    best_n = np.zeros((n_ahead + 1, n_worlds))
    for world in range(n_worlds):
        best = float(forces[:n_measured, world].max())
        best_n[0, world] = best
        learner = _Learner(stage, world, rng)
        learner.learn(list(told))
        for batch in range(n_ahead):
            rows = list(first) if batch == 0 and first is not None else learner.choose(n_measured, n_tools)
            best = max(best, float(forces[rows, world].max()))
            best_n[batch + 1, world] = best
            learner.learn(rows)
    return best_n


class _Learner:
    """Who chooses batches in a rehearsal: knows the data, and what its world has told it since."""

    def __init__(self, stage: _Stage, world: int, rng: np.random.Generator) -> None:
        self._stage, self._world, self._rng = stage, world, rng
        self._rows: list[int] = []
        self._told: list[float] = []

    def learn(self, rows: Sequence[int]) -> None:
        """Learn outcomes of the world that it is told, with noise."""
        rows = [int(row) for row in rows]
        noise = self._stage.noise_sd[rows] * self._rng.normal(size=len(rows))
        self._told += (self._stage.worlds[rows, self._world] + noise).tolist()
        self._rows += rows

    def choose(self, first_free: int, n: int) -> list[int]:
        """Choose n designs: the best of functions drawn, in line with what was told, and the best predicted."""
        stage = self._stage
        drawn = self._rng.choice(stage.draws.shape[1], n, replace=n > stage.draws.shape[1])
        draws = np.column_stack([stage.mean, stage.draws[:, drawn]])
        if self._rows:
            rows = np.array(self._rows)
            noise = stage.noise_sd[rows, None] * self._rng.normal(size=(len(rows), draws.shape[1]))
            noise[:, 0] = 0.0
            K = stage.covariance[np.ix_(rows, rows)] + np.diag(stage.noise_sd[rows] ** 2)
            K[np.diag_indices_from(K)] *= 1.0 + 1e-8
            missed = np.array(self._told)[:, None] - draws[rows] - noise
            draws = draws + stage.covariance[:, rows] @ cho_solve(cho_factor(K), missed)
        taken = np.zeros(stage.n_designs, dtype=bool)
        taken[:first_free] = True
        taken[[row for row in self._rows if row < stage.n_designs]] = True
        chosen: list[int] = []
        for place in range(n):
            values = draws[: stage.n_designs, 0 if place < _N_GREEDY else place]
            row = int(np.argmax(np.where(taken, -np.inf, values)))
            taken[row] = True
            chosen.append(row)
        return chosen
