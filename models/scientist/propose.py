"""The Bayesian scientist: which designs to simulate or print next."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fast.models.blas import one_blas_thread
from fast.models.design.printability import PrintingRules, printable
from fast.models.design.space import FIN_RAYS, DesignSpace
from fast.models.errors import UsageError
from fast.models.own_code import is_own
from fast.models.records import Design
from fast.models.scientist.acquisition.candidates import (
    CandidateSettings,
    Pool,
    Predictor,
    Spacing,
    candidate_points,
    mutate,
)
from fast.models.scientist.acquisition.front import Criterion, select_by_hypervolume
from fast.models.scientist.acquisition.improvement import select_by_improvement
from fast.models.scientist.acquisition.mes import select_by_mes
from fast.models.scientist.bridge.own_model import OwnSurrogate
from fast.models.scientist.surrogate.observations import REAL, SIM
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.models.validation import closest

# (pool, n, rng) -> up to n (row of the pool's points, value), best first
Selection = Callable[[Pool, int, np.random.Generator], list[tuple[int, float]]]
# A new rule is one function and one line here; `random` needs no surrogate, and no function. Rules of a user's own and
# models of a user's own go through BoTorch (`models.scientist.bridge`).
ACQUISITIONS: dict[str, Selection] = {"mes": select_by_mes, "ei": select_by_improvement}
RANDOM = "random"
NO_PENDING = np.zeros((0, FIN_RAYS.n_dims + 1))
Constraint = Callable[[Design], bool]  # whether a design may be made
# One proposal at a time deserves fewer candidates than a batch that is printed.
BATCH_CANDIDATES = CandidateSettings()
SINGLE_CANDIDATES = CandidateSettings(n_random=250, n_local=350)
MIN_DISTANCE = 0.05  # of tools of a batch, in the unit cube
_MAX_ROUNDS = 20
N_NEAR_TOOLS = 300  # candidates near measured tools, where there are several criteria
_NEAR_SCALES = np.array([0.03, 0.1, 0.2])


@dataclass(frozen=True)
class Proposal:
    """A design to evaluate. `value`: of the acquisition that chose it (MES: nats; random, best predicted: 0)."""

    design: Design
    value: float


@dataclass(frozen=True)
class Rule:
    """How designs are chosen among those that may be proposed."""

    acquisition: str = "mes"
    """A name of `ACQUISITIONS`, `random`, or `module:function` of one's own."""
    n_best: int = 0
    """So many of the designs are those with the largest predicted force; the others are chosen given them."""
    criteria: Sequence[Criterion] = ()
    """Objectives and limits, by whose hypervolume improvement tools are chosen instead; none: the largest force."""


@dataclass(frozen=True, eq=False)
class Room:
    """Where proposals may lie: designs of a space of d parameters, but for these."""

    space: DesignSpace = FIN_RAYS
    """The designs that may be made."""
    printing: PrintingRules | None = None
    """Rules that a design must keep; left out before anything is chosen, as by `constraint`."""
    constraint: Constraint | None = None
    """What else a design must keep."""
    taken: np.ndarray | None = None
    """Points (k x d, unit cube) that were proposed before, whatever became of them: never proposed again."""
    rejected: np.ndarray | None = None
    """Points (k x d, unit cube) that proposals keep away from, as they do from each other and from pending ones."""
    min_distance: float = MIN_DISTANCE
    """How far they keep, Euclidean, in the unit cube."""
    pinned: Mapping[int, float] = field(default_factory=dict)
    """Unit-cube values that all proposals have, by column."""

    def keep(self, points: np.ndarray) -> np.ndarray:
        """Keep those of the points (m x d), pinned columns set, that keep the rules of printing and the constraint."""
        if self.pinned:
            points = points.copy()
            points[:, list(self.pinned)] = list(self.pinned.values())
            points = self.space.snap(points)
            points = points[self.space.keeps_limits(points)]
        return keep_allowed(points, self.printing, self.constraint, self.space)


