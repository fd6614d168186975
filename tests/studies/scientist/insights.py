"""Whether what a campaign says that it has taught is so, on landscapes whose truth is known.

Every race of a landscape is stopped after each batch and asked: effects of parameters and their intervals, the chance
that the next batch is worth it, the simplest finger that is as good. The landscape knows the answers.
"""

import time
from collections.abc import Iterable, Sequence
from functools import lru_cache, partial
from itertools import product
from pathlib import Path

import numpy as np

from fast.models.blas import one_blas_thread
from fast.models.design.printability import estimate_mass_g
from fast.models.design.space import BEST_PUBLISHED, FIN_RAYS
from fast.models.ids import seed_from
from fast.models.records import Record
from fast.models.scientist.insights.cards import list_that_matter
from fast.models.scientist.insights.effects import (
    Grid,
    Interval,
    find_disagreements,
    find_effects,
    find_pairs,
    sobol_indices,
)
from fast.models.scientist.insights.rules import IN_A_ROW, MARGIN, STOP_CHANCE
from fast.models.scientist.insights.simplest import LOSS, find_simpler
from fast.models.scientist.insights.stopping import BatchPlan, look_ahead
from fast.models.scientist.insights.worlds import Worlds, widening
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_simulations
from fast.models.scientist.surrogate.observations import REAL, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from tests.studies.benchmarks.base import Options, Rows, Tables, timed
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.benchmarks.scientist import made_up_data
from tests.studies.landscapes.bank import LandscapeBank
from tests.studies.landscapes.landscape import Landscape, read_landscape
from tests.studies.landscapes.run import RunSchedule, run_strategy
from tests.studies.landscapes.strategies import LANDSCAPE_STRATEGIES

BANK = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "landscapes.json"
MEASURED, HYBRID = "log measured only", "hybrid, MES"
N_SEEDS = {MEASURED: 20, HYBRID: 4}
EXPLAINED = (0, 3, 8)  # batches after which effects and simplest fingers are asked for, a seed each: 30, 60, 110 tools
N_TRUE = 512  # fingers that true effects are averaged over
BINS = (0.0, 0.1, 0.4, 0.8, 1.0)  # of chances


class Answer(Record):
    """A number that was said, with its interval, and the true one."""

    kind: str
    n_tools: int
    said: Interval
    true: float

    @property
    def is_held(self) -> bool:
        """Whether the interval holds the truth."""
        return self.said.low <= self.true <= self.said.high


class Taught(Record):
    """What a race was asked and what is true.

    best_n: largest true force so far, after the first tools and each batch. chances, gains_n: said before each batch.
    simpler: (criterion, true share of the best finger's force). matter: (tools, place among all parameters by the true
    share of the variance, from 0) of the first two that are said to matter.
    """

    landscape: str
    strategy: str
    seed: int
    best_n: tuple[float, ...]
    chances: tuple[float, ...]
    gains_n: tuple[float, ...]
    widened: tuple[float, ...]
    answers: tuple[Answer, ...]
    simpler: tuple[tuple[str, float], ...]
    matter: tuple[tuple[int, int], ...]
    cpu_s: float


def measure_insights(options: Options) -> Tables:
    """Effects, advice to stop and simplest fingers against the truth of landscapes; --n seeds at most.

    When the time is up, the tables are of the races that are known by then.
    """
    known = {_key(one): one for one in read_records(options.results, Taught, "race of the insights")}
    bank = LandscapeBank.read(BANK)
    races = [
        (number, name, seed)
        for seed in range(options.n or max(N_SEEDS.values()))
        for name, n in N_SEEDS.items()
        if seed < n
        for number in range(len(bank.truths))
    ]
    started = time.monotonic()
    with RecordFile(options.results) as file:
        for done, (number, name, seed) in enumerate(races):
            key = bank.landscape_name(number), name, seed
            if key in known:
                continue
            if time.monotonic() - started >= 60.0 * options.limit_minutes:
                options.tell(f"the time is up; {len(known)} of {len(races)} races are known, the tables are of these")
                break
            known[key] = ask_race(number, name, seed)
            file.append(known[key])
            options.tell(f"{done + 1} of {len(races)}: {key[0]}, {name}, seed {seed}: {known[key].cpu_s:.1f} s")
    found = list(known.values())
    return {
        "effects": effect_rows(found),
        "matter": matter_rows(found),
        "chances": chance_rows(found),
        "stopping": stopping_rows(found),
        "simplest": simplest_rows(found),
        "cost": cost_rows(),
    }


