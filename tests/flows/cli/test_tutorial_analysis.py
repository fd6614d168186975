"""Runs every block of docs/tutorial/own-analysis.md, in order, on a made-up campaign."""

import re
import shlex

import pytest

from fast.lake.store import Lake
from tests.flows.cli.cli_lakes import ROOT, Fast
from tests.flows.synthetic_lake import Campaign, build

TEXT = (ROOT / "docs" / "tutorial" / "own-analysis.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("analysis")
    build(Lake.open(folder / "lake-data", create=True), Campaign(campaign_id="quick"))
    return folder


def test_every_block_runs_in_order(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    names: dict = {}
    for language, block in BLOCKS:
        if language != "python" or (_lacks_polars() and "polars" in block):
            continue
        exec(compile(block, "own-analysis.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "'campaign_id': 'quick'" in printed
    assert re.search(r"6 measured and 10 simulated designs, rho -?\d", printed)
    assert len(names["features"]) > 0
    assert names["measured"].force_n.max() > 0.0
    for picture in ("quality.png", "trace.png"):
        assert (folder / picture).stat().st_size > 1000


def test_commands_write_their_files(folder, monkeypatch, capsys):
    monkeypatch.setenv("FAST_LAKE", str(folder / "lake-data"))
    monkeypatch.chdir(folder)
    fast = Fast(capsys)
    lines = [line for language, block in BLOCKS if language == "sh" for line in block.splitlines()]
    for line in lines:
        answer = fast(*shlex.split(line)[1:])
        assert answer.status == 0, answer.err
        assert (folder / shlex.split(line)[-1]).stat().st_size > 0
    assert len(lines) == 2


def test_only_what_is_run_or_printed_is_shown():
    assert {language for language, _ in BLOCKS} == {"python", "sh", "text"}


def _lacks_polars() -> bool:
    try:
        import polars  # noqa: F401 - only whether it is there
    except ImportError:
        return True
    return False
