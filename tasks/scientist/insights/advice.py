"""Advice whether to print on, kept in the lake after each batch, and a campaign that stops by itself."""

import json
from typing import TYPE_CHECKING

from fast.lake.order import LATEST_FIRST
from fast.lake.store import Lake
from fast.models.records import Record
from fast.models.scientist.insights.rules import IN_A_ROW, STOP_CHANCE
from fast.models.units import spell_chance, spell_share
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import tuples
from fast.tasks.scientist.observe import closed_batches

if TYPE_CHECKING:
    from fast.tasks.scientist.insights.insights import Insights

ADVICE = "advice"  # kind of events
_SAID = f"""
    SELECT payload_json FROM events WHERE campaign_id = $campaign AND kind = '{ADVICE}'
    ORDER BY {LATEST_FIRST}, event_id DESC
"""


class Advice(Record):
    """What was said after a batch: the chance that the next one is worth it, and the sentence for people.

    after_batch: the newest closed batch that it knew. tone: the worst colour of the health cards.
    """

    after_batch: int
    chance: float
    sentence: str
    health: str
    tone: str

    @property
    def is_end(self) -> bool:
        """Whether the chance is so low that a campaign ends by itself, if it stays so."""
        return self.chance < STOP_CHANCE


def note_advice(campaign: Campaign) -> Advice | None:
    """Say what the closed batches have taught, and keep it; None where nobody wants advice, or nothing is measured.

    Said once after each batch, however often it is asked for.
    """
    if campaign.config.schedule.stop == "never":
        return None
    closed = closed_batches(campaign, campaign.state())
    said = read_advice(campaign.lake, campaign.campaign_id)
    if not closed or (said and said[0].after_batch >= closed[-1]):
        return said[0] if said else None
    from fast.tasks.scientist.insights.insights import find_insights  # the status only reads what was said

    found = find_insights(campaign)
    if found.outlook is None:
        return None
    advice = make_advice(found, closed[-1])
    append_event(campaign.lake, campaign.campaign_id, ADVICE, advice.sentence, **advice.model_dump())
    return advice


def make_advice(found: "Insights", after_batch: int) -> Advice:
    """Make the advice of what was found."""
    from fast.models.scientist.insights.health import worst_of

    assert found.outlook is not None
    stop = next(card for card in found.cards if card.name == "next batch")
    health = [card for card in found.cards if card.topic == "health"]
    bad = [card for card in health if card.tone != "green"]
    return Advice(
        after_batch=after_batch,
        chance=found.outlook.chance,
        sentence=f"{stop.next_step} {stop.sentence}",
        health=bad[0].sentence if bad else "All health cards are green.",
        tone=worst_of(health),
    )


def read_advice(lake: Lake, campaign_id: str) -> list[Advice]:
    """Read what was said after each batch, the newest first."""
    found: dict[int, Advice] = {}
    for (payload,) in tuples(lake, _SAID, campaign=campaign_id):
        advice = Advice.model_validate(json.loads(payload))
        found.setdefault(advice.after_batch, advice)
    return sorted(found.values(), key=lambda advice: -advice.after_batch)


def has_stopped(campaign: Campaign, stage: int | None = None) -> bool:
    """Return whether the campaign ends before its schedule does, by itself, and before a stage where one is given.

    So it does where its config lets it, and the last batches were all said not to be worth another. A stage whose tools
    are chosen already is finished.
    """
    schedule = campaign.config.schedule
    if schedule.stop != "by itself":
        return False
    said = read_advice(campaign.lake, campaign.campaign_id)
    if len(said) < IN_A_ROW or not all(advice.is_end for advice in said[:IN_A_ROW]):
        return False
    proposed = {tool.batch for tool in campaign.state().tools}
    stages = range(schedule.n_stages) if stage is None else [stage]
    has_open = proposed - set(range(1, said[0].after_batch + 1))
    return not has_open and any(not proposed & set(schedule.batches_of(one)) for one in stages)


def describe_stop(campaign: Campaign) -> str:
    """Tell why the campaign ended by itself, and how it goes on all the same."""
    said = read_advice(campaign.lake, campaign.campaign_id)
    chances = " and ".join(spell_chance(advice.chance) for advice in reversed(said[:IN_A_ROW]))
    return (
        f"The campaign ends by itself: the chance of another batch to beat the best finger by "
        f"{spell_share(campaign.config.schedule.stop_margin)} was {chances} after the last {IN_A_ROW} batches. To "
        'print on, set schedule.stop = "advice" and run it again.'
    )
