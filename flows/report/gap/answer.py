"""What the page of a gap search is made of, and its answer in words."""

from dataclasses import dataclass

from models.gap.evaluation.evaluate import Evaluation
from models.gap.findings import Decision, Findings, RoundFindings
from models.gap.naming.rank_effects import Separability
from models.gap.where.locate import Where
from models.gap.where.residuals import Residuals
from models.simulation.effects.catalogue import CATALOGUE

OLD = "Only the answer of this search is kept; run it again with another seed to see what it rests on."

# Tensile bars of the paper (Methods); friction and Poisson ratio were not measured on their own.
INDEPENDENT = {"young_modulus_mpa": (11.5, 1.75)}
_MOST = 0.98  # of what is unusual: who explains more is told without reserve


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
    """A finished search; all but the answer is optional.

    `where`: of each round; `residuals`, `separability`: of the first; `assumed`: sentences.
    """

    findings: Findings
    where: tuple[Where, ...] = ()
    residuals: Residuals | None = None
    evaluation: Evaluation | None = None
    theta: tuple[ThetaRow, ...] = ()
    separability: Separability | None = None
    assumed: tuple[str, ...] = ()


def describe_effect(effect: str) -> str:
    """An effect of the catalogue, or what stands in its place, as people write it."""
    return {"none": "nothing is missing", "unknown": "not in the catalogue"}.get(effect, effect.replace("_", " "))


def describe_probability(probability: float) -> str:
    """A probability to two digits, never 1.00 or 0.00."""
    return "> 0.99" if probability > 0.995 else "< 0.01" if probability < 0.005 else f"{probability:.2f}"


def describe_answer(findings: Findings) -> str:
    """The finding that a lab head should read."""
    lead = next((r.where[0].sentence for r in findings.rounds if r.where), "")
    if findings.alarm:
        names = [describe_decision(r.named) for r in findings.rounds if r.named.kind != "none"]
        return f"{lead} Missing: {', then '.join(names)}.".strip()
    if lead:
        return f"Nothing can be named: no effect predicts what was left out better than in worlds without a gap. {lead}"
    nothing = "Simulation and measurement agree as well as noise and meshes allow: these data show nothing missing."
    return f"{nothing} {findings.power}".strip()


def describe_decision(named: Decision) -> str:
    """What is missing, in the words of the catalogue."""
    if named.kind == "effect":
        return " and ".join(CATALOGUE[e].title if e in CATALOGUE else describe_effect(e) for e in named.effects)
    if named.kind == "set":
        return f"one of {', '.join(describe_effect(e) for e in named.effects)}, which these data cannot tell apart"
    return "nothing" if named.kind == "none" else "something that is not in the catalogue"


def shorten_answer(findings: Findings) -> str:
    """What is missing, for a tile; a rest that has no name stands in the line under it."""
    named = [r.named for r in findings.rounds if r.named.kind != "none"]
    if not named:
        return "no gap"
    known = [
        "one of a set" if n.kind == "set" else " + ".join(map(describe_effect, n.effects)) for n in named if n.effects
    ]
    return ", ".join(known) or "unknown"


def describe_sureness(findings: Findings) -> str:
    """The line under the tile: what it is, and how sure."""
    if not findings.alarm:
        return "no statistic is beyond what it is in worlds without a gap"
    sure = [r.named.probability for r in findings.rounds if r.named.kind in ("effect", "set")]
    if not sure:
        return "not in the catalogue"
    rest = "; the rest is not in the catalogue" if findings.rounds[-1].named.kind == "unknown" else ""
    return f"what is missing, probability {', '.join(map(describe_probability, sure))}{rest}"


def describe_reserve(found: RoundFindings) -> str:
    """What keeps a name or set from being sure, and what the next round makes of a set; empty if there is nothing."""
    named = found.named
    if not named.effects:
        return ""
    among = min(sum(c.probability for c in found.candidates if c.effect in named.effects), 1.0)
    parts = []
    if among > 0.0 and named.probability < _MOST * among:
        parts.append(
            f"Probability among all that was tried: {describe_probability(among)}. It takes away "
            f"{100.0 * named.probability / among:.0f} % of what is unusual; the rest may be another effect's or law's: "
            f"{describe_probability(named.probability)}."
        )
    if named.kind == "set":
        parts.append(f"The next round takes {describe_effect(named.effects[0])} for granted; no simulator gets it.")
    return " ".join(parts)
