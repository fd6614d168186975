"""Ask: from a round that leaves something open to the grasps, or the person's measurement, that would tell.

First what needs no simulation: other speeds, dwells and pressures, for which what was simulated serves. Only where they
do not promise enough are other strokes and placements simulated, a bounded number of them. Where no grasp tells, a
person is asked. Only the first is asked below the threshold of an alarm, since what two simulators differ by is the
same at every speed and cancels in the pair, but not where something else is simulated; and where an alarm excludes all
of the catalogue, since minutes of simulations, or a person's, are too much for effects that are out nine times in
ten.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.hardware.parts.limits import BenchLimits
from fast.hardware.station.cycle_time import plan_asked_minutes, plan_time
from fast.hardware.tools.mounted import MountedTool
from fast.models.gap.ask.answers import forecast_measurements
from fast.models.gap.ask.choose import Choice, Costs, choose_experiments, list_open_pairs
from fast.models.gap.ask.forecast import Forecast, compute_nats
from fast.models.gap.ask.hypotheses import Hypothesis, list_hypotheses
from fast.models.gap.ask.outcomes import MEANS, describe_pairs, describe_reading, join_outcomes
from fast.models.gap.ask.predict import Moved, Pair, forecast_pairs, predict_first
from fast.models.gap.ask.settings import Setting, list_settings
from fast.models.gap.findings import UNKNOWN, AskedGrasps, NextExperiment, PersonQuestion, Prediction, Promise
from fast.models.gap.grasps import Grasps
from fast.models.gap.naming.name import NamingResult
from fast.models.records import GraspRequest
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_minutes
from fast.tasks.gap.calibrate import SearchInputs
from fast.tasks.gap.moved import choose_cells, simulate_moved

_MOST_TOOLS, _MOST_OBJECTS = 5, 5  # of which every pair is looked at
FEWEST_GRASPS = 2  # a pair
_WORTH_NATS = 0.5  # promised less, two hypotheses are not said to fall apart


def ask(search: SearchInputs, naming: NamingResult, most_grasps: int) -> NextExperiment | None:
    """Ask what to do so that what a round leaves possible falls apart; None if nothing is open or nothing tells."""
    hypotheses = list_hypotheses(naming)
    if not hypotheses or most_grasps < FEWEST_GRASPS:
        return None
    grasps = naming.fit.features.surrogate.grasps
    plan = _Plan.of(hypotheses, grasps, list_timing_pairs(grasps), most_grasps)
    if not naming.alarm.is_raised or naming.named.possible == (UNKNOWN,):
        return plan.write(naming)
    if plan.open_effects:
        strokes = [one for one in _list_able(grasps) if not one.is_timing]
        cells = choose_cells(_spread_cells(grasps), hypotheses, strokes)
        pairs = [Pair(*cell, one) for cell in cells for one in strokes]
        moved = simulate_moved(search, hypotheses, pairs)
        known = [pair for pair in pairs if all((one.name, pair) in moved for one in hypotheses)]
        wider = _Plan.of(hypotheses, grasps, [*plan.pairs, *known], most_grasps, moved)
        plan = wider if wider.n_open < plan.n_open or not plan.choice.n else plan
    measured = () if search.answers is None else tuple(one.kind for one in search.answers.readings)
    person = _ask_person(hypotheses, plan, measured)
    return person if person is not None else plan.write(naming)


def list_requests(asked: Sequence[AskedGrasps]) -> list[GraspRequest]:
    """List the grasps in the order in which they are made: changed and usual ones in turn, either first in turn."""
    found = []
    number = 0
    for one in asked:
        for _ in range(one.n):
            number += 1
            changed = GraspRequest(
                tool_id=one.tool, object_id=one.object, setup=one.setup, placement=one.placement, purpose=one.setting
            )
            usual = GraspRequest(tool_id=one.tool, object_id=one.object, setup=one.usual, purpose="as usual")
            found += [usual, changed] if number % 2 else [changed, usual]
    return found


def plan_minutes(asked: Sequence[AskedGrasps], grasps: Grasps) -> float:
    """Compute how long the bench takes for what is asked of the tools of `grasps`."""
    return plan_asked_minutes(list_requests(asked), dict(zip(grasps.tools, grasps.designs, strict=True)))


@dataclass(frozen=True, eq=False)
class _Plan:
    """Pairs that could be made, their forecast, and those that were chosen of them."""

    hypotheses: tuple[Hypothesis, ...]
    grasps: Grasps
    pairs: list[Pair]
    forecast: Forecast
    choice: Choice

    @staticmethod
    def of(
        hypotheses: tuple[Hypothesis, ...],
        grasps: Grasps,
        pairs: list[Pair],
        most_grasps: int,
        moved: Moved | None = None,
    ) -> "_Plan":
        forecast = forecast_pairs(hypotheses, pairs, moved)
        choice = choose_experiments(forecast, estimate_costs(grasps, pairs), most_grasps // 2)
        return _Plan(hypotheses, grasps, pairs, forecast, choice)

    @property
    def open_effects(self) -> list[tuple[int, int]]:
        """Pairs of effects, or of an effect and nothing, that are not expected to fall apart.

        What is expected and not promised yet takes more of the same grasps, not another setting.
        """
        pairs = list_open_pairs(self.forecast, self.choice.expected)
        return [pair for pair in pairs if any(self.hypotheses[i].own for i in pair)]

    @property
    def n_open(self) -> int:
        """How many pairs of effects are left open."""
        return sum(all(self.hypotheses[i].own for i in pair) for pair in self.open_effects)

    def write(self, naming: NamingResult) -> NextExperiment | None:
        """Write what is asked of the bench; None if nothing is worth it."""
        places = sorted(np.flatnonzero(self.choice.counts), key=lambda at: (self.pairs[at].tool, self.pairs[at].obj))
        promised = self._list_promises()
        if not len(places) or not promised:
            return None
        counts = self.choice.counts
        asked = tuple(write_pair(self.grasps, self.pairs[place], int(counts[place])) for place in places)
        most = int(max(places, key=lambda place: counts[place]))
        outcomes = describe_pairs(self.hypotheses, self.forecast, most, int(counts[most]))
        words = list(dict.fromkeys(one.setting for one in asked))
        n, minutes = 2 * self.choice.n, plan_minutes(asked, self.grasps)
        return NextExperiment(
            grasps=asked,
            possible=_list_possible(self.hypotheses),
            separates=tuple(dict.fromkeys(name for promise in promised for name in promise.between)),
            promised_grasps=n,
            promised=promised,
            minutes=round(minutes, 1),
            sentence=(
                f"{n} grasps, about {spell_minutes(minutes)}: {'; '.join(words)}, each in turn with a "
                f"grasp as usual. {MEANS}{join_outcomes(outcomes)}."
            ),
            outcomes=outcomes,
            predictions=_predict(self.hypotheses, self.pairs[most], self.grasps),
        )

    def _list_promises(self) -> tuple[Promise, ...]:
        """List names promised to fall apart, the worst first; of forms of one hypothesis the worst counts."""
        nats: dict[tuple[str, str], float] = {}
        sharp = np.flatnonzero(self.forecast.is_sharp)
        for i in sharp:
            for j in sharp[sharp < i]:
                one, other = self.hypotheses[j].name, self.hypotheses[i].name
                if one != other and self.choice.nats[i, j] >= _WORTH_NATS:
                    nats[one, other] = min(nats.get((one, other), np.inf), float(self.choice.nats[i, j]))
        ordered = sorted(nats.items(), key=lambda item: item[1])
        return tuple(Promise(between=between, nats=round(value, 1)) for between, value in ordered)


def _ask_person(hypotheses: tuple[Hypothesis, ...], plan: _Plan, measured: Sequence[str]) -> NextExperiment | None:
    """Ask a person to measure where effects stay together in the plan for the bench; None if no reading tells more.

    A reading is made once, so what is expected of it counts, and no kind that was `measured` is asked for again.
    """
    open_pairs = [pair for pair in plan.open_effects if all(hypotheses[i].own for i in pair)]
    known, forecast = forecast_measurements(hypotheses)
    if not open_pairs or not known or plan.n_open < _count_pairs(hypotheses):
        return None
    nats = [compute_nats(forecast.select([place]), [1]).expected for place in range(len(known))]
    told = [
        sum(own[pair] >= _WORTH_NATS for pair in open_pairs) / one.minutes if one.kind not in measured else 0.0
        for own, one in zip(nats, known, strict=True)
    ]
    place = int(np.argmax(told))
    if not told[place]:
        return None
    one, promised = known[place], nats[place]
    outcomes = describe_reading(hypotheses, forecast, place, one.label)
    names = [hypotheses[i].name for pair in open_pairs for i in pair if promised[pair] >= _WORTH_NATS]
    promises = [
        Promise(between=(hypotheses[j].name, hypotheses[i].name), nats=round(float(promised[i, j]), 1))
        for i, j in open_pairs
        if promised[i, j] >= _WORTH_NATS
    ]
    order = f"No grasp of this bench tells. Please {one.words}"
    sentence = f"{order}. {MEANS}{join_outcomes(outcomes)}."
    return NextExperiment(
        possible=_list_possible(hypotheses),
        separates=tuple(dict.fromkeys(names)),
        promised_grasps=0,
        promised=tuple(sorted(promises, key=lambda promise: promise.nats)),
        minutes=one.minutes,
        sentence=sentence,
        outcomes=outcomes,
        person=PersonQuestion(kind=one.kind, sentence=sentence, label=one.label),
    )


def _count_pairs(hypotheses: Sequence[Hypothesis]) -> int:
    n = sum(bool(one.own) for one in hypotheses)
    return n * (n - 1) // 2


def write_pair(grasps: Grasps, pair: Pair, n: int) -> AskedGrasps:
    """Write what is asked for a pair that is made n times."""
    return AskedGrasps(
        tool=grasps.tools[pair.tool],
        object=grasps.objects[pair.obj],
        setup=pair.setting.setup,
        placement=pair.setting.placement,
        usual=grasps.base_setup,
        n=n,
        setting=pair.setting.words,
    )


def estimate_costs(grasps: Grasps, pairs: Sequence[Pair]) -> Costs:
    """Estimate the minutes of each pair and of a change of tool, as the bench's cycle time has them."""
    base, minutes, change_s = grasps.base_setup, [], 0.0
    known: dict[tuple[int, Setting], float] = {}
    tool = MountedTool(tool_id="asked", design=grasps.designs[0])
    for pair in pairs:
        key = pair.obj, pair.setting
        if key not in known:
            object_id = grasps.objects[pair.obj]
            items = [
                GraspRequest(tool_id="asked", object_id=object_id, setup=base),
                GraspRequest(tool_id="asked", object_id=object_id, setup=pair.setting.setup),
            ]
            time = plan_time(tool, 0, items, base)
            known[key], change_s = sum(time.item_s) / 60.0, time.tool_change_s
        minutes.append(known[key])
    n_objects = len(grasps.objects)
    return Costs(
        np.array(minutes),
        np.array([pair.tool for pair in pairs]),
        np.array([pair.tool * n_objects + pair.obj for pair in pairs]),
        change_s / 60.0,
    )


