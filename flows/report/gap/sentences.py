"""What the page of a gap search is made of, and its answer in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fast.models.gap.evaluation.evaluate import FEWEST_HELD_OUT, Evaluation
from fast.models.gap.findings import UNKNOWN, Decision, FamilyTold, Findings, Gap, RoundFindings, SizeTold
from fast.models.gap.where.cells import UnsureCell
from fast.models.gap.where.locate import Where
from fast.models.gap.where.residuals import Residuals
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_number, spell_share

# Tensile bars of the paper (Methods); friction and Poisson ratio were not measured on their own.
INDEPENDENT = {"young_modulus_mpa": (11.5, 1.75)}
_MOST_NATS = math.log(1000.0)
_LEAST_LEFT = 0.02  # of what a name explains: less is told without reserve


@dataclass(frozen=True)
class ThetaRow:
    """A constant before and after, each median and 90 % interval, and as another instrument measured it (with sd).

    Both ends of an interval at the median: there is no posterior.
    """

    parameter: str
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    independent: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class GapPage:
    """A finished search; all but the answer is optional."""

    findings: Findings
    """The answer."""
    where: tuple[Where, ...] = ()
    """Where simulation and measurement disagree, of each round."""
    residuals: Residuals | None = None
    """Of the first round, after theta was calibrated again."""
    evaluation: Evaluation | None = None
    """On held-out grasps, before and after; None for a search whose rounds are not at hand."""
    theta: tuple[ThetaRow, ...] = ()
    """Its constants before and after."""
    assumed: tuple[str, ...] = ()
    """Sentences on the split and on the simulators."""
    unsure: tuple[UnsureCell, ...] = ()
    """Cells in which meshes or heights differ."""
    command: str = ""
    """By which a person answers the open question; empty without one."""


def describe_effect(effect: str) -> str:
    """Describe an effect of the catalogue, or what stands in its place, as people write it."""
    return {"none": "nothing is missing", "unknown": "not in the catalogue"}.get(effect, effect.replace("_", " "))


def shorten_tool(tool: str) -> str:
    """Shorten a tool to its name without the campaign, as it is written on it: `B01T0`."""
    return tool.rpartition("/")[2]


def describe_probability(probability: float) -> str:
    """Write a probability to two digits, never 1.00 or 0.00."""
    return "> 0.99" if probability > 0.995 else "< 0.01" if probability < 0.005 else f"{probability:.2f}"


def describe_odds(nats: float) -> str:
    """Describe what so much evidence makes of even odds, for people: 3 nats are `20 to 1`."""
    if nats > _MOST_NATS:
        return "> 1000 to 1"
    odds = math.exp(nats)
    return f"{odds:.{0 if odds >= 3.0 else 1}f} to 1"


def describe_findings(findings: Findings) -> str:
    """Describe the finding that a lab head should read."""
    return f"{describe_in_use(findings)} {_describe_finding(findings)}".strip()


def describe_in_use(findings: Findings) -> str:
    """Describe what the simulator had when the search began, a sentence; empty if that was nothing."""
    names = " and ".join(describe_effect(name) for name in findings.in_use)
    return f"The simulator in use has {names} already, from an earlier search." if names else ""


def _describe_finding(findings: Findings) -> str:
    lead = next((r.where[0].sentence for r in findings.rounds if r.where), "")
    if findings.alarm:
        names = [describe_decision(found.named) for found in list_discoveries(findings)]
        rest = next((r.rest_sentence for r in findings.rounds if r.rest_sentence), "")
        return " ".join(part for part in (f"Missing: {', then '.join(names)}.", rest or lead) if part)
    if findings.is_suspicion and findings.next_experiment is not None:
        few = f"{findings.next_experiment.promised_grasps} grasps at another setting"
        lead = f"{lead} An effect may be too weak for an alarm: {few} would show it.".strip()
    if lead:
        return f"Nothing is missing that is larger than what honest simulators differ by. {lead}"
    missing = "nothing else missing" if findings.in_use else "nothing missing"
    nothing = f"Simulation and measurement agree as well as noise and meshes allow: these data show {missing}."
    return f"{nothing} {findings.power}".strip()


def list_discoveries(findings: Findings) -> list[RoundFindings]:
    """List the rounds that found something, without those that speak of what an earlier name left over."""
    return [
        found
        for place, found in enumerate(findings.rounds)
        if found.named.kind != "none" and not findings.is_leftover(place)
    ]


def describe_decision(named: Decision) -> str:
    """Describe what is missing, in the words of the catalogue."""
    if named.kind == "effect":
        return " and ".join(CATALOGUE[e].title if e in CATALOGUE else describe_effect(e) for e in named.effects)
    if named.kind == "set":
        return f"one of {', '.join(describe_effect(e) for e in named.effects)}, which these data cannot tell apart"
    return "nothing" if named.kind == "none" else "something that is not in the catalogue"


def shorten_findings(findings: Findings) -> str:
    """Tell what is missing, for a tile; a rest that has no name stands in the line under it."""
    named = [found.named for found in list_discoveries(findings)]
    if not named:
        return "no further gap" if findings.in_use else "no gap"
    known = [
        n.family or f"one of {len(n.effects)} causes"
        if n.kind == "set"
        else " + ".join(map(describe_effect, n.effects))
        for n in named
        if n.effects
    ]
    return ", ".join(known) or "unknown"


def describe_sureness(findings: Findings) -> str:
    """Write the line under the tile: how probably the answer is right, whatever it is."""
    if not findings.alarm:
        sure = describe_probability(findings.rounds[0].named.probability)
        more = "more " if findings.in_use else ""
        return f"nothing {more}is missing, as far as these data can show; right with probability {sure}"
    found = [one.named for one in list_discoveries(findings)]
    named = [one for one in found if one.effects] or found
    what = "is missing" if named[0].effects else "something is missing that the catalogue does not have"
    rest = "; something else is missing that the catalogue does not have" if len(found) > len(named) else ""
    return f"{what}; right with probability {', '.join(describe_probability(n.probability) for n in named)}{rest}"


def describe_closed(gap: Gap) -> tuple[str, str]:
    """Tell how much of the gap is closed, and the line under it: an interval only where enough was held out."""
    closed = f"{100 * gap.closed_fraction:.0f}\u00a0%"
    if gap.ci95 is None:
        few = f"too few designs or objects held out for an interval, which takes {FEWEST_HELD_OUT} of either"
        return closed, f"of the gap above the floor closed; {few}"
    low, high = gap.ci95
    return closed, f"of the gap above the floor closed, 95 %: {100 * low:.0f} to {100 * high:.0f} %"


def describe_smallness(gap: Gap) -> str:
    """Describe a gap no larger than what repeats scatter or another mesh or contact changes; else return empty."""
    if gap.rmse_before_n > gap.rmse_floor_n:
        return ""
    return (
        f"The whole gap, {gap.rmse_before_n:.2f} N, is not larger than what repeats scatter or another mesh or contact "
        f"changes, {gap.rmse_floor_n:.2f} N: another honest solver would disagree as much."
    )


def list_families(families: Sequence[FamilyTold]) -> list[dict[str, str]]:
    """List what became of made-up worlds, a row for each family that they hide."""
    return [
        {
            "family": one.family or "a cause of no catalogue",
            "noticed": f"{one.n_alarms} of {one.n}",
            "seen_from": "-" if one.seen_size is None else spell_share(one.seen_size, 1),
            "right": f"{one.n_right} of {one.n_alarms}" if one.n_alarms else "-",
            "unknown": f"{one.n_unknown} of {one.n_alarms}" if one.n_alarms and one.family else "-",
            "taken_for": "; ".join(one.taken_for) or "-",
        }
        for one in families
    ]


def describe_size(one: SizeTold) -> str:
    """Describe the smallest size of an effect that would have been seen, in its own unit and of the force."""
    return one.words if one.share is None else f"{spell_share(one.share, 1)} of the force ({one.words})"


def describe_thresholds(thresholds: Mapping[str, float]) -> str:
    """Say what counts as a sign of a gap, in a sentence. thresholds: the lines of `PanelTold`."""
    sure = (
        f", or {thresholds['sure_nats']:.0f} where no solver differs by its like" if "sure_nats" in thresholds else ""
    )
    return (
        f"An effect counts as a sign beyond {thresholds['full_nats']:.0f}, or {thresholds['spread_nats']:.0f} without "
        f"the tool on the object that it helps most; a pattern without a name beyond {thresholds['nats']:.0f}{sure}."
    )


def describe_notes(found: RoundFindings, is_leftover: bool) -> list[str]:
    """Describe what keeps an answer from being the last word: sentences."""
    named, notes = found.named, []
    if is_leftover:
        notes.append(
            "This is what is left of the name before, whose law and parameters are never exact: no new discovery."
        )
    if named.effects and named.left_share is not None and named.left_share >= _LEAST_LEFT:
        notes.append(
            f"Another effect, or a model without a name, would still explain {spell_share(named.left_share)} of what "
            "this answer explains."
        )
    if named.drift:
        notes.append(
            f"Most of the evidence: {named.drift}. What a simulator gets wrong is the same in all of them, so a small "
            "change is seen."
        )
    notes += _describe_possible(named)
    if named.kind == "set" and found.version is not None:
        first = describe_effect(named.effects[0])
        notes.append(f"The simulator gets {first}, since all of them correct alike; which of them it is stays open.")
    if found.refused:
        notes.append(found.refused)
    if found.patternless_n is not None and named.kind == "none" and found.where:
        notes.append(
            f"Yet a test of tools and objects sees this: {found.where[0].sentence} More designs and objects may show "
            "what it is; measure those that the sentence speaks of."
        )
    elif found.patternless_n is not None and named.kind != "unknown":
        notes.append(
            f"Differences of {spell_number(found.patternless_n)} N are left in which designs, objects and repeats show "
            "no pattern. Honest solvers differ by as much: they are not counted as a gap."
        )
    return notes


def _describe_possible(named: Decision) -> list[str]:
    """Describe what an alarm does not exclude besides what it says, a sentence; none if that is not known."""
    known = (name for name in named.possible if name != UNKNOWN)
    families = list(dict.fromkeys(CATALOGUE[e].family if e in CATALOGUE else describe_effect(e) for e in known))
    if not named.possible:
        return []
    excluded = "excluded at 90 %"
    if named.effects:
        can_be = "still possible" if UNKNOWN in named.possible else excluded
        return [f"A cause that is not in the catalogue is {can_be}."]
    return [f"Still possible: {' or '.join(families)}." if families else f"All of the catalogue is {excluded}."]
