"""What a campaign has taught as cards: each a sentence, how it stands, and what to do next."""

from collections.abc import Sequence
from typing import Literal

from fast.models.records import Record
from fast.models.scientist.insights.effects import (
    LEAST_TOOLS,
    Disagreement,
    Effect,
    Interval,
    Pair,
    describe_shape,
)
from fast.models.scientist.insights.rules import FEWEST_RIBS, LEAST_CHANCE, LEAST_MATERIAL, MOST_TOLERANCE, NEAREST
from fast.models.scientist.insights.simplest import LOSS, PRINT_ERROR_MM, Simpler
from fast.models.scientist.insights.stopping import Outlook
from fast.models.units import spell_chance, spell_list, spell_name, spell_share, unit_of

Tone = Literal["green", "yellow", "red"]
Topic = Literal["gap", "effect", "pair", "stop", "simplest", "health"]
MATTERS = 0.05  # total share of the variance, of which it must be sure where a parameter is said to matter
_N_NAMED = 3  # parameters in the summary


class Card(Record):
    """One thing that a campaign has taught.

    name: unique among the cards. tone: of health alone. next_step: what to do about it, empty where nothing is to do.
    """

    topic: Topic
    name: str
    sentence: str
    tone: Tone | None = None
    next_step: str = ""


class BatchCost(Record):
    """What a batch took so far, medians over the measured ones; None where the lake does not know.

    bench_h: from the first grasp to the last, of a real bench. waited_h: from asking a person for a batch until its
    tools hung, printed, cleaned and mounted. material_g: of the fingers, two for a tool.
    """

    n_tools: int
    bench_h: float | None = None
    waited_h: float | None = None
    material_g: float | None = None

    @property
    def words(self) -> str:
        """As the end of a sentence."""
        parts = [f"{self.n_tools} prints"]
        parts += [f"{self.material_g:.0f} g of material"] if self.material_g is not None else []
        parts += [f"{_hours(self.bench_h)} on the bench"] if self.bench_h is not None else []
        parts += (
            [f"{_hours(self.waited_h)} until a person has printed and mounted"] if self.waited_h is not None else []
        )
        return ", ".join(parts)


def gap_card(one: Disagreement, campaign_id: str) -> Card:
    """Say that the simulator and the bench say different things of a parameter."""
    name = spell_name(one.parameter)
    return Card(
        topic="gap",
        name=f"gap {one.parameter}",
        tone="red" if one.measured.middle * one.simulated.middle < 0 else "yellow",
        sentence=(
            f"Simulator and measurements disagree about the {name}: the same change of it brings {say(one.measured)} N "
            f"on the bench and {say(one.simulated)} N in the simulator."
        ),
        next_step=f"Look for what the simulator misses: fast gap --campaign {campaign_id}",
    )


def effect_card(effect: Effect, best_n: float, n_tools: int, unit: str = "N") -> Card:
    """Describe a main effect."""
    name = spell_name(effect.parameter)
    in_unit = unit_of(effect.parameter)
    if n_tools < LEAST_TOOLS:
        sentence = f"{name}: {n_tools} measured tools are too few for an effect; it takes {LEAST_TOOLS} at least."
    elif not effect.size.is_sure:
        more = (
            f"it would take about {effect.n_tools_needed} tools to tell"
            if effect.n_tools_needed is not None
            else "no number of tools that a lab prints would tell"
        )
        sentence = f"{name}: no effect that {n_tools} tools can tell from none ({say(effect.size)} {unit}); {more}."
    else:
        words = describe_shape(effect)
        words += f" {in_unit}" if in_unit and words[-1].isdigit() else ""
        sentence = f"{name}: {_with_unit(words, in_unit)}: {say(effect.size)} of {best_n:.1f} {unit}."
    return Card(topic="effect", name=f"effect {effect.parameter}", sentence=sentence[0].upper() + sentence[1:])


def pair_card(pair: Pair, unit: str = "N") -> Card:
    """Describe two parameters that change each other."""
    first, second = spell_name(pair.first), spell_name(pair.second)
    return Card(
        topic="pair",
        name=f"pair {pair.first} {pair.second}",
        sentence=(
            f"The {first} brings {say(pair.at_best)} {unit} where the {second} is at its best, and "
            f"{say(pair.at_worst)} {unit} where it is at its worst."
        ),
    )


def list_that_matter(effects: Sequence[Effect]) -> list[Effect]:
    """List those that surely have a part in the differences between fingers, the largest first."""
    return [effect for effect in effects if effect.total.low >= MATTERS]


