"""What pages say of the code, written by the code: `python -m tests.docs.generated` (`make pages`).

A page has marks, `<!-- generated: NAME -->` and `<!-- end -->`. What lies between them is written here, from the help
of commands, the fields of records, the catalogue of effects and the comments of views. Everything else is by hand.
"""

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from fast.flows.cli.main import app
from fast.hardware.arm.settings import ArmSettings
from fast.hardware.bench import BenchSettings
from fast.hardware.virtual.world.file import World
from fast.lake.query.catalogue import catalogue, view_comments
from fast.lake.tables.campaign import TABLES
from fast.models.design.fin_ray import FinRay
from fast.models.design.recipe import Recipe
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import catalogue_entries, catalogue_rows
from fast.tasks.campaign.config import CampaignConfig
from tests.docs.pages import DOCS

LAYERS = ("flows", "tasks", "lake", "hardware", "models")
_PART = re.compile(r"(<!-- generated: ([\w -]+) -->\n)(.*?)(<!-- end -->)", flags=re.S)
ELSEWHERE = {Recipe: "a [recipe](#recipe)", FinRay: "a [design](#design-file)", EffectValue: "an [effect](#effects)"}
_SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


class Key(NamedTuple):
    """A key of a config file: section, name, default, range, and what it means."""

    section: str
    name: str
    default: str
    allowed: str
    meaning: str


def write_page(text: str) -> str:
    """The text of a page with its generated parts as the code is now."""
    return _PART.sub(lambda part: f"{part[1]}\n{WRITERS[part[2]]().strip()}\n\n{part[4]}", text)


def generated_pages() -> list[Path]:
    """The pages that have a generated part."""
    return [page for page in sorted(DOCS.rglob("*.md")) if _PART.search(page.read_text(encoding="utf-8"))]


def describe_fields(model: type[BaseModel]) -> dict[str, str]:
    """What each field means: its description, else the docstring under it."""
    under = {name: text for kind in reversed(model.__mro__) for name, text in _docstrings_under_fields(kind).items()}
    return {name: field.description or under.get(name, "") for name, field in model.model_fields.items()}


@cache
def _docstrings_under_fields(kind: type) -> dict[str, str]:
    if not issubclass(kind, BaseModel) or kind is BaseModel:
        return {}
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    found = {}
    for field, after in zip(tree.body, tree.body[1:], strict=False):
        match field, after:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = _clause(" ".join(text.split()).rstrip("."))
    return found


def _clause(sentence: str) -> str:
    """A sentence as the cells of tables have it: without a capital, unless it is of a name."""
    word = sentence.split()[0]
    return sentence if "'" in word or word[1:] != word[1:].lower() else word.lower() + sentence[len(word) :]


def keys_of(model: type[BaseModel], section: str = "") -> Iterator[Key]:
    """Keys of a config in the order of its file; sections come after the keys beside them."""
    meanings, sections = describe_fields(model), []
    for name, field in model.model_fields.items():
        inner = _section_of(field)
        if inner is None:
            yield Key(section, name, _default_of(field), _range_of(field), meanings[name])
        else:
            sections.append((inner, f"{section}.{name}" if section else name))
    for inner, path in sections:
        yield from keys_of(inner, path)


