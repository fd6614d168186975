"""No file is cited that the repository does not have."""

import re
import subprocess
from pathlib import Path

import pytest

from tests.docs.pages import ROOT

PLACES = ("flows", "tasks", "lake", "hardware", "models", "docs", "tests")
CITED = re.compile(
    r"(?<![\w/.-])((?:flows|tasks|lake|hardware|models|docs|tests|campaigns|worlds)/[\w/.-]*\w\.(?:py|md|toml))"
)
OUTSIDE = re.compile(r"\bnotes/\w|\bdesign\.md\b|\bissue \d")
MADE_UP = {"docs/decisions/NNN-title.md"}


def tracked() -> list[Path]:
    names = subprocess.run(["git", "ls-files", *PLACES], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in names.split() if name.endswith((".py", ".md")) and (ROOT / name).is_file()]


@pytest.mark.parametrize("place", PLACES)
def test_cited_files_are_there(place: str) -> None:
    # Decisions and the page of figures also cite what their version had.
    pages = [path for path in tracked() if path.is_relative_to(ROOT / place) and path.parent.name != "decisions"]
    assert pages
    missing = {
        (str(path.relative_to(ROOT)), name)
        for path in pages
        for name in CITED.findall(path.read_text(encoding="utf-8"))
        if name not in MADE_UP and not (ROOT / name).is_file()
    }
    assert missing == set()


def test_nothing_outside_the_repository_is_cited() -> None:
    own = Path(__file__).resolve()
    found = {str(path) for path in tracked() if path != own and OUTSIDE.search(path.read_text(encoding="utf-8"))}
    assert found == set()
