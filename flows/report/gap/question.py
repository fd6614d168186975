"""What the page of a gap search says of questions: what to measure next, what earlier ones brought."""

from html import escape

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.folder import Folder
from fast.flows.report.gap.answer import GapPage, describe_effect, describe_probability, shorten_tool
from fast.flows.report.html import Markup, number, paragraph, section, table
from fast.flows.report.style import BEST, FIRST, INK, SIMULATED, WIDTH_IN, new_axes
from fast.models.gap.ask.outcomes import MEANS
from fast.models.gap.findings import UNKNOWN, Asked, NextExperiment, RankedDesigns
from fast.models.objects.catalogue import get_object
from fast.models.traces.step_features import STEP_MM

_HOW_PERSON = "Answer with {}, or in the form that <code>fast serve</code> shows; the next search takes it."
_HOW_GRASPS = "A campaign with <code>gap.active</code> makes them by itself. Without the gantry: {} writes the plan."
_COLOURS = (FIRST, BEST, SIMULATED, "#cc79a7", INK)


def write_next(content: GapPage, folder: Folder) -> Markup:
    """What to measure next, what earlier questions brought, and aliases with what would tell."""
    findings = content.findings
    rows = [(describe_effect(a.effect), a.of, a.experiment) for a in findings.aliases]
    listed = table(("effect", "cannot be told from", "what would tell"), rows)
    return section(
        "next",
        "What to measure next",
        *(paragraph(_describe_asked(one)) for one in findings.asked),
        *_write_question(findings.next_experiment, content.command, folder),
        *_write_ranking(findings.ranking),
        Markup("<h3>What these data cannot tell from something else</h3>"),
        f'<div class="words">{listed}</div>',
    )


def draw_predictions(asked: NextExperiment) -> Figure:
    """What each hypothesis predicts of the asked grasp, force over lift."""
    figure, axes = new_axes(WIDTH_IN, 2.6)
    for one, colour in zip(asked.predictions, _COLOURS, strict=False):
        lift_mm = STEP_MM * (np.arange(len(one.force_n)) + 0.5)
        axes.plot(lift_mm, one.force_n, color=colour, linewidth=1.4, label=describe_effect(one.effect))
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("force (N)")
    axes.legend(fontsize=8, frameon=False)
    return figure


def _write_question(asked: NextExperiment | None, command: str, folder: Folder) -> list[Markup]:
    if asked is None:
        return [paragraph("Nothing is left ambiguous that an experiment of the bench would separate.")]
    found = [
        paragraph(asked.sentence.partition(MEANS)[0], "lead"),
    ]
    if asked.separates:
        found.append(paragraph(f"It separates {', '.join(describe_effect(e) for e in asked.separates)}."))
    if asked.outcomes:
        means = [(one.sentence, describe_effect(one.effect), _tell_chance(asked, one.effect)) for one in asked.outcomes]
        means.append(("anything else", describe_effect(UNKNOWN), _tell_chance(asked, UNKNOWN)))
        found.append(table(("if", "then it is", "probability now"), means, (2,)))
    if command:
        how = _HOW_PERSON if asked.person is not None else _HOW_GRASPS
        found.append(paragraph(Markup(how.format(f"<code>{escape(command)}</code>"))))
    if asked.grasps:
        rows = [(shorten_tool(g.tool), get_object(g.object).name, g.setting, number(g.n, 0)) for g in asked.grasps]
        found.append(table(("tool", "object", "each in turn with a grasp as usual", "n"), rows, (3,)))
    if asked.promised:
        nats = [(" or ".join(map(describe_effect, p.between)), number(p.nats, 1)) for p in asked.promised]
        found.append(table(("promised between", "nats (3 are odds of 20 to 1)"), nats, (1,)))
    if asked.predictions:
        found.append(folder.figure("question", draw_predictions(asked), "Predicted of the asked grasp"))
    return found


def _write_ranking(ranking: RankedDesigns | None) -> list[Markup]:
    """Whether the order of the best designs hangs on what is not known, and the designs."""
    if ranking is None:
        return []
    rows = [(str(place), shorten_tool(tool)) for place, tool in enumerate(ranking.tools, 1)]
    return [paragraph(ranking.sentence), table(("simulated rank", "tool"), rows, (0,))]


def _tell_chance(asked: NextExperiment, name: str) -> str:
    return describe_probability(asked.possible[name]) if name in asked.possible else ""


def _describe_asked(asked: Asked) -> str:
    """What came of a question, with what was believed before and after."""
    changes = ", ".join(
        f"{describe_effect(name)} {describe_probability(before)} to {describe_probability(asked.after.get(name, 0.0))}"
        for name, before in asked.before.items()
    )
    told = f" {changes}." if changes else ""
    return f"Asked before: {asked.promised} grasps promised, {asked.spent} made. {asked.outcome}{told}"
