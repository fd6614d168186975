"""What tools are printed of, and how: lots of material from their files into the lake, recipes of stored configs.

A calibration takes its priors from a lot.
"""

import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, ToolRow
from fast.lake.tables.catalogue_rows import read_lot_rows
from fast.lake.tables.imported import is_imported
from fast.lake.tables.material import MaterialRow, lot_of_rows
from fast.models.design.recipe import Recipe
from fast.models.errors import UsageError
from fast.models.material import TABLE_3, MaterialLot, MaterialMeasurement, find_lot_questions
from fast.models.question import Question, settle
from fast.models.validation import closest, load_record
from fast.tasks.campaign.config import LOT_SUFFIX, read_lot


@dataclass(frozen=True)
class StoredLot:
    """A lot of the lake: its name, what was measured, and the ids of the rows."""

    name: str
    lot: MaterialLot
    material_ids: tuple[str, ...]


def store_lot(lake: Lake, path: Path) -> str:
    """Write what is new or changed in the file of a lot to the lake; returns the lot's name.

    Raises:
        ConfigError: the file cannot be used.
        UsageError: something in it is strange, and it does not say that it is so.
    """
    name, lot = path.stem, read_lot(path)
    known = {row.quantity: row.measurement for row in read_lot_rows(lake, name)}
    new = [quantity for quantity, one in lot.measured.items() if known.get(quantity) != _bare(one)]
    questions = _ask_about(lake, name, lot, new) if new else []
    doubted = [q for q in questions if not all(lot.measured[new[number]].sure for number in q.numbers)]
    settle(doubted, False, f"Correct {path}", "`sure = true` in its table")
    rows = []
    for number, quantity in enumerate(new):
        kinds = dict.fromkeys(question.kind for question in questions if number in question.numbers)
        rows.append(MaterialRow.of(name, quantity, lot.measured[quantity], ", ".join(kinds) or None))
    if rows:
        lake.append(rows, current_provenance())
    return name


def _bare(measured: MaterialMeasurement) -> MaterialMeasurement:
    return measured.model_copy(update={"sure": False})


def _ask_about(lake: Lake, name: str, lot: MaterialLot, new: Sequence[str]) -> list[Question]:
    rows = read_lot_rows(lake)
    names = dict.fromkeys(row.lot for row in rows)
    others = {other: lot_of_rows([row for row in rows if row.lot == other]) for other in names if other != name}
    tools = lake.rows(ToolRow, material_lot=name, status="printed")
    hardness = [row["hardness_shore_a"] for row in tools if row["hardness_shore_a"] is not None]
    return find_lot_questions(name, lot, new, others, median(hardness) if hardness else None)


def name_campaign_lot(config_toml: str) -> str:
    """Return the lot that a stored config names; empty for none, and for an imported campaign."""
    if is_imported(config_toml):
        return ""
    return Path(tomllib.loads(config_toml).get("material", "")).stem


def read_stored_recipe(config_toml: str) -> Recipe | None:
    """Read the recipe of a stored config; None for none, and for an imported campaign."""
    if is_imported(config_toml):
        return None
    told = tomllib.loads(config_toml).get("print")
    return None if told is None else load_record(Recipe, told, "stored config")


def find_lot(lake: Lake, asked: str | None, campaign_ids: Collection[str]) -> StoredLot | None:
    """Find the lot that was asked for, else the one that these campaigns name; None for the priors of Table 3.

    `asked` is the name of a lot in the lake, the path of a lot's file, which is then stored, or `none`.

    Raises:
        UsageError: there is no such lot, its file cannot be used, or the campaigns name several.
    """
    if asked == TABLE_3:
        return None
    if asked is not None:
        return _stored_lot(lake, store_lot(lake, Path(asked)) if asked.endswith(LOT_SUFFIX) else asked)
    named = {
        row.campaign_id: lot
        for row in lake.records(CampaignRow)
        if row.campaign_id in campaign_ids and (lot := name_campaign_lot(row.config_toml))
    }
    if len(set(named.values())) > 1:
        lots = ", ".join(f"{campaign} names {lot}" for campaign, lot in named.items())
        raise UsageError(f"the campaigns name different material lots ({lots}); give one --campaign, or the --lot.")
    return _stored_lot(lake, next(iter(named.values()))) if named else None


def _stored_lot(lake: Lake, name: str) -> StoredLot:
    rows = read_lot_rows(lake, name)
    if not rows:
        lots = sorted({row.lot for row in read_lot_rows(lake)})
        raise UsageError(
            f"material lot `{name}` is not in {lake.address}; {closest(name, lots)} A new one comes in by its file: "
            "--lot materials/paper.toml."
        )
    return StoredLot(name, lot_of_rows(rows), tuple(row.material_id for row in rows))
