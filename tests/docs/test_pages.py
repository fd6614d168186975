"""Each kind of page keeps its form."""

from pathlib import Path

import pytest

from tests.docs.pages import DOCS, name_of

PARTS = ("Context", "Decision", "Consequence", "Figures")


@pytest.mark.parametrize("page", sorted((DOCS / "how-to").glob("*.md")), ids=name_of)
def test_a_how_to_begins_with_what_the_reader_will_have(page: Path):
    title, empty, first = page.read_text(encoding="utf-8").splitlines()[:3]
    assert title.startswith("# ")
    assert empty == ""
    assert first.startswith("At the end ")


@pytest.mark.parametrize("page", sorted((DOCS / "explanation").glob("*.md")), ids=name_of)
def test_an_explanation_begins_with_what_the_reader_can_do_after_it(page: Path):
    assert page.read_text(encoding="utf-8").splitlines()[2].startswith("After this page you ")


@pytest.mark.parametrize("page", sorted((DOCS / "decisions").glob("[0-9]*.md")), ids=name_of)
def test_a_decision_has_its_four_parts(page: Path):
    lines = page.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith(f"# {page.name[:3]}: ")
    assert [line for line in lines if line.startswith("## ")] == [f"## {part}" for part in PARTS]
    assert 20 <= len(lines) <= 60
