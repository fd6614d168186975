"""Asking on made-up worlds whose effect is known: promised against needed grasps, chosen against random settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables
from models.gap.ask.answers import Answers
from models.gap.ask.choose import ENOUGH_NATS, Costs, choose_experiments
from models.gap.ask.forecast import weigh
from models.gap.ask.hypotheses import Hypothesis
from models.gap.ask.predict import Pair, forecast_pairs
from models.gap.ask.settings import list_settings
from models.gap.data import GapData
from models.gap.fit.recalibrate import Fitter, recalibrate
from models.records import EffectValue
from tests.synthetic.gap import GapTruth, made_up_answers, made_up_gap

N_TOOLS, N_OBJECTS = 6, 6
CELLS = tuple((tool, obj) for tool in (0, 2, 4) for obj in (0, 2, 4))
MOST_PAIRS = 30
_UNKNOWN, _SIZE = 0.1, 0.03
# Members of confusable sets, each the truth in turn.
SETS: tuple[tuple[EffectValue, ...], ...] = (
    (
        EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.1}),
        EffectValue(effect="lift_misalignment", parameters={"shift_mm": 0.5}),
        EffectValue(effect="lift_start_error", parameters={"backlash_mm": 0.3, "ramp_s": 0.1}),
    ),
    (
        EffectValue(effect="stress_relaxation", parameters={"relaxed_share": 0.08, "time_constant_s": 5.0}),
        EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.85, "slip_scale_mm": 3.0}),
    ),
)


@dataclass(frozen=True, eq=False)
class _World:
    """A bench whose truth is known, and the hypotheses that its ordinary grasps leave."""

    data: GapData
    truth: EffectValue
    seed: int
    hypotheses: tuple[Hypothesis, ...]

    @staticmethod
    def of(members: Sequence[EffectValue], truth: EffectValue, seed: int) -> "_World":
        data = made_up_gap(N_TOOLS, N_OBJECTS, seed, GapTruth(effects=(truth,)), n_repeats=2)
        base = recalibrate(data.training)
        fits = [Fitter(base.features, base.theta, [value]).fit() for value in members]
        share = (1.0 - _UNKNOWN) / len(members)
        named = [Hypothesis(value.effect, share, fit) for value, fit in zip(members, fits, strict=True)]
        unknown = [Hypothesis("unknown", 0.5 * _UNKNOWN, base, size) for size in (0.0, _SIZE)]
        return _World(data, truth, seed, (*named, *unknown))

    def answer(self, made: Mapping[Pair, int]) -> Answers:
        return made_up_answers(self.data, self.seed, GapTruth(effects=(self.truth,)), made)

    def count_needed(self, order: Sequence[Pair]) -> tuple[int, str]:
        """Pairs, made in this order, until the best effect leads the next by enough, and which it is."""
        counts = {pair: order.count(pair) for pair in dict.fromkeys(order)}
        outcomes = self.answer(counts).experiments
        pairs = list(counts)
        forecast = forecast_pairs(self.hypotheses, pairs)
        names = [one.name for one in self.hypotheses if one.own]
        best = ""
        for n in range(1, len(order) + 1):
            seen = [outcomes[pair][: order[:n].count(pair)] for pair in pairs]
            likelihood = weigh(forecast, seen)[: len(names)]
            first, second = np.sort(likelihood)[::-1][:2]
            best = names[int(np.argmax(likelihood))]
            if first - second >= ENOUGH_NATS:
                return n, best
        return len(order), best


def measure_asking(options: Options) -> Tables:
    """How many pairs of grasps an answer takes, as promised, as chosen and at random."""
    rows: Rows = []
    for seed in range(options.worlds or 2):
        for members in SETS:
            for truth in members:
                rows.append(_ask(_World.of(members, truth, seed)))
                options.tell(f"{truth.effect}, world {seed}: {rows[-1]}")
    return {"asking": [_summarise(rows)], "worlds": rows}


def _ask(world: _World) -> dict[str, object]:
    base = world.data.grasps.base_setup
    settings = [one for one in list_settings(base) if one.is_timing]
    pairs = [Pair(*cell, one) for cell in CELLS for one in settings]
    forecast = forecast_pairs(world.hypotheses, pairs)
    counts = choose_experiments(forecast, _costs(pairs), MOST_PAIRS).counts
    plan = [pairs[place] for place in np.flatnonzero(counts) for _ in range(counts[place])]
    rng = np.random.default_rng([world.seed, 7])
    needed, chosen_says = world.count_needed([plan[k % len(plan)] for k in range(MOST_PAIRS)]) if plan else (0, "")
    random = [pairs[int(place)] for place in rng.integers(len(pairs), size=MOST_PAIRS)]
    at_random, _ = world.count_needed(random)
    return {
        "truth": world.truth.effect,
        "seed": world.seed,
        "promised_pairs": int(counts.sum()),
        "needed_pairs": needed,
        "random_pairs": at_random,
        "says": chosen_says if needed < MOST_PAIRS else "",
        "is_right": needed < MOST_PAIRS and chosen_says == world.truth.effect,
        "is_wrong": needed < MOST_PAIRS and chosen_says != world.truth.effect,
    }


def _costs(pairs: Sequence[Pair]) -> Costs:
    """A pair is a minute, and its dwell and slow lift on top."""
    minutes = [1.0 + pair.setting.setup.dwell_s / 60.0 + 1.0 / pair.setting.setup.lift_speed_mm_per_s for pair in pairs]
    cells = np.array([10 * pair.tool + pair.obj for pair in pairs])
    return Costs(np.array(minutes), np.array([pair.tool for pair in pairs]), cells, 0.5)


def _summarise(rows: Rows) -> dict[str, object]:
    promised, needed, random = (
        np.array([row[name] for row in rows], dtype=float)
        for name in ("promised_pairs", "needed_pairs", "random_pairs")
    )
    is_made = promised > 0
    return {
        "worlds": len(rows),
        "asked": int(is_made.sum()),
        "right": sum(bool(row["is_right"]) for row in rows),
        "wrong": sum(bool(row["is_wrong"]) for row in rows),
        "median_needed_grasps": float(2 * np.median(needed[is_made])),
        "needed_within_1.5_of_promised": float((needed <= 1.5 * promised)[is_made].mean()),
        "median_random_grasps": float(2 * np.median(random[is_made])),
        "chosen_over_random": float(needed[is_made].sum() / random[is_made].sum()),
    }
