"""The pages of the documentation, and what is in them."""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
_FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", flags=re.M | re.S)


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    text: str


def name_of(page: Path) -> str:
    """Path of a page below the repository, for test names."""
    return str(page.relative_to(ROOT))


def blocks_of(page: Path, *languages: str) -> list[Block]:
    """Fenced blocks of these languages, in order, without the indentation of their fence."""
    found = []
    for indent, language, text in _FENCE.findall(page.read_text(encoding="utf-8")):
        if language in languages:
            found.append(Block(language, re.sub(rf"^{indent}", "", text, flags=re.M)))
    return found


def prose_of(page: Path) -> str:
    """Text of a page without its fenced blocks."""
    return _FENCE.sub("", page.read_text(encoding="utf-8"))
