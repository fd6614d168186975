"""The site is built without a warning, and reading it asks nothing of the network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import ROOT

_LOADED = re.compile(r"""<(?:script|link|img|iframe)\b[^>]*(?:src|href)=["']?((?:https?:)?//[^"'\s>]+)""")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the site, as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    built = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def test_the_site_can_be_searched(site: Path):
    assert "tool_quality" in (site / "search" / "search_index.json").read_text(encoding="utf-8")


def test_nothing_comes_from_the_network(site: Path):
    loaded = [url for page in site.rglob("*.html") for url in _LOADED.findall(page.read_text(encoding="utf-8"))]
    assert loaded == []


def test_what_comes_from_the_network_is_found():
    assert _LOADED.findall('<a href="https://a.b"> <link rel="x" href="https://c.d/e.css"><script src=//f.g>') == [
        "https://c.d/e.css",
        "//f.g",
    ]