def ask_race(number: int, name: str, seed: int) -> Taught:
    """Run a race and ask after each batch."""
    landscape, start = read_landscape(BANK, number), time.process_time()
    asked = _Asked(number, landscape, seed, np.random.default_rng(seed_from("insights", number, name, seed)))
    with one_blas_thread():
        run = run_strategy(landscape, LANDSCAPE_STRATEGIES[name], RunSchedule(), seed, asked.ask)
    return Taught(
        landscape=landscape.name,
        strategy=name,
        seed=seed,
        best_n=run.best_n,
        chances=tuple(asked.chances[:-1]),
        gains_n=tuple(asked.gains_n[:-1]),
        widened=tuple(asked.widened),
        answers=tuple(asked.answers),
        simpler=tuple(asked.simpler),
        matter=tuple(asked.matter),
        cpu_s=round(time.process_time() - start, 2),
    )


class _Asked:
    def __init__(self, number: int, landscape: Landscape, seed: int, rng: np.random.Generator) -> None:
        self._number, self._landscape, self._rng = number, landscape, rng
        self._explained = EXPLAINED[(seed + number) % len(EXPLAINED)]
        self.chances: list[float] = []
        self.gains_n: list[float] = []
        self.widened: list[float] = []
        self.answers: list[Answer] = []
        self.simpler: list[tuple[str, float]] = []
        self.matter: list[tuple[int, int]] = []

    def ask(self, data: ObservationSet) -> None:
        surrogate = fit_surrogate(data)
        if data.is_log:
            surrogate = trust_simulations(surrogate)
        worlds = Worlds.draw(surrogate, self._rng)
        outlook = look_ahead(worlds, FIN_RAYS, BatchPlan(RunSchedule().tools_per_round, n_ahead=1), self._rng)
        if len(self.chances) == self._explained:
            self._explain(worlds)
        self.widened.append(widening(surrogate))
        self.chances.append(outlook.chance)
        self.gains_n.append(outlook.ahead[0].gain_n)

    def _explain(self, worlds: Worlds) -> None:
        surrogate = worlds.surrogate
        x = surrogate.data.x[surrogate.data.s == REAL]
        best, n = x[np.argmax(surrogate.mean(x, REAL))], len(x)
        grid = Grid.of(FIN_RAYS, self._rng)
        effects = find_effects(worlds, FIN_RAYS, best, grid)
        names, ends = list(FIN_RAYS.names), {}
        places = true_order(self._number)
        self.matter += [(n, places.index(names.index(one.parameter))) for one in list_that_matter(effects)[:2]]
        for effect in effects:
            column = names.index(effect.parameter)
            ends[effect.parameter] = [grid.levels[column][p] for p in (effect.worst_level, effect.best_level)]
            low, high = (true_mean(self._number, ((column, end),)) for end in ends[effect.parameter])
            self.answers.append(Answer(kind="main", n_tools=n, said=effect.size, true=high - low))
        for pair in find_pairs(worlds, effects, grid, n_drawn=0):
            columns = names.index(pair.first), names.index(pair.second)
            levels = product(ends[pair.first], ends[pair.second])
            a, b, c, d = (true_mean(self._number, tuple(zip(columns, two, strict=True))) for two in levels)
            self.answers.append(Answer(kind="pair", n_tools=n, said=pair.change, true=(d - b) - (c - a)))
        for one in find_simpler(worlds, FIN_RAYS, best, self._rng, default=BEST_PUBLISHED):
            forces = self._landscape.real(np.array([one.point, best]))
            self.simpler.append((one.criterion, float(forces[0] / forces[1])))


@lru_cache(maxsize=100_000)
def true_mean(number: int, changes: tuple[tuple[int, float], ...]) -> float:
    """True mean force over fingers spread over the space with some parameters (place, level) set."""
    grid = Grid.of(FIN_RAYS, np.random.default_rng(N_TRUE), N_TRUE)
    return float(read_landscape(BANK, number).real(grid.with_level(changes)).mean())


@lru_cache(maxsize=100)
def true_order(number: int) -> list[int]:
    """Parameters by their true share of the variance between fingers with all that they change in others (Sobol')."""
    landscape, grid = read_landscape(BANK, number), Grid.of(FIN_RAYS, np.random.default_rng(N_TRUE), N_TRUE)
    totals = []
    for column, levels in enumerate(grid.levels):
        table = np.array([landscape.real(grid.with_level([(column, level)])) for level in levels])
        totals.append(float(sobol_indices(table[:, :, None], bool(FIN_RAYS.n_levels[column]))[1][0]))
    return np.argsort(-np.array(totals)).tolist()


def effect_rows(found: Sequence[Taught]) -> Rows:
    """How often intervals hold the truth, by kind, strategy and number of tools."""
    rows = []
    for kind in ("main", "pair"):
        for name in (*N_SEEDS, "all"):
            races = [race for race in found if name in (race.strategy, "all")]
            answers = [answer for race in races for answer in race.answers if answer.kind == kind]
            if not answers:
                continue
            for n in (*sorted({answer.n_tools for answer in answers}), "all"):
                some = [answer for answer in answers if n in (answer.n_tools, "all")]
                rows.append(
                    {
                        "effect": kind,
                        "strategy": name,
                        "tools": n,
                        "n": len(some),
                        "held": float(np.mean([answer.is_held for answer in some])),
                        "half_width_n": float(np.median([(a.said.high - a.said.low) / 2 for a in some])),
                        "true_n": float(np.median([abs(a.true) for a in some])),
                    }
                )
    return rows


