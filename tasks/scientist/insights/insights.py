"""What a campaign has taught so far, from the lake: effects by objective, the next batch, simpler fingers, health."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fast.models.blas import one_blas_thread
from fast.models.design.space import DesignSpace
from fast.models.objects.catalogue import get_object
from fast.models.records import Record
from fast.models.scientist.insights.cards import (
    BatchCost,
    Card,
    effect_card,
    gap_card,
    night_card,
    pair_card,
    simplest_card,
    stop_card,
    summary_card,
)
from fast.models.scientist.insights.classes import ClassEffects, find_class_effects
from fast.models.scientist.insights.effects import (
    LEAST_TOOLS,
    Disagreement,
    Effect,
    Grid,
    Pair,
    find_disagreements,
    find_effects,
    find_pairs,
)
from fast.models.scientist.insights.health import health_cards
from fast.models.scientist.insights.stopping import BatchPlan, Outlook, look_ahead
from fast.models.scientist.insights.worlds import Worlds
from fast.models.scientist.objectives import KNOWN, MEAN_PEAK, OUTCOMES, Outcome
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_prior, trust_simulations
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS, REAL
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.models.units import unit_of
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState
from fast.tasks.scientist.fit import in_units_of
from fast.tasks.scientist.insights.facts import read_cost, read_facts
from fast.tasks.scientist.observe import closed_batches, observe, observe_objects
from fast.tasks.scientist.simpler import SimplerFinger, best_measured_point, find_simpler_fingers

_N_PAIR_CARDS = 2
_N_NIGHT = 100  # simulations of a night, where the schedule has none


class OutcomeEffects(Record):
    """Effects on one objective."""

    outcome: str
    """Its name, with its unit."""
    n_tools: int
    """Measured ones that the surrogate has."""
    best: float
    """Outcome of the best measured finger, by the surrogate."""
    slice_of: Mapping[str, Any]
    """That finger, by parameter."""
    effects: tuple[Effect, ...]
    """The largest share of the variance first."""
    pairs: tuple[Pair, ...]
    """Those that change each other most first; none below `LEAST_TOOLS`."""
    disagreements: tuple[Disagreement, ...] = ()
    """Effects of which the simulator says something else than the bench."""
    classes: tuple[ClassEffects, ...] = ()
    """Effects by class of object; of the mean peak alone."""


class Insights(Record):
    """All that is said of a campaign; `cards` say it in sentences, the most urgent first."""

    campaign_id: str
    n_tools: int
    cards: tuple[Card, ...]
    outcomes: tuple[OutcomeEffects, ...] = ()
    outlook: Outlook | None = None
    cost: BatchCost | None = None
    simpler: tuple[SimplerFinger, ...] = ()


def find_insights(campaign: Campaign) -> Insights:
    """Find all that the measured batches of a campaign have taught; takes seconds of CPU, writes nothing."""
    with one_blas_thread():
        return _Gathering(campaign, campaign.state()).insights()


class _Gathering:
    """The parts, each asked of the lake once."""

    def __init__(self, campaign: Campaign, state: CampaignState) -> None:
        self._campaign, self._state = campaign, state
        self._closed = closed_batches(campaign, state)
        self._space: DesignSpace = campaign.space
        self._rng = np.random.default_rng(campaign.seed("insights", max(self._closed, default=0)))

    def insights(self) -> Insights:
        campaign_id = self._campaign.campaign_id
        wanted = [name for name in self._campaign.config.scientist.objectives if name not in KNOWN]
        fits = {name: self._fit(OUTCOMES[name]) for name in wanted}
        first = fits.get(MEAN_PEAK.name) or next((fit for fit in fits.values() if fit is not None), None)
        health = health_cards(read_facts(self._campaign, self._state, fits.get(MEAN_PEAK.name)))
        n_tools = 0 if first is None else first.data.n_real
        if first is None or n_tools < MIN_OBSERVATIONS:
            waiting = Card(topic="effect", name="effects", sentence=_too_few(n_tools))
            return Insights(campaign_id=campaign_id, n_tools=n_tools, cards=(waiting, *health))
        outcomes, cards = [], []
        worlds: dict[str, Worlds] = {}
        for name, surrogate in fits.items():
            if surrogate is not None and surrogate.data.n_real >= MIN_OBSERVATIONS:
                worlds[name] = Worlds.draw(self._trusted(surrogate), self._rng)
                found = self._explain(OUTCOMES[name], surrogate, worlds[name])
                outcomes.append(found)
                cards += self._cards_of(found)
        of_first = worlds.get(MEAN_PEAK.name) or next(iter(worlds.values()))
        outlook, cost = self._look_ahead(of_first), read_cost(self._campaign, self._state)
        simpler = find_simpler_fingers(self._campaign, of_first, self._rng)
        cards.append(stop_card(outlook, cost))
        cards += [card for card in (night_card(outlook),) if card is not None]
        cards += [simplest_card(one.finding) for one in simpler]
        ordered = sorted([*cards, *health], key=_urgency)
        return Insights(
            campaign_id=campaign_id,
            n_tools=n_tools,
            cards=tuple(ordered),
            outcomes=tuple(outcomes),
            outlook=outlook,
            cost=cost,
            simpler=tuple(simpler),
        )

    def _fit(self, outcome: Outcome) -> Surrogate | None:
        """Fit the surrogate of an outcome, with the simulations whether or not they help; None with too few data."""
        data = observe(self._campaign, self._state, self._closed, outcome)
        if len(data) < MIN_OBSERVATIONS:
            return None
        seed = self._campaign.seed("insights fit", outcome.name)
        return trust_prior(fit_surrogate(in_units_of(self._campaign, data), None, seed=seed), seed)

    def _trusted(self, surrogate: Surrogate) -> Surrogate:
        """Return the surrogate that tools are chosen with."""
        return trust_simulations(surrogate) if surrogate.data.is_log else surrogate

    def _explain(self, outcome: Outcome, surrogate: Surrogate, worlds: Worlds) -> OutcomeEffects:
        """Explain an outcome; worlds: of the surrogate that chooses tools; `surrogate` has the simulations anyway."""
        trusted, grid = worlds.surrogate, Grid.of(self._space, self._rng)
        best = best_measured_point(trusted)
        effects = find_effects(worlds, self._space, best, grid)
        is_enough = trusted.data.n_real >= LEAST_TOOLS
        with_both = worlds if trusted is surrogate else Worlds.draw(surrogate, self._rng)
        (design,) = self._space.from_unit(self._space.snap(best[None]))
        best_value = float(trusted.data.force_n(trusted.mean(best[None], REAL))[0])
        return OutcomeEffects(
            outcome=outcome.name,
            n_tools=trusted.data.n_real,
            best=best_value,
            slice_of=design.model_dump(),
            effects=tuple(effects),
            pairs=tuple(find_pairs(worlds, effects, grid)) if is_enough else (),
            disagreements=tuple(find_disagreements(with_both, effects, grid)) if is_enough else (),
            classes=tuple(self._by_class(trusted, effects, grid)) if is_enough and outcome is MEAN_PEAK else (),
        )

    def _by_class(self, surrogate: Surrogate, effects: list[Effect], grid: Grid) -> list[ClassEffects]:
        classes = [get_object(object_id).object_class for object_id in self._campaign.object_ids]
        if len(set(classes)) < 2:
            return []
        known = observe_objects(self._campaign, self._state, self._closed, MEAN_PEAK)
        known = known if surrogate.data.n_sim else known.take(known.s == REAL)
        is_log = surrogate.data.is_log
        return find_class_effects(known, classes, surrogate.parameters, is_log, effects, grid, self._rng)

    def _cards_of(self, found: OutcomeEffects) -> list[Card]:
        unit = unit_of(found.outcome) or ""
        summary = summary_card(found.effects, found.n_tools)
        cards = [gap_card(one, self._campaign.campaign_id) for one in found.disagreements]
        cards += [summary] if summary is not None else []
        cards += [effect_card(effect, found.best, found.n_tools, unit) for effect in found.effects]
        cards += [pair_card(pair, unit) for pair in found.pairs[:_N_PAIR_CARDS] if pair.change.is_sure]
        if len(self._campaign.config.scientist.objectives) == 1:
            return cards
        about = OUTCOMES[found.outcome].about
        return [card.model_copy(update={"name": f"{card.name} of {found.outcome}",
                                        "sentence": f"{card.sentence} (Of {about}.)"}) for card in cards]  # fmt: skip

    def _look_ahead(self, worlds: Worlds) -> Outlook:
        schedule = self._campaign.config.schedule
        open_tools = [
            tool.design
            for tool in self._state.tools
            if tool.batch not in self._closed and self._state.confirmed.get(tool.tool_id) != "rejected"
        ]
        n_night = schedule.simulations_per_batch or _N_NIGHT if worlds.surrogate.data.n_sim else 0
        plan = BatchPlan(
            n_tools=schedule.tools_per_batch,
            next_tools=self._space.to_unit(open_tools) if open_tools else None,
            n_night=min(n_night, _N_NIGHT),
        )
        return look_ahead(worlds, self._space, plan, self._rng, schedule.stop_margin)


_ORDER = {"gap": 0, "effect": 2, "pair": 3, "stop": 1, "simplest": 4, "health": 5}


def _urgency(card: Card) -> tuple[int, int]:
    """Put gaps first, then what to do, what matters, health; of health, red comes before all but gaps."""
    if card.tone == "red":
        return (0, 0) if card.topic == "gap" else (0, 1)
    return _ORDER[card.topic], 0


def _too_few(n_tools: int) -> str:
    return f"{n_tools} tools are measured; advice takes {MIN_OBSERVATIONS} at least, and an effect {LEAST_TOOLS}."