ANYWHERE = Room()


def propose(
    surrogate: Surrogate | OwnSurrogate | None,
    fidelity: int,
    n: int,
    pending: np.ndarray,
    rng: np.random.Generator,
    rule: Rule = Rule(),
    room: Room = ANYWHERE,
) -> list[Proposal]:
    """Propose the next n designs for one fidelity (0 sim, 1 real), best first, by a rule, where there is room for them.

    pending: m x (d + 1), unit-cube points under way and their fidelity in the last column; their outcomes are
    conditioned on. The proposals keep their distance from pending points of the same fidelity, and never repeat data
    of the same fidelity. What is known at one fidelity may be proposed at the other. Deterministic given the arguments
    and the state of `rng`. `surrogate` may be None for the rule `random` only.

    Raises:
        UsageError: unknown acquisition or fidelity, wrong shape of pending, no surrogate, no room for n designs, or a
            function of one's own that cannot be used.

    Example:
        >>> proposals = propose(None, 1, 3, NO_PENDING, np.random.default_rng(0), Rule("random"))
        >>> len({proposal.design.design_id for proposal in proposals})
        3
    """
    space = room.space
    _check(surrogate, fidelity, n, pending, rule.acquisition, space)
    nothing = np.zeros((0, space.n_dims))
    known = np.concatenate([_known(surrogate, fidelity, nothing), nothing if room.taken is None else room.taken])
    rejected = nothing if room.rejected is None else room.rejected
    neighbours = np.concatenate([pending[pending[:, -1] == fidelity, :-1], rejected])
    spacing = Spacing(known, neighbours, room.min_distance)
    if surrogate is None or rule.acquisition == RANDOM:
        return _propose_random(n, spacing, rng, room)
    select = _selection(rule.acquisition, surrogate)
    if rule.criteria:
        select = partial(select_by_hypervolume, rule.criteria)
    with one_blas_thread():
        # From fresh candidates until n are found; what is already chosen counts as pending.
        settings = SINGLE_CANDIDATES if n == 1 else BATCH_CANDIDATES
        best = _best_predicted(surrogate, min(rule.n_best, n), spacing, rng, room)
        proposals = [Proposal(design, 0.0) for design in space.from_unit(best)]
        if len(proposals) == n:
            return proposals
        pending = np.concatenate([pending, np.column_stack([best, np.full(len(best), fidelity)])])
        for _ in range(_MAX_ROUNDS):
            points = room.keep(_candidates(surrogate, rule.criteria, rng, settings, space))
            if not len(points):
                continue
            chosen = select(Pool(surrogate, points, fidelity, pending, spacing), n - len(proposals), rng)
            rows = [row for row, _ in chosen]
            designs = space.from_unit(points[rows])
            proposals += [Proposal(design, value) for design, (_, value) in zip(designs, chosen, strict=True)]
            if len(proposals) == n:
                return proposals
            picked = np.column_stack([points[rows], np.full(len(rows), fidelity)])
            pending = np.concatenate([pending, picked])
    raise _no_room(n, len(proposals))


def _best_predicted(
    surrogate: Surrogate | OwnSurrogate,
    n: int,
    spacing: Spacing,
    rng: np.random.Generator,
    room: Room,
) -> np.ndarray:
    """Find up to n candidates with the largest predicted real force that keep the spacing, best first, m x d."""
    if not n:
        return np.zeros((0, room.space.n_dims))
    points = room.keep(candidate_points(surrogate, rng, BATCH_CANDIDATES, room.space))
    chosen: list[np.ndarray] = []
    for point in points[np.argsort(-surrogate.mean(points, REAL), kind="stable")]:
        if len(chosen) < n and spacing.allowed(point[None, :])[0]:
            chosen.append(point)
            spacing.add(point)
    return np.array(chosen).reshape(-1, room.space.n_dims)