def _section_of(field: FieldInfo) -> type[BaseModel] | None:
    """The record of a section; None for a key, and for what has a part of the page of its own."""
    kinds = [kind for kind in _kinds_of(field.annotation) if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return kinds[0] if _kinds_of(field.annotation) == kinds and len(kinds) == 1 and kinds[0] not in ELSEWHERE else None


def _kinds_of(annotation: Any) -> list[Any]:
    """The alternatives of a type, without None and marks."""
    if get_origin(annotation) is Annotated:
        return _kinds_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [kind for part in get_args(annotation) if part is not NoneType for kind in _kinds_of(part)]
    return [annotation]


def _default_of(field: FieldInfo) -> str:
    default = field.default if field.default_factory is None else field.get_default(call_default_factory=True)  # type: ignore[call-arg]
    if default is PydanticUndefined:
        return "required"
    return "" if default in (None, (), {}) else f"`{_toml_of(default)}`"


def _toml_of(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case tuple() | list():
            return "[" + ", ".join(_toml_of(part) for part in value) + "]"
        case Mapping():
            return "{" + ", ".join(f"{key} = {_toml_of(part)}" for key, part in value.items()) + "}"
        case BaseModel():
            return _toml_of(value.model_dump())
        case float():
            return f"{value:g}"
    return str(value)


def _range_of(field: FieldInfo) -> str:
    limits = {name: getattr(mark, name) for mark in field.metadata for name in _SIGNS if hasattr(mark, name)}
    if limits.keys() == {"ge", "le"}:
        return f"{_toml_of(limits['ge'])} to {_toml_of(limits['le'])}"
    if limits:
        return ", ".join(f"{_SIGNS[name]} {_toml_of(limit)}" for name, limit in limits.items())
    return ", ".join(_kind_word(kind) for kind in _kinds_of(field.annotation))


def _kind_word(kind: Any) -> str:
    if kind in ELSEWHERE:
        return ELSEWHERE[kind]
    if get_origin(kind) is Literal:
        return ", ".join(f"`{_toml_of(choice)}`" for choice in get_args(kind))
    if get_origin(kind) is tuple:
        inner = [part for whole in get_args(kind) if whole is not Ellipsis for part in _kinds_of(whole)]
        return "list: " + ", ".join(dict.fromkeys(_kind_word(part) for part in inner))
    if get_origin(kind) is dict:
        return "table"
    words = {str: "text", float: "number", int: "whole number", bool: "`true`, `false`"}
    return words.get(kind, "table")


def _table(head: str, rows: list[tuple[str, ...]]) -> str:
    columns = head.split(", ")
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("|" + "".join(f" {cell} |".replace("  ", " ") for cell in line) for line in lines)


def _escape(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def write_keys(model: type[BaseModel]) -> str:
    """Table of the keys of a config file."""
    rows, section = [], ""
    for key in keys_of(model):
        if key.section != section:
            section = key.section
            rows.append((f"**`[{section}]`**", "", "", ""))
        rows.append((f"`{key.name}`", key.default, _escape(key.allowed), _escape(key.meaning)))
    return _table("key, default, range, meaning", rows)


def write_tables() -> str:
    """The tables of a lake, each with its columns."""
    rows = []
    for row in TABLES:
        meanings = describe_fields(row)
        name = row.id_column()
        columns = [column for column in row.model_fields if column != name]
        notes = {c: "; ".join(filter(None, [_choices_of(row.model_fields[c]), meanings[c]])) for c in columns}
        said = [f"`{c}`" + (f" ({_escape(notes[c])})" if notes[c] else "") for c in columns]
        rows.append((f"`{row.table}` (`{name}`)", _sentence_of(row), ", ".join(said)))
    return _table("table, one row is, columns besides the id", rows)


def _choices_of(field: FieldInfo) -> str:
    choices = [kind for kind in _kinds_of(field.annotation) if get_origin(kind) is Literal]
    return ", ".join(str(choice) for kind in choices for choice in get_args(kind))


def _sentence_of(kind: type) -> str:
    text = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())
    return _escape(text.split(". ")[0].rstrip("."))


def write_views() -> str:
    """The views of a lake."""
    comments = view_comments()
    views = [entry.name for entry in catalogue() if entry.kind == "view"]
    return _table("view, what it shows", [(f"`{name}`", _escape(comments[name])) for name in views])


def write_macros() -> str:
    """The macros of a lake, with their arguments."""
    comments = view_comments()
    macros = [(entry.name, ", ".join(entry.columns)) for entry in catalogue() if entry.kind == "macro"]
    return _table("macro, gives", [(f"`{name}({given})`", _escape(comments[name])) for name, given in macros])


def write_commands() -> str:
    """Every command with its arguments and options, as `--help` says them."""
    text = app.generate_docs(output_format="markdown", heading_level=2)
    text = re.sub(r"\*\*Commands\*\*:\n\n(?:\* .*\n)+\n?|```console\n.*\n```\n\n", "", text[text.index("### ") :])
    text = re.sub(r"\* `--(?:lake PATH|json)`: .*\n", "", text)  # the page says them once
    text = re.sub(r"\*\*Parameters\*\*:\n\n(?!\*)", "", text)
    text = re.sub(r"^#(#+ fast)", r"\1", text, flags=re.M)  # commands stand beside the other chapters of the page
    return re.sub(r"^(##+) (fast .*)$", r"\1# `\2`", text, flags=re.M)


def _line_of_effect(cells: list[Any]) -> tuple[str, ...]:
    return tuple("" if cell in (None, "") else str(cell) for cell in cells)


def write_effects() -> str:
    """Parameters of the catalogue."""
    rows = [[f"`{v}`" if v and k in ("effect", "parameter") else v for k, v in row.items()] for row in catalogue_rows()]
    head = "code, effect, layer, parameter, unit, bounds, neutral, prior, cost, with E, alias of, confusable with"
    return _table(head, [_line_of_effect(row) for row in rows])


def write_laws() -> str:
    """Laws and sources of the catalogue."""
    rows = [_line_of_effect([e["code"], e["name"], f"`{e['law']}`", e["source"]]) for e in catalogue_entries()]
    return _table("code, effect, law, source", rows)


def write_searches() -> str:
    """How gap discovery finds each effect of the catalogue."""
    keys = ("code", "family", "state", "quantity", "experiment")
    rows = [_line_of_effect([entry[key] for key in keys]) for entry in catalogue_entries()]
    return _table("code, one form of, its law runs along, and is of, what a person or the bench can do", rows)


def write_folders() -> str:
    """The chapters of each layer, with the first line of what their `__init__.py` says."""
    lines = ["| folder | what is in it |", "| --- | --- |"]
    for path in (path for layer in LAYERS for path in sorted((DOCS.parent / layer).glob("*/__init__.py"))):
        says = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        lines.append(f"| `{path.parent.relative_to(DOCS.parent)}` | {says.splitlines()[0]} |")
    return "\n".join(lines)


WRITERS: dict[str, Callable[[], str]] = {
    "commands": write_commands,
    "campaign config": lambda: write_keys(CampaignConfig),
    "recipe": lambda: write_keys(Recipe),
    "world": lambda: write_keys(World),
    "bench": lambda: write_keys(BenchSettings),
    "arm": lambda: write_keys(ArmSettings),
    "design": lambda: write_keys(FinRay),
    "tables": write_tables,
    "views": write_views,
    "macros": write_macros,
    "effects": write_effects,
    "folders": write_folders,
    "laws of effects": write_laws,
    "searches for effects": write_searches,
}


def main() -> None:
    """Write the generated parts of all pages."""
    for page in generated_pages():
        text = page.read_text(encoding="utf-8")
        new = write_page(text)
        if new != text:
            page.write_text(new, encoding="utf-8")
            sys.stdout.write(f"{page.relative_to(DOCS.parent)} written\n")


if __name__ == "__main__":
    main()
