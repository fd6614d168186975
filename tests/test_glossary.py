"""docs/glossary.md: at most sixty words, and the retired ones do not come back as identifiers."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ("flows", "tasks", "lake", "hardware", "models")
MOST_WORDS = 60
# Everyday words that mean one thing here, and where they may name what other code sees: a folder, a file, a file:name.
PLACES: dict[str, tuple[str, ...]] = {
    "answer": ("flows/campaign/", "flows/challenge/", "flows/cli/", "flows/page/words.py", "flows/page/answers.py")
    + ("hardware/questions.py", "lake/handoff/", "models/gap/ask/", "tasks/bench/questions.py", "tasks/gap/"),
    "bank": ("flows/challenge/", "flows/gap/", "models/gap/", "models/simulation/effects/", "tasks/gap/"),
    "cell": ("flows/challenge/", "flows/report/gap/", "models/gap/", "models/traces/")
    + ("tasks/bench/again.py", "tasks/bench/told_questions.py", "tasks/gap/"),
    "lead": ("models/gap/",),
    "line": ("flows/campaign/", "flows/cli/", "flows/page/start.py", "flows/report/lineage.py", "hardware/", "lake/")
    + ("flows/scientist/campaign_runs.py", "tasks/bench/machine_files/"),
    "order": ("flows/challenge/hidden/lab.py", "flows/cli/plan.py", "hardware/parts/route.py", "lake/")
    + ("models/gap/where/", "models/simulation/contact/points.py", "tasks/bench/measure.py", "tasks/bench/plan.py")
    + ("tasks/campaign/settings.py", "tasks/scientist/insights/insights.py"),
    "panel": ("flows/challenge/", "flows/cli/challenge.py", "flows/gap/", "models/gap/", "tasks/gap/"),
    "reference": ("flows/campaign/", "flows/cli/campaign.py", "flows/page/todo.py", "flows/report/campaign/")
    + ("models/design/", "models/traces/quality.py", "tasks/bench/reference_tools.py", "tasks/campaign/"),
    "tell": ("flows/campaign/", "flows/cli/told.py", "flows/library.py", "flows/page/"),
}
# Names that columns, keys of files, commands, their options and public arguments have.
STORED: tuple[str, ...] = (
    "flows/page/interface.py:answer",
    "lake/tables/inference.py:answer",
    "models/gap/findings.py:lines",
    "models/simulation/effects/contact.py:reference_",
    "tasks/traces/features.py:tell",
)
# Compiled kernels, in which a new name would cost every installation minutes.
KERNELS = (
    "models/objects/edges.py",
    "models/objects/grid.py",
    "models/simulation/body/",
    "models/simulation/contact/self_",
    "models/simulation/solver/cholesky/",
)
# Terms of their own fields.
COMPOUNDS = ("load cell", "line search")


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


def hidden_in(tree: ast.AST) -> Iterator[ast.AST]:
    """Variables of functions, and what lambdas call their arguments."""
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from (part for part in ast.walk(function) if isinstance(part, ast.Name))
        if isinstance(function, ast.Lambda):
            yield from (part for part in ast.walk(function.args) if isinstance(part, ast.arg))


def identifiers_in(path: Path, *, is_seen: bool = False) -> Iterator[str]:
    """What a file defines: its name and folders, functions, classes, arguments, variables and attributes.

    is_seen: without the variables of functions, which no other code sees.
    """
    yield from path.relative_to(ROOT).with_suffix("").parts
    tree = ast.parse(path.read_text(encoding="utf-8"))
    hidden = set(hidden_in(tree)) if is_seen else set()
    for node in ast.walk(tree):
        match node:
            case _ if node in hidden:
                pass
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.arg(arg=name) | ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


def places_of(word: str, seen: dict[str, list[str]]) -> list[str]:
    """Where a word or its plural names something that other code sees, as file:name."""
    plural = word[:-1] + "ies" if word.endswith("y") else word + "s"
    found = []
    for name, files in seen.items():
        bare = " ".join(words_of(name))
        for compound in COMPOUNDS:
            bare = bare.replace(compound, "")
        if {word, plural} & set(bare.split()):
            found += [f"{file}:{name}" for file in files]
    return sorted(found)


def has_part(identifier: str, retired: str) -> bool:
    """Whether the words of `retired` stand side by side in the identifier."""
    wanted, parts = tuple(retired.split()), words_of(identifier)
    return any(parts[start : start + len(wanted)] == wanted for start in range(len(parts)))


def find_identifiers(*, is_seen: bool) -> dict[str, list[str]]:
    """Identifiers of all layers, with the files that define them."""
    found: dict[str, list[str]] = {}
    for layer in LAYERS:
        for path in sorted((ROOT / layer).rglob("*.py")):
            for name in set(identifiers_in(path, is_seen=is_seen)):
                found.setdefault(name, []).append(str(path.relative_to(ROOT)))
    return found


@pytest.fixture(scope="module")
def identifiers() -> dict[str, list[str]]:
    return find_identifiers(is_seen=False)


@pytest.fixture(scope="module")
def seen() -> dict[str, list[str]]:
    return find_identifiers(is_seen=True)


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


def test_words_of_one_meaning_are_in_the_glossary():
    assert set(PLACES) <= {row[0] for row in WORDS}


@pytest.mark.parametrize("word", PLACES)
def test_a_word_keeps_its_one_meaning(seen: dict[str, list[str]], word: str):
    """The wire replies and people answer; a table has fields and a grasp is of a cell: see the glossary."""
    found = places_of(word, seen)
    assert [place for place in found if not place.startswith(PLACES[word] + STORED + KERNELS)] == []
    assert [place for place in PLACES[word] if not any(one.startswith(place) for one in found)] == [], "not needed"


def test_every_stored_name_is_needed(seen: dict[str, list[str]]):
    found = [place for word in PLACES for place in places_of(word, seen)]
    assert [one for one in (*STORED, *KERNELS) if not any(place.startswith(one) for place in found)] == []
