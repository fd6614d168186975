"""Strategies replayed on what a lab has measured: the nearest measured design stands for a design that is proposed.

A replay begins with some of the measured tools, drawn at random. The strategy proposes a batch as in a campaign; of
each proposal the nearest tool that is still free is taken, with its measured outcome. How far a stand-in is from what
was proposed is told beside the result: where its error is as large as the differences between strategies, the data do
not tell them apart.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from fast.models.design.space import DesignSpace
from fast.models.errors import UsageError
from fast.models.records import Record
from fast.models.scientist.propose import Room, propose
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_simulations
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS, REAL, SIM, ObservationSet

RANDOM, MEASURED_ONLY, HYBRID = "random", "measured only", "with simulations"
LEAST_TOOLS = 12  # in fewer there is nothing to choose from
GOOD = 0.95  # of the best tool of the lake


class Replay(Record):
    """One strategy replayed with one draw of the first tools.

    best_n: best measured outcome so far, after the first tools and each batch; n_tools: tools by then. stand_in_n: root
    mean square difference between proposals and their stand-ins, both predicted from all data, N; None for random.
    """

    strategy: str
    n_batch: int
    seed: int
    n_tools: tuple[int, ...]
    best_n: tuple[float, ...]
    stand_in_n: float | None = None

    def tools_to(self, force_n: float) -> int | None:
        """Count the tools until the best reaches an outcome."""
        return next((n for n, best in zip(self.n_tools, self.best_n, strict=True) if best >= force_n), None)


class ReplayRow(Record):
    """Replays of a strategy and size of a batch, summed up.

    half_n: best after half of the tools, mean. share: of the best of all. tools_to_good: median tools to `GOOD` of it.
    """

    strategy: str
    n_batch: int
    replays: int
    half_n: float
    share: float
    tools_to_good: float
    stand_in_n: float | None


def replay(data: ObservationSet, space: DesignSpace, strategy: str, n_first: int, n_batch: int, seed: int) -> Replay:
    """Replay a strategy until no tool is left.

    data: of one campaign, in the units that its surrogate is fitted in.

    Raises:
        UsageError: there are hardly any measured tools, or no simulations for the strategy that needs them.
    """
    real, sim = data.take(data.s == REAL), data.take(data.s == SIM)
    _check(real, sim, strategy, n_first)
    rng = np.random.default_rng([seed, n_batch])
    free = list(np.random.default_rng(seed).permutation(len(real)))  # all strategies of a seed begin alike
    known, free = free[:n_first], free[n_first:]
    whole = fit_surrogate(data)
    n_tools, best_n, missed = [len(known)], [float(real.y[known].max())], []
    while free:
        n = min(n_batch, len(free))
        if strategy == RANDOM:
            rows = free[:n]
        else:
            proposed = _propose(real.take(np.array(known)), sim, strategy, space, n, rng)
            rows = _stand_ins(proposed, real.x, free)
            told = [whole.data.force_n(whole.mean(x, REAL)) for x in (proposed, real.x[rows])]
            missed += (told[0] - told[1]).tolist()
        known += rows
        free = [row for row in free if row not in rows]
        n_tools.append(len(known))
        best_n.append(float(real.y[known].max()))
    return Replay(
        strategy=strategy,
        n_batch=n_batch,
        seed=seed,
        n_tools=tuple(n_tools),
        best_n=tuple(data.force_n(np.array(best_n)).tolist()),
        stand_in_n=float(np.sqrt(np.mean(np.square(missed)))) if missed else None,
    )


def sum_up(replays: Sequence[Replay]) -> list[ReplayRow]:
    """Make a row for each strategy and size of a batch, in the order of the replays."""
    rows = []
    for strategy, n_batch in dict.fromkeys((one.strategy, one.n_batch) for one in replays):
        own = [one for one in replays if (one.strategy, one.n_batch) == (strategy, n_batch)]
        best, all_of_them = own[0].best_n[-1], own[0].n_tools[-1]
        half = [float(np.interp(all_of_them / 2, one.n_tools, one.best_n)) for one in own]
        missed = [one.stand_in_n for one in own if one.stand_in_n is not None]
        rows.append(
            ReplayRow(
                strategy=strategy,
                n_batch=n_batch,
                replays=len(own),
                half_n=float(np.mean(half)),
                share=float(np.mean(half)) / best if best else 0.0,
                tools_to_good=float(np.median([one.tools_to(GOOD * best) or all_of_them for one in own])),
                stand_in_n=float(np.mean(missed)) if missed else None,
            )
        )
    return rows


def _propose(
    real: ObservationSet, sim: ObservationSet, strategy: str, space: DesignSpace, n: int, rng: np.random.Generator
) -> np.ndarray:
    data = real if strategy == MEASURED_ONLY else _both(real, sim)
    surrogate = fit_surrogate(data)
    surrogate = trust_simulations(surrogate) if data.is_log else surrogate
    proposals = propose(
        surrogate, REAL, n, np.zeros((0, space.n_dims + 1)), rng, room=Room(space=space, min_distance=0.0)
    )
    return space.to_unit([one.design for one in proposals])


def _both(real: ObservationSet, sim: ObservationSet) -> ObservationSet:
    parts = {name: np.concatenate([getattr(sim, name), getattr(real, name)]) for name in ("x", "s", "y")}
    noise = np.concatenate([sim.noise_variance, real.noise_variance])
    return ObservationSet(**parts, noise_variance=noise, is_log=real.is_log)


def _stand_ins(proposed: np.ndarray, x: np.ndarray, free: Sequence[int]) -> list[int]:
    """Find the nearest free tool of each proposal (p x d), the best proposal first, each tool once."""
    left, chosen = list(free), []
    for point in proposed:
        nearest = left[int(np.argmin(cdist(point[None], x[left])))]
        chosen.append(nearest)
        left.remove(nearest)
    return chosen


def _check(real: ObservationSet, sim: ObservationSet, strategy: str, n_first: int) -> None:
    if len(real) < LEAST_TOOLS:
        raise UsageError(f"{len(real)} tools are measured, a replay takes {LEAST_TOOLS} at least; measure more first.")
    if not MIN_OBSERVATIONS <= n_first < len(real):
        raise UsageError(f"a replay begins with {n_first} of {len(real)} tools; choose {MIN_OBSERVATIONS} or more.")
    if strategy == HYBRID and not len(sim):
        raise UsageError(f"the strategy `{HYBRID}` takes simulated designs, the campaign has none; leave it out.")