def list_timing_pairs(grasps: Grasps) -> list[Pair]:
    """List the pairs that could be made and need no simulation: at another speed, dwell or pressure."""
    timings = [one for one in _list_able(grasps) if one.is_timing]
    return [Pair(*cell, one) for cell in _spread_cells(grasps) for one in timings]


def _list_able(grasps: Grasps) -> list[Setting]:
    """List the settings that a bench can make."""
    return [one for one in list_settings(grasps.base_setup) if BenchLimits().can_make(one.setup, one.placement)]


def _spread_cells(grasps: Grasps) -> list[tuple[int, int]]:
    """Spread tools and objects of which pairs are looked at over those that were measured (and may be learnt from)."""
    made = sorted(set(zip(grasps.tool.tolist(), grasps.obj.tolist(), strict=True)))
    tools = _spread(sorted({tool for tool, _ in made}), _MOST_TOOLS)
    objects = _spread(sorted({obj for _, obj in made}), _MOST_OBJECTS)
    return [cell for cell in made if cell[0] in tools and cell[1] in objects]


def _spread(numbers: Sequence[int], most: int) -> list[int]:
    places = np.unique(np.linspace(0, len(numbers) - 1, min(most, len(numbers))).round().astype(int))
    return [numbers[place] for place in places]


def _list_possible(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one in hypotheses:
        found[one.name] = round(found.get(one.name, 0.0) + one.probability, 3)
    return found


def _predict(hypotheses: Sequence[Hypothesis], pair: Pair, grasps: Grasps) -> tuple[Prediction, ...]:
    """Predict what each effect, and nothing, gives of a pair's changed grasp; of *unknown* nobody knows."""
    if not pair.setting.is_timing:
        return ()
    return tuple(
        Prediction(effect=one.name, force_n=tuple(np.round(predict_first(one, pair), 3).tolist()))
        for one in hypotheses
        if one.name in CATALOGUE or one.name == "none"
    )
