"""The live display of long commands: what it shows, and that a log gets plain lines."""

import io
import re
import shlex
import sys

import pytest
from rich.console import Console

from fast.flows.cli.campaign import _outcome_text
from fast.flows.cli.common import DEFAULT_LAKE
from fast.flows.cli.live import describe_left, is_watched, open_display, open_reporter
from fast.flows.cli.main import app
from fast.flows.progress import UNKNOWN, Bar

GRASPS = Bar("grasps", 3, 4, 90.0)
SIMULATED = Bar("simulated", 8, 8, 0.0)


def strip_codes(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)


def test_bars_show_counts_what_is_left_and_the_last_forces():
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=100, highlight=False)
    with open_display(console) as reporter:
        for force_n in (1.0, 2.0, 3.0, 23.9):
            reporter.report(f"B01T2 on cone (24), repeat 1: {force_n} N", [GRASPS, SIMULATED])
        reporter.announce("A person is needed: print [batch] B02")
        shown = strip_codes(screen.getvalue())
    last = shown[shown.rindex("2.0 N") :]
    assert "3.0 N" in last
    assert "23.9 N" in last
    assert re.search(r"grasps +[━╸╺]+ +3/4 +2 min left", last)
    assert re.search(r"simulated +━+ +8/8 +done", last)
    assert "A person is needed: print [batch] B02" in shown  # as it is, not as markup
    assert "\x1b[2K" in screen.getvalue()[-60:]  # the bars go, so that the result stands alone


@pytest.mark.parametrize(
    ("bar", "words"),
    [(GRASPS, "2 min left"), (SIMULATED, "done"), (Bar("grasps", 1, 4, None), UNKNOWN), (Bar("x", 0, 0, 0.0), "done")],
)
def test_what_is_left_of_one_kind_of_work(bar, words):
    assert describe_left(bar) == words


def test_a_log_gets_plain_lines(capsys):
    assert not is_watched()
    with open_reporter() as reporter:
        reporter.report("B01T2 on cone (24), repeat 1: 23.9 N", [GRASPS, SIMULATED])
    line = capsys.readouterr().err
    assert line[8:] == "  B01T2 on cone (24), repeat 1: 23.9 N  |  grasps 3/4, simulated 8/8  |  2 min left\n"


def test_a_terminal_that_cannot_be_written_over_gets_lines(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "dumb")
    assert not is_watched()
    monkeypatch.setenv("TERM", "xterm")
    assert is_watched()


def test_the_last_lines_of_a_campaign_say_what_to_open_and_what_to_try(tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_LAKE", raising=False)
    report = tmp_path / "outputs" / "demo" / "report" / "index.html"
    best = {"tool_id": "demo/B02T1", "tool_quality_n": 16.2, "n_objects": 4}
    data = {"campaign": "demo", "complete": True, "best_tool": best, "times_reference": None, "tools": [best],
            "report": str(report), "recording": str(tmp_path / "demo.rrd"), "ended_by": None}  # fmt: skip
    lines = _outcome_text(data, tmp_path).splitlines()
    assert f"Open the report: {report.as_uri()}" in lines
    tried = [line.strip().partition("   ")[0] for line in lines if line.startswith("    fast ")]
    assert tried[:2] == [f"fast view demo --lake {tmp_path}", f"fast view demo/B02T1 --lake {tmp_path}"]
    for line in tried:
        app.parse_args(shlex.split(line)[1:])  # as it stands, it is a command
    assert "fast gap --example" in tried
    assert not any("--lake" in line for line in _outcome_text(data, DEFAULT_LAKE).splitlines())
    monkeypatch.setenv("FAST_LAKE", str(tmp_path))
    assert not any("--lake" in line for line in _outcome_text(data, tmp_path).splitlines())
    data["tools"] = [best | {"n_objects": n} for n in (4, 5, 5, 5, 5, 5, 5)]
    assert "gap --dry-run" not in _outcome_text(data, tmp_path)
    data["tools"] = [best | {"n_objects": 5}] * 7
    assert "fast gap --dry-run" in _outcome_text(data, tmp_path)
