"""Health of a campaign as cards: a rule for each colour, and what to do. The one place that says it.

What each number is stands in `HealthFacts`; the limits stand above the rule that uses them.
"""

from collections.abc import Sequence

from fast.models.records import Record
from fast.models.scientist.insights.cards import Card, Tone
from fast.models.scientist.surrogate.health import LEAST_GAIN, LEAST_Q2, OUTLIER_SD, SurrogateHealth, is_overconfident
from fast.models.units import spell_share

GOOD_Q2 = 0.6  # of the variance between tools that is predicted
REPEATS = (0.25, 0.5)  # of the spread between tools: error of a tool's quality from its repeats
DRIFT = (0.05, 0.1)  # change of a tool that was measured again
DECIDES = (0.3, 0.5)  # of the variance between tools: what one object has a part in
OFF_MM = (0.1, 0.2)  # walls off their drawing
FAILED = (0.02, 0.1)  # share of grasps
FEWEST_TOOLS = 4  # below it a spread between tools says nothing


class HealthFacts(Record):
    """What the lake says of a campaign's health; None where it does not know."""

    campaign_id: str
    """Of the campaign."""
    surrogate: SurrogateHealth | None = None
    """Its own errors; None before there is one."""
    n_tools: int = 0
    """With a valid grasp."""
    repeats_share: float | None = None
    """Median standard error of a tool's quality from its repeats, over the spread (SD) between tools."""
    drift: float | None = None
    """Largest relative change of a tool that was measured again."""
    drift_tool: str | None = None
    """Id of that tool."""
    object_share: float | None = None
    """Part of the variance of the outcome that one object has, the largest of all."""
    object_name: str | None = None
    """Of that object."""
    n_objects: int = 0
    """Among which it is the largest."""
    off_mm: float | None = None
    """Median distance of measured walls from the drawing."""
    n_walls_measured: int = 0
    """Tools whose walls were measured."""
    n_grasps: int = 0
    """Attempts, failed ones too."""
    n_failed: int = 0
    """Of them."""


def health_cards(facts: HealthFacts) -> tuple[Card, ...]:
    """Make all cards that the facts allow, red ones first."""
    cards = [*surrogate_cards(facts.surrogate, facts.campaign_id)] if facts.surrogate is not None else []
    rules = (_repeats, _drift, _objects, _walls, _failures)
    cards += [card for card in (rule(facts) for rule in rules) if card is not None]
    return tuple(sorted(cards, key=lambda card: ("red", "yellow", "green").index(card.tone or "green")))


def worst_of(cards: Sequence[Card]) -> Tone:
    """Return red where one is, else yellow where one is, else green."""
    tones = {card.tone for card in cards}
    return "red" if "red" in tones else "yellow" if "yellow" in tones else "green"


def surrogate_cards(health: SurrogateHealth, campaign_id: str) -> tuple[Card, ...]:
    """Say what the surrogate's own errors say: of it, of the simulator, of prior campaigns."""
    rules = (_prediction, _confidence, _outliers)
    cards = [rule(health) for rule in rules] + [_simulator(health, campaign_id), _prior(health)]
    return tuple(card for card in cards if card is not None)


def _prediction(health: SurrogateHealth) -> Card | None:
    q2 = health.loo_q2
    if q2 is None or health.n_real < FEWEST_TOOLS:
        return None
    tone: Tone = "green" if q2 >= GOOD_Q2 else "yellow" if q2 >= LEAST_Q2 else "red"
    sentence = (
        f"Each tool is predicted from all others, {health.loo_rmse_n:.2f} N off: {spell_share(max(q2, 0.0))} of the "
        "differences between them is explained."
    )
    step = {
        "green": "",
        "yellow": "Proposals are rough; print another batch before you trust an effect.",
        "red": "The next tools are close to guesses; look at the scatter of repeats, or print random designs.",
    }[tone]
    return _card("left-out tools", tone, sentence, step)


def _confidence(health: SurrogateHealth) -> Card | None:
    coverage = health.loo_coverage_90
    if coverage is None or not is_overconfident(coverage, health.n_real):
        return None
    return _card(
        "confidence",
        "red",
        f"The surrogate is overconfident: {spell_share(coverage)} of {health.n_real} measured designs lie in their "
        "90 % interval.",
        "Expect surprises, and look for outliers among the tools.",
    )


