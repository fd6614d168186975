"""Examples in docstrings give what they say."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

from tests.docs.pages import ROOT

LAYERS = ("flows", "tasks", "lake", "hardware", "models")


def modules_with_examples() -> list[str]:
    """Names of the modules that hold a `>>>` line."""
    paths = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))
    holds = [path for path in paths if re.search(r"^\s*>>> ", path.read_text(encoding="utf-8"), flags=re.M)]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in map(Path, holds)]


MODULES = modules_with_examples()


def test_there_are_examples():
    assert MODULES


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name: str):
    module = importlib.import_module(f"fast.{name}")
    result = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert result.attempted > 0
    assert result.failed == 0
