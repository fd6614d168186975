"""docs/glossary.md: at most sixty words, and the retired ones do not come back as identifiers."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ("flows", "tasks", "lake", "hardware", "models")
MOST_WORDS = 60


def rows_under(title: str) -> list[list[str]]:
    """Cells of the table under a heading, without its header."""
    page = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    section = page.split(f"\n## {title}\n")[1].split("\n## ")[0].replace("\\|", "/")
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


WORDS = rows_under("Words")
RETIRED = [row[0].strip("`") for row in rows_under("Retired words")]


def words_of(identifier: str) -> tuple[str, ...]:
    """Parts of a snake_case or CamelCase identifier, in lower case."""
    return tuple(part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", identifier))


def identifiers_in(path: Path) -> Iterator[str]:
    """What a file defines: its name and folders, functions, classes, arguments, variables and attributes."""
    yield from path.relative_to(ROOT).with_suffix("").parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.arg(arg=name) | ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


def has_part(identifier: str, retired: str) -> bool:
    """Whether the words of `retired` stand side by side in the identifier."""
    wanted, parts = tuple(retired.split()), words_of(identifier)
    return any(parts[start : start + len(wanted)] == wanted for start in range(len(parts)))


@pytest.fixture(scope="module")
def identifiers() -> dict[str, list[str]]:
    """Identifiers of all layers, with the files that define them."""
    found: dict[str, list[str]] = {}
    for layer in LAYERS:
        for path in sorted((ROOT / layer).rglob("*.py")):
            for name in set(identifiers_in(path)):
                found.setdefault(name, []).append(str(path.relative_to(ROOT)))
    return found


def test_the_glossary_is_short_and_in_order():
    words = [row[0] for row in WORDS]
    assert 40 < len(words) <= MOST_WORDS
    assert words == sorted(set(words))
    assert RETIRED == sorted(set(RETIRED))
    assert not set(words) & set(RETIRED)


@pytest.mark.parametrize("row", WORDS, ids=lambda row: row[0])
def test_each_word_has_one_sentence(row: list[str]):
    word, _, sentence = row
    assert sentence.endswith(".")
    assert ". " not in sentence.replace("Fig. ", ""), word


def test_identifiers_are_split_as_people_read_them():
    assert words_of("run_BenchLane2") == ("run", "bench", "lane")
    assert words_of("HTTPServer") == ("http", "server")
    assert has_part("_BenchLane", "bench lane")
    assert not has_part("lane_of_bench", "bench lane")


@pytest.mark.parametrize("retired", RETIRED)
def test_a_retired_word_names_nothing(identifiers: dict[str, list[str]], retired: str):
    found = {name: files for name, files in identifiers.items() if has_part(name, retired)}
    assert found == {}, f"`{retired}` is retired, see docs/glossary.md"


def test_a_bank_is_one_of_simulations(identifiers: dict[str, list[str]]):
    """One word, one thing: a PLC has blocks of addresses, and folders of effects say what the bank simulates."""
    chapters = {"gap", "challenge", "effects"}
    found = {name: files for name, files in identifiers.items() if has_part(name, "bank") or has_part(name, "banks")}
    assert found
    assert {file for files in found.values() for file in files if not chapters & set(Path(file).parts)} == set()
