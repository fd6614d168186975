"""The page on effects shows the catalogue as it is."""

from pathlib import Path
from typing import Any

from fast.models.simulation.effects.catalogue import CATALOGUE, catalogue_entries, catalogue_rows

PAGE = Path(__file__).parents[4] / "docs" / "reference" / "effects.md"


def line(cells: list[Any]) -> str:
    return "|" + "".join(" |" if cell in (None, "") else f" {cell} |" for cell in cells)


def table_of_parameters() -> list[str]:
    rows = catalogue_rows()
    return [line([f"`{v}`" if v and k in ("effect", "parameter") else v for k, v in row.items()]) for row in rows]


def table_of_laws() -> list[str]:
    return [line([e["code"], e["name"], f"`{e['law']}`", e["source"]]) for e in catalogue_entries()]


def table_of_searches() -> list[str]:
    return [line([e["code"], e["family"], e["state"], e["quantity"], e["experiment"]]) for e in catalogue_entries()]


def test_the_page_shows_the_catalogue_as_it_is() -> None:
    page = PAGE.read_text().splitlines()
    missing = [text for text in table_of_parameters() + table_of_laws() + table_of_searches() if text not in page]
    assert not missing, "docs/reference/effects.md lacks these lines:\n" + "\n".join(missing)
    heads = [text for text in page if text.startswith("| ") and text.split(" | ")[0][2:] in _codes()]
    assert len(heads) == 3 * len(CATALOGUE)


def test_entries_say_everything_of_an_effect() -> None:
    entry = next(e for e in catalogue_entries() if e["effect"] == "base_compliance")
    assert entry["parameters"][0]["unit"] == "mm/N"
    assert entry["scales_with_modulus"] is False
    assert entry["cost"] == "C"
    assert entry["alias_of"] is None
    assert {e["code"] for e in catalogue_entries()} == _codes()


def _codes() -> set[str]:
    return {spec.code for spec in CATALOGUE.values()}