def matter_rows(found: Sequence[Taught]) -> Rows:
    """How often the first two parameters that are said to matter are among the first three in truth."""
    told = np.array([one for race in found for one in race.matter]).reshape(-1, 2)
    rows = []
    for n in sorted(set(told[:, 0].tolist())):
        places = told[told[:, 0] == n, 1]
        rows.append({"tools": n, "named": len(places), "first_three": float(np.mean(places < 3))})
    return rows


def chance_rows(found: Sequence[Taught]) -> Rows:
    """Chances that were said against how often the next batch was worth it."""
    said, came = _said_and_came(found)
    rows = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        is_in = (said >= low) & ((said < high) | (high == BINS[-1]))
        rows.append(
            {
                "chance": f"{low:.0%} to {high:.0%}",
                "n": int(is_in.sum()),
                "said": float(said[is_in].mean()) if is_in.any() else None,
                "came": float(came[is_in].mean()) if is_in.any() else None,
            }
        )
    return rows


def stopping_rows(found: Sequence[Taught]) -> Rows:
    """What stopping by itself loses and saves."""
    rows = []
    for name in (*N_SEEDS, "all"):
        races = [race for race in found if name in (race.strategy, "all")]
        if not races:
            continue
        loss, saved = zip(*map(stop, races), strict=True)
        rows.append(
            {
                "strategy": name,
                "races": len(races),
                "stopped": float(np.mean(np.array(saved) > 0)),
                "loss": float(np.mean(loss)),
                "loss_p90": float(np.quantile(loss, 0.9)),
                "prints_saved": float(np.mean(saved)),
            }
        )
    return rows


def stop(race: Taught) -> tuple[float, float]:
    """Loss of the final force, and share of the prints that are saved, when the race stops by itself."""
    schedule = RunSchedule()
    below = [chance < STOP_CHANCE for chance in race.chances]
    ends = (n for n in range(IN_A_ROW - 1, len(below)) if all(below[n - IN_A_ROW + 1 : n + 1]))
    end = next(ends, len(below))  # batches that are printed
    n_all = schedule.initial_tools + schedule.rounds * schedule.tools_per_round
    saved = (len(below) - end) * schedule.tools_per_round / n_all
    return 1.0 - race.best_n[end] / race.best_n[-1], saved


def simplest_rows(found: Sequence[Taught]) -> Rows:
    """How often a finger that is said to be as good is, by criterion."""
    all_of = [one for race in found for one in race.simpler]
    rows = []
    for name in (*dict.fromkeys(criterion for criterion, _ in all_of), "all"):
        shares = np.array([share for criterion, share in all_of if name in (criterion, "all")])
        if not len(shares):
            continue
        as_good = float(np.mean(shares >= 1.0 - LOSS))
        rows.append({"simplest": name, "n": len(shares), "as_good": as_good, "share": float(np.median(shares))})
    return rows


def cost_rows() -> Rows:
    """CPU of all cards at the paper's size."""
    data = made_up_data(110, 1000)
    estimate_mass_g(BEST_PUBLISHED)  # imports what it takes
    with one_blas_thread():
        surrogate, fit_s = timed(partial(fit_surrogate, data))
        _, cards_s = timed(partial(_all_cards, surrogate))
    return [{"n_real": 110, "n_sim": 1000, "fit_cpu_s": fit_s, "cards_cpu_s": cards_s, "cpu_s": fit_s + cards_s}]


def _all_cards(surrogate: Surrogate) -> None:
    rng = np.random.default_rng(0)
    worlds, grid = Worlds.draw(surrogate, rng), Grid.of(FIN_RAYS, rng)
    best = surrogate.data.x[-1]
    effects = find_effects(worlds, FIN_RAYS, best, grid)
    find_pairs(worlds, effects, grid)
    find_disagreements(worlds, effects, grid)
    look_ahead(worlds, FIN_RAYS, BatchPlan(10, n_night=100), rng)
    find_simpler(worlds, FIN_RAYS, best, rng, default=BEST_PUBLISHED)


def _said_and_came(found: Iterable[Taught]) -> tuple[np.ndarray, np.ndarray]:
    pairs = [
        (chance, race.best_n[n + 1] >= (1.0 + MARGIN) * race.best_n[n])
        for race in found
        for n, chance in enumerate(race.chances)
    ]
    said, came = np.array(pairs, dtype=float).T
    return said, came


def _key(race: Taught) -> tuple[str, str, int]:
    return race.landscape, race.strategy, race.seed
