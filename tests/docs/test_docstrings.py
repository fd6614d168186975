"""Docstrings of functions begin with a verb, and their examples give what they say."""

import ast
import doctest
import importlib
import re
from collections.abc import Iterator
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


# With which the docstring of a function begins, in the imperative (PEP 257); a new verb is added here.
VERBS = frozenset(
    """
    Accept Add Adjust Advance Allow Answer Append Apply Approximate Ask Average Beat Begin Believe Bend Block Bound
    Bring Build Calculate Calibrate Call Carry Check Choose Clean Clear Close Collect Combine Come Compare Compile
    Complete Compress Compute Condition Confirm Connect Copy Count Create Cut Deal Decelerate Decide Declare Decode
    Define Delete Derive Describe Disconnect Distrust Divide Do Dock Draw Drive Drop Encode End Erode Estimate
    Evaluate Execute Expect Explain Export Extend Extrude Factorise Fall Fetch Fill Find Finish Fit Fold Follow
    Force Forecast Foresee Forget Format Free Freeze Gather Get Give Go Grade Group Grow Guard Guess Handle Hang
    Hash Have Hear Hold Home Identify Import Infer Integrate Interpolate Interrupt Invert Join Judge Keep Kill Latch
    Lay Learn Leave Lend Let Lift List Listen Load Log Look Lose Lower Make Map Mark Match Measure Merge Mesh Mirror
    Mix Mount Move Multiply Name Note Number Offer Open Order Overwrite Own Pack Pair Parse Part Pass Pick Pickle
    Ping Place Plan Play Point Poll Pool Post Power Predict Prepare Press Print Propose Prove Prune Push Put Queue
    Raise Rank Read Rebuild Record Refit Refuse Rehearse Release Remember Remind Remove Render Repeat Replace Replay
    Report Require Reset Resolve Restart Return Reverse Round Run Sample Save Say Scale Score Search See Select Send
    Serve Set Shift Shorten Show Simplify Simulate Sleep Slow Solve Spare Speak Spell Split Spread Stack Standardise
    Start Step Stop Store Strip Subtract Sum Summarise Swap Switch Take Tare Tell Thin Tie Train Travel Trust Try
    Tune Turn Typeset Undo Unpack Upload Wait Walk Watch Weigh Whiten Withdraw Work Write Yield Zero
    """.split()
)


def functions_with_docstrings() -> Iterator[tuple[str, str]]:
    """Place and docstring of every function of the product that is no property."""
    for path in sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_property(node):
                if text := ast.get_docstring(node):
                    yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", text


def is_property(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function is read like an attribute: its docstring says what it is."""
    names = {ast.unparse(one).split("(")[0].split(".")[-1] for one in node.decorator_list}
    return bool(names & {"property", "cached_property", "setter"})


def test_docstrings_of_functions_begin_with_a_verb():
    firsts = {place: text.split()[0].strip(",.;:") for place, text in functions_with_docstrings()}
    assert len(firsts) > 4000
    assert {place: first for place, first in firsts.items() if first not in VERBS} == {}
    before_of = VERBS - {"Remind", "Tell"}  # nouns, as in "Answer of the server"
    assert [place for place, text in functions_with_docstrings() if set(text.split(" of ")[:1]) & before_of] == []