def summary_card(effects: Sequence[Effect], n_tools: int) -> Card | None:
    """Say which parameters matter, in a sentence; None before there are tools enough."""
    if n_tools < LEAST_TOOLS:
        return None
    matter = list_that_matter(effects)[:_N_NAMED]
    if not matter:
        sentence = f"{n_tools} tools do not tell yet which parameter matters."
    else:
        names = [spell_name(effect.parameter) for effect in matter]
        explained = spell_list([spell_share(effect.total.middle) for effect in matter])
        verb = "matters most: it has" if len(names) == 1 else "matter most: they have"
        sentence = f"{spell_list(names)} {verb} a part in {explained} of the differences between fingers."
        open_names = [spell_name(effect.parameter) for effect in matter if not effect.size.is_sure]
        if open_names:
            sentence += f" Which values of {spell_list(open_names)} are better is not known yet."
    return Card(topic="effect", name="effects", sentence=sentence[0].upper() + sentence[1:])


def stop_card(outlook: Outlook, cost: BatchCost) -> Card:
    """Say whether another batch is worth it."""
    sentence = (
        f"The chance that the next batch beats the best finger by {spell_share(outlook.margin)} is "
        f"{spell_chance(outlook.chance)}; in the median it adds {outlook.ahead[0].gain_n:.1f} N to "
        f"{outlook.best_n:.1f} N. It takes {cost.words}."
    )
    n = outlook.n_worth
    limit = spell_share(LEAST_CHANCE)
    if not outlook.is_worth:
        step = f"Stop printing: the chance is below {limit}."
    elif n is None:
        step = f"Print on: the chance stays above {limit} for {len(outlook.ahead)} batches at least."
    else:
        step = f"Print on: the chance falls below {limit} after {n} more batch{'es' if n > 1 else ''}."
    return Card(topic="stop", name="next batch", sentence=sentence, next_step=step)


def night_card(outlook: Outlook) -> Card | None:
    """Say what a night of simulations adds; None without a simulator."""
    if outlook.after_night is None:
        return None
    after, before = outlook.after_night, outlook.ahead[0]
    gain = after.chance - before.chance
    # Less than a tenth of a newton more is not seen in the sentence.
    is_worth = gain >= 0.05 or after.gain_n > 1.05 * before.gain_n + 0.1
    verdict = "it is worth the night" if is_worth else "it adds little"
    return Card(
        topic="stop",
        name="night",
        sentence=(
            f"A night of {outlook.n_night} simulations before the next batch takes its chance from "
            f"{spell_chance(before.chance)} to {spell_chance(after.chance)}, its median gain from "
            f"{before.gain_n:.1f} to {after.gain_n:.1f} N: {verdict}."
        ),
    )


_WORDS = {
    FEWEST_RIBS: ("with fewer ribs", "{:.0f} instead of {:.0f}", 1.0),
    LEAST_MATERIAL: ("with less material", "{:.1f} g a finger instead of {:.1f} g", 1.0),
    MOST_TOLERANCE: (
        f"that loses less when walls come out {PRINT_ERROR_MM:g} mm off",
        "{:.1f} % of the force instead of {:.1f} %",
        100.0,
    ),
    NEAREST: ("nearer to the reference finger", "{:.2f} instead of {:.2f} in units of the ranges", 1.0),
}


def simplest_card(one: Simpler) -> Card:
    """Describe a finger that is simpler than the best and as good."""
    what, numbers, factor = _WORDS[one.criterion]
    return Card(
        topic="simplest",
        name=one.criterion,
        sentence=(
            f"A finger {what} ({numbers.format(factor * one.value, factor * one.best_value)}) is expected to hold "
            f"{spell_share(one.share.middle)} [{100 * one.share.low:.0f}, {100 * one.share.high:.0f}] of the best "
            f"one's force. The chance that it holds {spell_share(1.0 - LOSS)} or more is {spell_chance(one.sure)}."
        ),
    )


def say(interval: Interval) -> str:
    """Write an interval as `5.1 [3.9, 6.2]`."""
    return f"{interval.middle:z.1f} [{interval.low:z.1f}, {interval.high:z.1f}]"


def _with_unit(words: str, unit: str | None) -> str:
    return words.replace(", then nothing", f" {unit}, then nothing") if unit else words


def _hours(hours: float) -> str:
    if 60.0 * hours < 1.0:
        return "less than a minute"
    return f"{60 * hours:.0f} min" if hours < 1.0 else f"{hours:.1f} h"
