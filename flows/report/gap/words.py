"""The answer of a gap search in words."""

from models.gap.findings import Findings, Named, Round
from models.simulation.effects.catalogue import CATALOGUE

_MOST = 0.98  # of what is unusual: who explains more is told without reserve


def words(effect: str) -> str:
    """An effect of the catalogue, or what stands in its place, as people write it."""
    return {"none": "nothing is missing", "unknown": "not in the catalogue"}.get(effect, effect.replace("_", " "))


def probability_words(probability: float) -> str:
    """A probability to two digits, never 1.00 or 0.00."""
    return "> 0.99" if probability > 0.995 else "< 0.01" if probability < 0.005 else f"{probability:.2f}"


def answer(findings: Findings) -> str:
    """The finding that a lab head should read."""
    lead = next((r.where[0].sentence for r in findings.rounds if r.where), "")
    if findings.alarm:
        names = [named_words(r.named) for r in findings.rounds if r.named.kind != "none"]
        return f"{lead} Missing: {', then '.join(names)}.".strip()
    if lead:
        return f"Nothing can be named: no effect predicts what was left out better than in worlds without a gap. {lead}"
    nothing = "Simulation and measurement agree as well as noise and meshes allow: these data show nothing missing."
    return f"{nothing} {findings.power}".strip()


def named_words(named: Named) -> str:
    """What is missing, in the words of the catalogue."""
    if named.kind == "effect":
        return " and ".join(CATALOGUE[e].title if e in CATALOGUE else words(e) for e in named.effects)
    if named.kind == "set":
        return f"one of {', '.join(words(e) for e in named.effects)}, which these data cannot tell apart"
    return "nothing" if named.kind == "none" else "something that is not in the catalogue"


def short(findings: Findings) -> str:
    """What is missing, for a tile; a rest that has no name stands in the line under it."""
    named = [r.named for r in findings.rounds if r.named.kind != "none"]
    if not named:
        return "no gap"
    known = ["one of a set" if n.kind == "set" else " + ".join(map(words, n.effects)) for n in named if n.effects]
    return ", ".join(known) or "unknown"


def probability(findings: Findings) -> str:
    """The line under the tile: what it is, and how sure."""
    if not findings.alarm:
        return "no statistic is beyond what it is in worlds without a gap"
    sure = [r.named.probability for r in findings.rounds if r.named.kind in ("effect", "set")]
    if not sure:
        return "not in the catalogue"
    rest = "; the rest is not in the catalogue" if findings.rounds[-1].named.kind == "unknown" else ""
    return f"what is missing, probability {', '.join(map(probability_words, sure))}{rest}"


def reserve(found: Round) -> str:
    """What keeps a name or set from being sure, and what the next round makes of a set; empty if there is nothing."""
    named = found.named
    if not named.effects:
        return ""
    among = min(sum(c.probability for c in found.candidates if c.effect in named.effects), 1.0)
    parts = []
    if among > 0.0 and named.probability < _MOST * among:
        parts.append(
            f"Probability among all that was tried: {probability_words(among)}. It takes away "
            f"{100.0 * named.probability / among:.0f} % of what is unusual; the rest may be another effect's or law's: "
            f"{probability_words(named.probability)}."
        )
    if named.kind == "set":
        parts.append(f"The next round takes {words(named.effects[0])} for granted; no simulator gets it.")
    return " ".join(parts)