def _outliers(health: SurrogateHealth) -> Card | None:
    if not health.n_outliers:
        return None
    return _card(
        "outliers",
        "yellow",
        f"{health.n_outliers} of {health.n_real} measured designs lie more than {OUTLIER_SD:g} standard deviations "
        "from what all others predict.",
        "Look at these tools and their traces before the next batch.",
    )


def _simulator(health: SurrogateHealth, campaign_id: str) -> Card | None:
    gain = health.simulation_gain
    if gain is None:
        return None
    tone: Tone = "green" if gain >= LEAST_GAIN else "yellow" if gain >= 0.0 else "red"
    what = "Simulation is informative" if tone == "green" else "Simulation is not informative"
    rule = f"; it has to be {spell_share(LEAST_GAIN)} less at least" if tone == "yellow" else ""
    sentence = (
        f"{what}: with it the error at measured designs is {health.loo_rmse_n:.2f} N, without it "
        f"{health.measured_only_loo_rmse_n:.2f} N{rule}."
    )
    step = (
        ""
        if tone == "green"
        else f"Find what the simulator lacks: fast gap --campaign {campaign_id}; then calibrate it."
    )
    return _card("simulator", tone, sentence, step)


def _prior(health: SurrogateHealth) -> Card | None:
    gain = health.prior_gain
    if gain is None:
        return None
    return _card(
        "prior campaigns",
        "green" if gain > 0 else "yellow",
        f"{health.n_prior} tools of prior campaigns {'help' if gain > 0 else 'do not help'}: with them the error at "
        f"measured designs is {health.loo_rmse_n:.2f} N, without them {health.without_prior_loo_rmse_n:.2f} N.",
        "" if gain > 0 else "Take them out of scientist.prior_campaigns.",
    )


def _repeats(facts: HealthFacts) -> Card | None:
    if facts.repeats_share is None or facts.n_tools < FEWEST_TOOLS:
        return None
    return _by_limits(
        "repeats",
        facts.repeats_share,
        REPEATS,
        f"Repeats of grasps leave a tool's quality uncertain by {spell_share(facts.repeats_share)} of the spread "
        "between tools.",
        "Raise objects.repeats, or find what scatters: fast features, and the placing of objects.",
    )


def _drift(facts: HealthFacts) -> Card | None:
    if facts.drift is None:
        return None
    return _by_limits(
        "drift",
        abs(facts.drift),
        DRIFT,
        f"Tool {facts.drift_tool}, measured again, holds {spell_share(abs(facts.drift))} "
        f"{'more' if facts.drift > 0 else 'less'} than at first.",
        "Look for worn fingers or a changed bench before you compare batches.",
    )


def _objects(facts: HealthFacts) -> Card | None:
    if facts.object_share is None or facts.n_tools < FEWEST_TOOLS or facts.n_objects < FEWEST_TOOLS:
        return None
    # Among few objects each has a large part.
    low, high = (max(limit, 2.0 * (1 + place) / facts.n_objects) for place, limit in enumerate(DECIDES))
    return _by_limits(
        "objects",
        facts.object_share,
        (low, high),
        f"{(facts.object_name or 'one object').capitalize()} has a part in {spell_share(facts.object_share)} of the "
        f"differences between tools, one of {facts.n_objects} objects.",
        "Look at its traces, or take `worst_peak_n` or `low_peak_n` for the objective: it should not decide alone.",
    )


def _walls(facts: HealthFacts) -> Card | None:
    if facts.off_mm is None:
        return None
    return _by_limits(
        "prints",
        facts.off_mm,
        OFF_MM,
        f"Walls are {facts.off_mm:.2f} mm off their drawing in the median (prints measured: {facts.n_walls_measured}).",
        "Calibrate the printer's flow; measured walls are what the surrogate learns from, so go on measuring them.",
    )


def _failures(facts: HealthFacts) -> Card | None:
    if not facts.n_grasps:
        return None
    share = facts.n_failed / facts.n_grasps
    return _by_limits(
        "failed grasps",
        share,
        FAILED,
        f"{facts.n_failed} of {facts.n_grasps} grasps failed.",
        "See why: the table of failures in the report, or fast features; then mend the bench before the next batch.",
    )


def _by_limits(name: str, value: float, limits: tuple[float, float], sentence: str, step: str) -> Card:
    tone: Tone = "green" if value < limits[0] else "yellow" if value < limits[1] else "red"
    return _card(name, tone, sentence, "" if tone == "green" else step)


def _card(name: str, tone: Tone, sentence: str, step: str) -> Card:
    return Card(topic="health", name=name, tone=tone, sentence=sentence, next_step=step)
