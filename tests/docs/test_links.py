"""Links, anchors and pictures of the documentation lead somewhere."""

import re
from pathlib import Path

import pytest

from tests.docs.pages import DOCS, PAGES, ROOT, name_of, prose_of


def links_of(page: Path) -> list[str]:
    """Targets of links and pictures that are not on the network; code in backticks holds none."""
    text = re.sub(r"`[^`\n]+`", "", prose_of(page))
    targets = re.findall(r"\]\(<?([^)\s>]+)", text)
    return [target for target in targets if not re.match(r"[a-z]+:", target)]


def anchors_of(page: Path) -> set[str]:
    """Anchors that GitHub and the site give the headings of a page."""
    anchors: set[str] = set()
    for title in re.findall(r"^#{1,6} +(.+?) *$", prose_of(page), flags=re.M):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        slug = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        n_same = sum(re.fullmatch(rf"{re.escape(slug)}(-\d+)?", known) is not None for known in anchors)
        anchors.add(f"{slug}-{n_same}" if n_same else slug)
    return anchors


def wrong_links(page: Path) -> list[str]:
    """Links of a page that lead nowhere, and links of the site that leave it."""
    wrong = []
    for target in links_of(page):
        path, _, anchor = target.partition("#")
        found = (page.parent / path).resolve() if path else page
        if not found.exists():
            wrong.append(f"{target}: no such file")
        elif page.is_relative_to(DOCS) and not found.is_relative_to(DOCS):
            wrong.append(f"{target}: outside docs/, which is not on the site")
        elif anchor and (found.suffix != ".md" or anchor not in anchors_of(found)):
            wrong.append(f"{target}: no such heading")
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path):
    assert wrong_links(page) == []


def test_every_picture_is_shown():
    shown = {(page.parent / target.partition("#")[0]).resolve() for page in PAGES for target in links_of(page)}
    pictures = {path for folder in ("images", "verification") for path in (DOCS / folder).glob("*.png")}
    assert [name_of(path) for path in sorted(pictures - shown)] == []


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md") if page.parent.name != "decisions"}
    assert pages <= listed


def test_every_decision_is_listed():
    listed = links_of(DOCS / "decisions" / "README.md")
    assert [path.name for path in sorted((DOCS / "decisions").glob("[0-9]*.md")) if path.name not in listed] == []


def test_every_decision_has_its_own_number():
    numbers = [path.name[:3] for path in sorted((DOCS / "decisions").glob("[0-9]*.md"))]
    assert len(numbers) == len(set(numbers)), [number for number in numbers if numbers.count(number) > 1]


def test_wrong_links_are_found(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("# One title\n[a](#one-title) [b](#two) ![c](c.png) `[d](d.md)`\n```\n[e](e.md)\n```\n")
    assert wrong_links(page) == ["#two: no such heading", "c.png: no such file"]