def _propose_random(n: int, spacing: Spacing, rng: np.random.Generator, room: Room) -> list[Proposal]:
    space = room.space
    chosen: list[np.ndarray] = []
    for point in room.keep(space.random_unit(max(200, 20 * n), rng)):
        if len(chosen) == n:
            break
        if spacing.allowed(point[None, :])[0]:
            chosen.append(point)
            spacing.add(point)
    if len(chosen) < n:
        raise _no_room(n, len(chosen))
    return [Proposal(design, 0.0) for design in space.from_unit(np.array(chosen).reshape(-1, space.n_dims))]


def _candidates(
    surrogate: Surrogate | OwnSurrogate,
    criteria: Sequence[Criterion],
    rng: np.random.Generator,
    settings: CandidateSettings,
    space: DesignSpace,
) -> np.ndarray:
    """Make candidates around the incumbents of the surrogate and every other one that counts, and around all tools."""
    others = [one.predictor for one in criteria if one.predictor is not None and one.predictor is not surrogate]
    predictors: list[Predictor] = [surrogate, *others]
    parts = [candidate_points(model, rng, settings, space) for model in predictors]
    if criteria:  # the front lies between the best of each objective, and what was measured lies along it
        measured = space.snap(surrogate.data.x[surrogate.data.s == REAL])
        parents = measured[rng.integers(0, len(measured), N_NEAR_TOOLS)]
        near = mutate(parents, rng.choice(_NEAR_SCALES, N_NEAR_TOOLS), rng, space)
        parts.append(near[space.keeps_limits(near)] if space.limits else near)
    return np.concatenate(parts)


def _selection(acquisition: str, surrogate: Surrogate | OwnSurrogate) -> Selection:
    if not is_own(acquisition) and not isinstance(surrogate, OwnSurrogate):
        return ACQUISITIONS[acquisition]
    if not is_own(acquisition) and acquisition != "mes":
        raise UsageError(f"Acquisition `{acquisition}` needs FAST's surrogate; with a model of your own use `mes`.")
    from fast.models.scientist.bridge.choose import select_by_rule  # imports torch

    return partial(select_by_rule, acquisition)


def keep_allowed(
    points: np.ndarray,
    rules: PrintingRules | None,
    constraint: Constraint | None,
    space: DesignSpace = FIN_RAYS,
) -> np.ndarray:
    """Keep those of the points (m x d) whose designs keep the rules of printing and the constraint."""
    kept = points if rules is None else points[printable(points, rules, space)]
    if constraint is None:
        return kept
    return kept[np.array([constraint(design) for design in space.from_unit(kept)], dtype=bool)]


def _known(surrogate: Surrogate | OwnSurrogate | None, fidelity: int, nothing: np.ndarray) -> np.ndarray:
    if surrogate is None:
        return nothing
    return surrogate.data.x[surrogate.data.s == fidelity]


def _check(
    surrogate: Surrogate | OwnSurrogate | None,
    fidelity: int,
    n: int,
    pending: np.ndarray,
    acquisition: str,
    space: DesignSpace,
) -> None:
    names = [*ACQUISITIONS, RANDOM]
    if acquisition not in names and not is_own(acquisition):
        raise UsageError(f"Acquisition `{acquisition}` is unknown; {closest(acquisition, names)}")
    if surrogate is None and acquisition != RANDOM:
        raise UsageError(f"Acquisition `{acquisition}` needs a fitted surrogate; fit one, or propose with `random`.")
    if fidelity not in (SIM, REAL):
        raise UsageError(f"Fidelity is {fidelity}, it must be 0 (sim) or 1 (real).")
    if n < 1:
        raise UsageError(f"{n} designs asked for; ask for at least 1.")
    if pending.ndim != 2 or pending.shape[1] != space.n_dims + 1:
        raise UsageError(
            f"Pending points have shape {pending.shape}; give m x {space.n_dims + 1}: the unit-cube point, then s."
        )


def _no_room(n: int, found: int) -> UsageError:
    return UsageError(f"Only {found} of {n} designs fit apart from each other; ask for a smaller minimum distance.")
