"""Pages say of the code what the code says."""

from pathlib import Path

import pytest

from fast.models.records import Record
from tests.docs.generated import WRITERS, describe_fields, generated_pages, keys_of, write_page
from tests.docs.pages import name_of


class Inner(Record):
    """Some."""

    gap_mm: float = 2.0


class Outer(Record):
    """More."""

    inner: Inner = Inner()
    name: str
    """What it is called."""


@pytest.mark.parametrize("page", generated_pages(), ids=name_of)
def test_a_page_is_as_the_code_is(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == write_page(text), "write the pages anew: make pages"


def test_every_part_is_on_a_page() -> None:
    written = [
        name for page in generated_pages() for name in WRITERS if f"<!-- generated: {name} -->" in page.read_text()
    ]
    assert sorted(written) == sorted(WRITERS)


def test_keys_stand_before_sections_and_have_the_docstring_under_them() -> None:
    assert describe_fields(Outer) == {"inner": "", "name": "what it is called"}
    assert [(key.section, key.name, key.default) for key in keys_of(Outer)] == [
        ("", "name", "required"),
        ("inner", "gap_mm", "`2`"),
    ]


def test_what_is_changed_by_hand_is_seen() -> None:
    (page,) = (page for page in generated_pages() if page.name == "effects.md")
    text = page.read_text(encoding="utf-8")
    assert write_page(text.replace("wall_thickness_offset", "wall_offset", 1)) == text
