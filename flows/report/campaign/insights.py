"""The section on what the campaign has taught: effects, whether to print again, simpler fingers, health."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.style import BEST, INK, new_axes
from fast.lake.tables.imported import is_imported
from fast.models.errors import ConfigError
from fast.models.scientist.insights.cards import Card, effect_card, pair_card, say
from fast.models.scientist.insights.classes import ClassEffects
from fast.models.scientist.insights.effects import LEAST_TOOLS, Effect, Pair
from fast.models.scientist.insights.rules import LEAST_CHANCE
from fast.models.scientist.insights.stopping import Outlook
from fast.models.scientist.objectives import OUTCOMES
from fast.models.units import spell_chance, spell_name, spell_share, unit_of
from fast.models.validation import load_record
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.scientist.insights.insights import Insights, OutcomeEffects, find_insights
from fast.tasks.templates import number

FILE, _SIMPLER = "insights.json", "simpler"
_MOST_DRAWN = 6  # effects; the others are told in a folded list
_MOST_CLASSES = 4  # parameters in the table by class


def prepare_insights(content: Content, folder: Folder) -> dict[str, Any] | None:
    """Prepare all cards with their pictures, and `data/insights.json` with every number; None of imported data."""
    (folder.root / "data" / FILE).unlink(missing_ok=True)
    stored = content.campaign.config_toml
    if is_imported(stored):
        return None
    try:
        config = load_record(CampaignConfig, tomllib.loads(stored), f"stored config of {content.campaign.campaign_id}")
    except ConfigError:
        return {}
    found = find_insights(at_present(Campaign(content.lake, config)))
    (folder.root / "data" / FILE).write_text(found.model_dump_json(indent=1), encoding="utf-8")
    cards = found.cards
    return {
        "file": FILE,
        "matters": [card for card in cards if card.name.split(" of ")[0] == "effects"],
        "gaps": [card for card in cards if card.topic == "gap"],
        "next_batch": next((card for card in cards if card.name == "next batch"), None) if found.outlook else None,
        "tiles": _tiles(found.outlook) if found.outlook else [],
        "nights": [card for card in cards if card.name == "night"] if found.outlook else [],
        "outcomes": [_prepare_effects(one, folder, len(found.outcomes) > 1) for one in found.outcomes],
        "simpler": _prepare_simpler(found, folder),
        "simpler_names": [one.finding.criterion for one in found.simpler],
        "health": [card for card in cards if card.topic == "health"],
    }


def read_written(report: Path) -> dict[str, Any] | None:
    """Read what `prepare_insights` kept in the folder of a report; None where nothing could be said."""
    path = report / "data" / FILE
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def _tiles(outlook: Outlook) -> list[tuple[str, str]]:
    n = outlook.n_worth
    until = f"more than {len(outlook.ahead)}" if n is None else str(n)
    return [
        (
            spell_chance(outlook.chance),
            f"chance that the next batch beats the best by {spell_share(outlook.margin)}",
        ),
        (number(outlook.ahead[0].gain_n, 1, "N"), "what it adds, in the median"),
        (until, f"batch{'' if n == 1 else 'es'} until the chance falls below {spell_share(LEAST_CHANCE)}"),
    ]


def _prepare_effects(found: OutcomeEffects, folder: Folder, is_one_of_several: bool) -> dict[str, Any]:
    """Prepare curves of the strongest effects, how much of the differences each parameter has, and pairs."""
    unit, suffix = unit_of(found.outcome) or "", f"_{found.outcome}" if is_one_of_several else ""
    of = OUTCOMES[found.outcome].about if is_one_of_several else ""
    if found.n_tools < LEAST_TOOLS:
        return {"of": of, "n_tools": found.n_tools, "least_tools": LEAST_TOOLS, "is_known": False}
    by_name = {card.name: card for card in _cards_of(found, unit)}
    sure = [effect for effect in found.effects if effect.size.is_sure][:_MOST_DRAWN]
    limits = _limits(sure)
    curves = [
        {
            "drawn": folder.draw(f"effect_{effect.parameter}{suffix}", draw_effect(effect, unit, limits)),
            "sentence": by_name[effect.parameter].sentence,
        }
        for effect in sure
    ]
    return {
        "of": of,
        "n_tools": found.n_tools,
        "is_known": True,
        "curves": curves,
        "rest": [by_name[effect.parameter].sentence for effect in found.effects if effect not in sure],
        "shares": folder.draw(f"shares{suffix}", draw_shares(found.effects)),
        "pair": _prepare_pair(found, folder, unit, suffix),
        "classes": _prepare_classes(found.classes, found.effects) if found.classes else None,
    }


def _cards_of(found: OutcomeEffects, unit: str) -> list[Card]:
    cards = [effect_card(effect, found.best, found.n_tools, unit) for effect in found.effects]
    return [card.model_copy(update={"name": card.name.removeprefix("effect ")}) for card in cards]


def _limits(effects: Sequence[Effect]) -> tuple[float, float]:
    """Return one scale for all curves, so that their sizes can be compared."""
    values = [v for effect in effects for v in (*effect.main.low, *effect.main.high, *effect.best.mean)] or [0.0, 1.0]
    room = 0.05 * (max(values) - min(values))
    return min(values) - room, max(values) + room


def draw_effect(effect: Effect, unit: str, limits: tuple[float, float]) -> Figure:
    """Draw the main effect with its band, and the slice through the best finger."""
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
    """Draw Sobol' indices with their intervals, the largest first."""
    figure, axes = new_axes(4.6, 0.5 + 0.33 * len(effects), grid="x")
    for place, effect in enumerate(effects):
        axes.barh(place, effect.total.middle, height=0.62, color="none", edgecolor=BEST, linewidth=1.0)
        axes.barh(place, effect.first.middle, height=0.62, color=BEST, linewidth=0)
        axes.plot([effect.total.low, effect.total.high], [place, place], color=INK, linewidth=0.9)
    axes.set_yticks(range(len(effects)), [spell_name(effect.parameter) for effect in effects])
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_formatter(lambda value, _: spell_share(value))
    return figure


