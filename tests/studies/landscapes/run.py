"""One strategy on one landscape through the schedule of the paper."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fast.models.design.space import random_unit, to_unit
from fast.models.records import Record
from fast.models.scientist.acquisition.candidates import mutate
from fast.models.scientist.propose import NO_PENDING, Room, Rule, propose
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_simulations
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from tests.studies.landscapes.landscape import N_DIMS, Landscape
from tests.studies.landscapes.strategies import NightStrategy

_N_PARENTS, _STEPS = 20, (0.05, 0.1, 0.2)  # around which designs a night looks, and how far (unit cube)


class RunSchedule(Record):
    """How much is measured and simulated; the defaults are the paper's, with a quarter of its simulations a round.

    Simulations of a round are chosen `simulations_at_once` at a time, each given the others that are under way.
    """

    initial_tools: int = 30
    initial_simulations: int = 50
    rounds: int = 8
    tools_per_round: int = 10
    simulations_per_round: int = 25
    simulations_at_once: int = 25


class LandscapeRun(Record):
    """What a strategy reached, in N, after the initial designs and after each round.

    `best_n`: largest true force of the designs measured so far. `batch_mean_n`: mean true force of the round's tools.
    """

    landscape: str
    strategy: str
    seed: int
    optimum_n: float
    best_n: tuple[float, ...]
    batch_mean_n: tuple[float, ...]
    n_measured: int
    n_simulated: int
    schedule: RunSchedule = RunSchedule()
    cpu_s: float = 0.0

    @property
    def mean_regret_n(self) -> float:
        """Optimum less the best found, mean over the rounds."""
        return self.optimum_n - float(np.mean(self.best_n[1:]))

    def rounds_to(self, share: float) -> float:
        """First round in which the best found reaches this share of the optimum; infinity when none does."""
        reached = np.flatnonzero(np.array(self.best_n) >= share * self.optimum_n)
        return float(reached[0]) if len(reached) else float("inf")


def run_strategy(
    landscape: Landscape,
    strategy: NightStrategy,
    schedule: RunSchedule,
    seed: int,
    watch: Callable[[ObservationSet], None] = lambda data: None,
) -> LandscapeRun:
    """Run one strategy; all strategies of a landscape and seed begin with the same designs and noise.

    watch: is shown what is known before the first round and after each.
    """
    search = _Search(landscape, strategy, schedule, seed)
    watch(search.data())
    for _ in range(schedule.rounds):
        if strategy.simulations is not None:
            search.simulate()
        if strategy.tools is not None:
            search.measure()
        watch(search.data())
    if strategy.tools is None:
        search.verify()
    return search.result(seed)


@dataclass(eq=False)
class _Known:
    """Designs with their outcomes at one fidelity."""

    x: np.ndarray
    y: np.ndarray

    def add(self, x: np.ndarray, y: np.ndarray) -> None:
        self.x, self.y = np.concatenate([self.x, x]), np.concatenate([self.y, y])


class _Search:
    def __init__(self, landscape: Landscape, strategy: NightStrategy, schedule: RunSchedule, seed: int) -> None:
        self._landscape, self._strategy, self._schedule = landscape, strategy, schedule
        self._rng = np.random.default_rng([seed, 1])
        initial = np.random.default_rng([seed, 0])
        self._tools = _Known(np.zeros((0, N_DIMS)), np.zeros(0))
        self._simulated = _Known(np.zeros((0, N_DIMS)), np.zeros(0))
        self._surrogate: Surrogate | None = None
        tools, simulations = random_unit(schedule.initial_tools, initial), random_unit(80, initial)
        self._best: list[float] = []
        self._batch_means: list[float] = []
        if strategy.tools is not None:
            self._record(tools, initial)
        if strategy.simulations is not None:
            self._run_simulations(simulations[: schedule.initial_simulations])
        if strategy.n_night:
            self._spend_night(strategy.n_night)

    def _spend_night(self, n: int) -> None:
        """Simulate designs anywhere, then, in two parts, around the best simulated ones."""
        n_anywhere = n - 2 * (n // 5)
        self._run_simulations(random_unit(n_anywhere, self._rng))
        for _ in range(2):
            best = self._simulated.x[np.argsort(-self._simulated.y)[:_N_PARENTS]]
            parents = best[self._rng.integers(0, len(best), n // 5)]
            self._run_simulations(mutate(parents, self._rng.choice(_STEPS, n // 5), self._rng))

    def simulate(self) -> None:
        """The simulations of one round, in parts; the model is fitted once and updated between the parts."""
        rule = self._strategy.simulations or ""
        self._surrogate = self._fit()
        left = self._schedule.simulations_per_round
        while left > 0:
            n = min(left, self._schedule.simulations_at_once)
            self._run_simulations(self._propose(rule, SIM, n))
            self._surrogate = self._surrogate.updated(self.data())
            left -= n

    def measure(self) -> None:
        """One round of tools."""
        rule = self._strategy.tools or ""
        self._surrogate = None if rule == "random" else self._fit()
        if self._surrogate is not None and self._strategy.is_log:
            self._surrogate = trust_simulations(self._surrogate)
        self._record(self._propose(rule, REAL, self._schedule.tools_per_round), self._rng)

    def verify(self) -> None:
        """Measure the designs with the best simulated forces."""
        order = np.argsort(-self._simulated.y)
        self._record(self._simulated.x[order[: self._schedule.tools_per_round]], self._rng)

    def result(self, seed: int) -> LandscapeRun:
        """What was reached."""
        return LandscapeRun(
            landscape=self._landscape.name,
            strategy=self._strategy.name,
            seed=seed,
            optimum_n=self._landscape.best_n,
            best_n=tuple(self._best),
            batch_mean_n=tuple(self._batch_means),
            n_measured=len(self._tools.y),
            n_simulated=len(self._simulated.y),
            schedule=self._schedule,
        )

    def _propose(self, rule: str, fidelity: int, n: int) -> np.ndarray:
        # Simulation alone is its own target: its outcomes stand in the model's place of the real ones.
        stands_for = REAL if rule == "ei" else fidelity
        proposals = propose(
            self._surrogate,
            stands_for,
            n,
            NO_PENDING,
            self._rng,
            Rule(acquisition=rule, n_best=self._strategy.n_best if fidelity == REAL else 0),
            Room(min_distance=0.05 if fidelity == REAL else 0.0),
        )
        return to_unit([proposal.design for proposal in proposals])

    def _fit(self) -> Surrogate:
        return fit_surrogate(self.data(), self._surrogate.parameters if self._surrogate else None)

    def data(self) -> ObservationSet:
        """What is known."""
        x = np.concatenate([self._simulated.x, self._tools.x])
        y = np.concatenate([self._simulated.y, self._tools.y])
        simulated_as = SIM if self._strategy.tools is not None else REAL
        s = np.repeat([simulated_as, REAL], [len(self._simulated.y), len(self._tools.y)])
        data = ObservationSet(x, s, y, np.zeros(len(y)))
        return data.in_logs() if self._strategy.is_log else data

    def _run_simulations(self, x: np.ndarray) -> None:
        self._simulated.add(x, self._landscape.simulators[self._strategy.simulator](x))

    def _record(self, x: np.ndarray, rng: np.random.Generator) -> None:
        true_n = self._landscape.real(x)
        self._tools.add(x, self._landscape.measure(x, rng))
        self._best.append(max([float(true_n.max()), *self._best[-1:]]))
        self._batch_means.append(float(true_n.mean()))
