"""What the page of a gap search says of questions: what to measure next, what earlier ones brought."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.folder import Folder
from fast.flows.report.gap.sentences import GapPage, describe_effect, describe_odds, describe_probability, shorten_tool
from fast.flows.report.style import BEST, FIRST, INK, SIMULATED, WIDTH_IN, new_axes
from fast.models.gap.ask.outcomes import MEANS
from fast.models.gap.findings import UNKNOWN, NextExperiment
from fast.models.objects.catalogue import get_object
from fast.models.traces.step_features import STEP_MM
from fast.tasks.templates import DASH

_COLOURS = (FIRST, BEST, SIMULATED, "#cc79a7", INK)


def prepare_next(content: GapPage, folder: Folder) -> dict[str, Any]:
    """Prepare values of what to measure next, what earlier questions brought, and aliases with what would tell."""
    findings = content.findings
    asked, ranking = findings.next_experiment, findings.ranking
    tools = ranking.tools if ranking else ()
    return {
        "command": content.command,
        "question": _prepare_question(asked, folder) if asked else None,
        "ranked": [{"place": place, "tool": shorten_tool(tool)} for place, tool in enumerate(tools, 1)],
        "aliases": [
            {"effect": describe_effect(a.effect), "of": a.of, "experiment": a.experiment} for a in findings.aliases
        ],
    }


def _prepare_question(asked: NextExperiment, folder: Folder) -> dict[str, Any]:
    outcomes = [(one.sentence, one.effect) for one in asked.outcomes] + [("anything else", UNKNOWN)]
    return {
        "sentence": asked.sentence.partition(MEANS)[0],
        "separates": [describe_effect(effect) for effect in asked.separates],
        "outcomes": [
            {"sentence": sentence, "effect": describe_effect(effect), "chance": _describe_chance(asked, effect)}
            for sentence, effect in outcomes
        ],
        "grasps": [
            {"tool": shorten_tool(g.tool), "object_name": get_object(g.object).name, "setting": g.setting, "n": g.n}
            for g in asked.grasps
        ],
        "promised": [
            {"between": " or ".join(map(describe_effect, p.between)), "odds": describe_odds(p.nats)}
            for p in asked.promised
        ],
        "predicted": folder.draw("question", draw_predictions(asked)) if asked.predictions else None,
    }


def _describe_chance(asked: NextExperiment, name: str) -> str:
    return describe_probability(asked.possible[name]) if name in asked.possible else DASH


def draw_predictions(asked: NextExperiment) -> Figure:
    """Draw what each hypothesis predicts of the asked grasp, force over lift."""
    figure, axes = new_axes(WIDTH_IN, 2.6)
    for one, colour in zip(asked.predictions, _COLOURS, strict=False):
        lift_mm = STEP_MM * (np.arange(len(one.force_n)) + 0.5)
        axes.plot(lift_mm, one.force_n, color=colour, linewidth=1.4, label=describe_effect(one.effect))
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("force (N)")
    axes.legend(fontsize=8, frameon=False)
    return figure