def draw_pair(pair: Pair, unit: str) -> Figure:
    """Draw the mean outcome over two parameters as contours."""
    figure, axes = new_axes(4.6, 3.2, grid="")
    filled = axes.contourf(pair.second_levels, pair.first_levels, np.array(pair.grid), levels=9, cmap="viridis")
    axes.set_xlabel(spell_name(pair.second, with_unit=True))
    axes.set_ylabel(spell_name(pair.first, with_unit=True))
    figure.colorbar(filled, ax=axes, label=unit)
    return figure


def _prepare_pair(found: OutcomeEffects, folder: Folder, unit: str, suffix: str) -> dict[str, str] | None:
    """Prepare the strongest pair that is sure, as contours."""
    pair = next((pair for pair in found.pairs if pair.grid and pair.change.is_sure), None)
    if pair is None:
        return None
    return {
        "drawn": folder.draw(f"pair_{pair.first}_{pair.second}{suffix}", draw_pair(pair, unit)),
        "names": f"{spell_name(pair.first)} and {spell_name(pair.second)}",
        "sentence": pair_card(pair, unit).sentence,
    }


def _prepare_classes(classes: Sequence[ClassEffects], effects: Sequence[Effect]) -> dict[str, Any]:
    """Prepare a row for each class of object, a column for each of the strongest parameters."""
    shown = [effect.parameter for effect in effects if effect.size.is_sure][:_MOST_CLASSES]
    shown = shown or [effect.parameter for effect in effects[:_MOST_CLASSES]]
    columns: dict[str, Any] = {"class": "object_class", "objects": ["n_objects", 0], "mean (N)": ["mean_n", 1]}
    columns |= {f"{spell_name(name)} (N)": [name] for name in shown}
    rows = [
        {"object_class": one.object_class, "n_objects": one.n_objects, "mean_n": one.mean_n}
        | {name: say(one.sizes[name]) for name in shown}
        for one in sorted(classes, key=lambda one: one.object_class)
    ]
    return {"columns": columns, "rows": rows}


def _prepare_simpler(found: Insights, folder: Folder) -> list[str]:
    """Prepare simpler fingers that are as good, and their designs as a file that a campaign can print from."""
    if not found.simpler:
        return []
    sentences = {card.name: card.sentence for card in found.cards if card.topic == "simplest"}
    rows = [{"name": f"simpler: {one.finding.criterion}", "batch": None, **one.design} for one in found.simpler]
    folder.numbers(_SIMPLER, rows)
    return [sentences[one.finding.criterion] for one in found.simpler]
