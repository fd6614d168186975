"""The section on what the campaign has taught: effects, whether to print again, simpler fingers, health."""

import json
import tomllib
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.html import (
    Markup,
    columns,
    folded,
    number,
    paragraph,
    picture,
    section,
    table,
    text,
    tiles,
)
from fast.flows.report.style import BEST, INK, new_axes, save_svg
from fast.lake.tables.imported import is_imported
from fast.models.errors import ConfigError
from fast.models.scientist.insights.cards import Card, effect_card, pair_card, say
from fast.models.scientist.insights.classes import ClassEffects
from fast.models.scientist.insights.effects import LEAST_TOOLS, Effect, Pair
from fast.models.scientist.insights.rules import LEAST_CHANCE
from fast.models.scientist.insights.stopping import Outlook
from fast.models.scientist.objectives import OUTCOMES
from fast.models.units import spell_name, unit_of
from fast.models.validation import load_record
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.scientist.insights.insights import Insights, OutcomeEffects, find_insights

FILE, _SIMPLER = "insights.json", "simpler"
_TITLE = "What it has taught"
_MOST_DRAWN = 6  # effects; the others are told in a folded list
_MOST_CLASSES = 4  # parameters in the table by class


def write_insights(content: Content, folder: Folder) -> Markup:
    """All cards with their pictures, and `data/insights.json` with every number; nothing of imported data."""
    (folder.root / "data" / FILE).unlink(missing_ok=True)
    stored = content.campaign.config_toml
    if is_imported(stored):
        return Markup("")
    try:
        config = load_record(CampaignConfig, tomllib.loads(stored), f"stored config of {content.campaign.campaign_id}")
    except ConfigError:
        words = "The stored config is one of another version of FAST, so that nothing can be said of what was wanted."
        return section("taught", _TITLE, paragraph(words))
    found = find_insights(at_present(Campaign(content.lake, config)))
    (folder.root / "data" / FILE).write_text(found.model_dump_json(indent=1), encoding="utf-8")
    return section(
        "taught",
        _TITLE,
        *_opening(found),
        *(_effects(one, folder, len(found.outcomes) > 1) for one in found.outcomes),
        *_simpler(found, folder),
        _health(found.cards),
        paragraph(Markup(f'Every number of this section: <a href="data/{FILE}">data/{FILE}</a>'), "note"),
    )


def read_written(report: Path) -> dict[str, Any] | None:
    """What `write_insights` kept in the folder of a report; None where nothing could be said."""
    path = report / "data" / FILE
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def _opening(found: Insights) -> list[Markup]:
    """What matters and whether to print again, before anything is explained."""
    parts = [paragraph(card.sentence, "lead") for card in found.cards if card.name.split(" of ")[0] == "effects"]
    parts += [_card(card) for card in found.cards if card.topic == "gap"]
    if found.outlook is None:
        return parts
    stop = next(card for card in found.cards if card.name == "next batch")
    parts.append(paragraph(Markup(f"<b>{text(stop.next_step)}</b> {text(stop.sentence)}"), "lead"))
    parts.append(tiles(_tiles(found.outlook)))
    parts += [paragraph(card.sentence) for card in found.cards if card.name == "night"]
    return parts


def _tiles(outlook: Outlook) -> list[tuple[str, str]]:
    n = outlook.n_worth
    until = f"more than {len(outlook.ahead)}" if n is None else str(n)
    return [
        (f"{outlook.chance:.0%}", f"chance that the next batch beats the best by {outlook.margin:.0%}"),
        (number(outlook.ahead[0].gain_n, 1, "N"), "what it adds, in the median"),
        (until, f"batches until the chance falls below {LEAST_CHANCE:.0%}"),
    ]


