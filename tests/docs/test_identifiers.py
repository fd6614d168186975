"""docs/reference/identifiers.md: every prefix of an id is explained there."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from fast.models.ids import PREFIXES, content_id
from tests.docs.pages import DOCS, ROOT

LAYERS = ("flows", "tasks", "lake", "hardware", "models")
PAGE = DOCS / "reference" / "identifiers.md"


def prefixes_in(path: Path) -> Iterator[str]:
    """First arguments of the calls of `content_id` in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Call(func=ast.Name(id=content_id.__name__), args=[ast.Constant(value=str(prefix)), *_]):
                yield prefix


def test_every_prefix_is_explained():
    used = {prefix for layer in LAYERS for path in (ROOT / layer).rglob("*.py") for prefix in prefixes_in(path)}
    explained = re.findall(r"^\| `([A-Z]+)` \|", PAGE.read_text(encoding="utf-8"), flags=re.M)
    assert len(used) > 15
    assert len(explained) == len(set(explained)), "one meaning each"
    assert used - set(PREFIXES) == set()
    assert set(PREFIXES) == set(explained)


def test_a_prefix_without_a_meaning_is_refused():
    with pytest.raises(ValueError, match="no meaning"):
        content_id("O", [])