def _effects(found: OutcomeEffects, folder: Folder, is_one_of_several: bool) -> Markup:
    """Curves of the strongest effects, how much of the differences each parameter has, and pairs."""
    unit, suffix = unit_of(found.outcome) or "", f"_{found.outcome}" if is_one_of_several else ""
    head = f": {OUTCOMES[found.outcome].about}" if is_one_of_several else ""
    if found.n_tools < LEAST_TOOLS:
        words = f"{found.n_tools} tools are too few for an effect; it takes {LEAST_TOOLS} at least."
        return Markup(f"<h3>What each parameter does{escape(head)}</h3>{paragraph(words)}")
    by_name = {card.name: card for card in _cards_of(found, unit)}
    sure = [effect for effect in found.effects if effect.size.is_sure][:_MOST_DRAWN]
    limits = _limits(sure)
    panels = [
        _panel(
            folder, f"effect_{effect.parameter}{suffix}", draw_effect(effect, unit, limits), by_name[effect.parameter]
        )
        for effect in sure
    ]
    rest = [by_name[effect.parameter] for effect in found.effects if effect not in sure]
    parts = [
        Markup(f"<h3>What each parameter does{escape(head)}</h3>"),
        paragraph(
            "Line and band: mean over fingers of all kinds that have this value of the parameter, and its 90 % "
            "interval. Dashed: the best finger, with this parameter alone changed.",
            "note",
        ),
    ]
    parts += [Markup(f'<div class="panels wide">{"".join(panels)}</div>')] if panels else []
    parts += (
        [folded(f"{len(rest)} parameters without a picture", "".join(paragraph(one) for one in rest))] if rest else []
    )
    shares = folder.figure(f"shares{suffix}", draw_shares(found.effects), "Part of each parameter in the differences")
    words = paragraph(
        "Which part of the differences between fingers a parameter has: alone (full bar), and with what it changes in "
        "others (hollow bar, which may overlap with those of others), with 90 % intervals.",
        "note",
    )
    parts.append(columns(Markup(shares + words), _pairs(found, folder, unit, suffix)))
    parts += [folded("By class of object", _by_class(found.classes, found.effects))] if found.classes else []
    return Markup("".join(parts))


def _cards_of(found: OutcomeEffects, unit: str) -> list[Card]:
    cards = [effect_card(effect, found.best, found.n_tools, unit) for effect in found.effects]
    return [card.model_copy(update={"name": card.name.removeprefix("effect ")}) for card in cards]


def _panel(folder: Folder, name: str, figure: Figure, card: Card) -> Markup:
    save_svg(figure, folder.root / "figures" / f"{name}.svg")
    folder.written.append(name)
    return Markup(f'<div class="panel">{picture(f"figures/{name}.svg", card.sentence, card.sentence)}</div>')


def _limits(effects: Sequence[Effect]) -> tuple[float, float]:
    """One scale for all curves, so that their sizes can be compared."""
    values = [v for effect in effects for v in (*effect.main.low, *effect.main.high, *effect.best.mean)] or [0.0, 1.0]
    room = 0.05 * (max(values) - min(values))
    return min(values) - room, max(values) + room


def draw_effect(effect: Effect, unit: str, limits: tuple[float, float]) -> Figure:
    """The main effect with its band, and the slice through the best finger."""
    figure, axes = new_axes(3.1, 2.3)
    x = effect.levels
    axes.fill_between(x, effect.main.low, effect.main.high, color=BEST, alpha=0.22, linewidth=0)
    axes.plot(x, effect.main.mean, color=BEST)
    axes.plot(x, effect.best.mean, color=INK, linewidth=1.0, linestyle=(0, (4, 2)))
    axes.set_ylim(limits)
    axes.set_xlabel(spell_name(effect.parameter, with_unit=True))
    axes.set_ylabel(unit)
    return figure


def draw_shares(effects: Sequence[Effect]) -> Figure:
    """Sobol' indices with their intervals, the largest first."""
    figure, axes = new_axes(4.6, 0.5 + 0.33 * len(effects), grid="x")
    for place, effect in enumerate(effects):
        axes.barh(place, effect.total.middle, height=0.62, color="none", edgecolor=BEST, linewidth=1.0)
        axes.barh(place, effect.first.middle, height=0.62, color=BEST, linewidth=0)
        axes.plot([effect.total.low, effect.total.high], [place, place], color=INK, linewidth=0.9)
    axes.set_yticks(range(len(effects)), [spell_name(effect.parameter) for effect in effects])
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    return figure


def draw_pair(pair: Pair, unit: str) -> Figure:
    """The mean outcome over two parameters as contours."""
    figure, axes = new_axes(4.6, 3.2, grid="")
    filled = axes.contourf(pair.second_levels, pair.first_levels, np.array(pair.grid), levels=9, cmap="viridis")
    axes.set_xlabel(spell_name(pair.second, with_unit=True))
    axes.set_ylabel(spell_name(pair.first, with_unit=True))
    figure.colorbar(filled, ax=axes, label=unit)
    return figure


def _pairs(found: OutcomeEffects, folder: Folder, unit: str, suffix: str) -> Markup:
    drawn = [pair for pair in found.pairs if pair.grid and pair.change.is_sure]
    if not drawn:
        return paragraph(
            f"No two parameters are known to change each other's effect after {found.n_tools} tools.", "note"
        )
    parts = [
        folder.figure(
            f"pair_{pair.first}_{pair.second}{suffix}",
            draw_pair(pair, unit),
            f"Mean outcome over {spell_name(pair.first)} and {spell_name(pair.second)}",
            pair_card(pair, unit).sentence,
        )
        for pair in drawn[:1]
    ]
    return Markup("".join(parts))


def _by_class(classes: Sequence[ClassEffects], effects: Sequence[Effect]) -> Markup:
    shown = [effect.parameter for effect in effects if effect.size.is_sure][:_MOST_CLASSES]
    shown = shown or [effect.parameter for effect in effects[:_MOST_CLASSES]]
    rows = [
        (one.object_class, one.n_objects, number(one.mean_n, 1), *(say(one.sizes[name]) for name in shown))
        for one in sorted(classes, key=lambda one: one.object_class)
    ]
    head = ("class", "objects", "mean (N)", *(f"{spell_name(name)} (N)" for name in shown))
    note = paragraph(
        "Force at the best value of a parameter less that at the worst, as in the pictures above, with 90 % intervals.",
        "note",
    )
    return Markup(table(head, rows, numeric=range(1, len(head))) + note)


def _simpler(found: Insights, folder: Folder) -> list[Markup]:
    """Simpler fingers that are as good, and their designs as a file that a campaign can print from."""
    if not found.simpler:
        return []
    sentences = {card.name: card.sentence for card in found.cards if card.topic == "simplest"}
    rows = [{"name": f"simpler: {one.finding.criterion}", "batch": None, **one.design} for one in found.simpler]
    folder.numbers(_SIMPLER, rows)
    return [
        Markup("<h3>Simpler, and as good</h3>"),
        Markup("".join(paragraph(sentences[one.finding.criterion]) for one in found.simpler)),
        paragraph(
            Markup(
                f'Their designs: <a href="data/{_SIMPLER}.csv">data/{_SIMPLER}.csv</a>. To have one measured with the '
                "next batch, copy its row into the file that <code>designs</code> of the config names, with the number "
                "of the batch."
            ),
            "note",
        ),
    ]


def _health(cards: Sequence[Card]) -> Markup:
    """Health cards, the worst first."""
    own = [card for card in cards if card.topic == "health"]
    if not own:
        return Markup("")
    return Markup(f"<h3>Health</h3>{''.join(_card(card) for card in own)}")


def _card(card: Card) -> Markup:
    """A card with its colour, said in words too."""
    tone = card.tone or "green"
    step = f" <b>{text(card.next_step)}</b>" if card.next_step else ""
    return Markup(f'<p class="card {tone}"><span class="tone {tone}">{tone}</span> {text(card.sentence)}{step}</p>')
