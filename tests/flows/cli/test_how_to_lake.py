"""Runs the code of the how-to pages about import, export and reading the lake, as it is printed there."""

import re
import shlex

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from tests.flows.cli.cli_lakes import ROOT, Fast
from tests.flows.synthetic_lake import Campaign, build

PAGES = (ROOT / "docs" / "how-to" / name for name in ("use-python.md", "exchange-data.md"))
HOW_TO = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)


def blocks(title: str, language: str) -> list[str]:
    """Fenced code of one section, in order."""
    section = HOW_TO.split(f"\n## {title}\n")[1].split("\n## ")[0]
    return re.findall(rf"```{language}\n(.*?)```", section, flags=re.S)


PYTHON = blocks("Read the lake with your own tools", "python")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a measured campaign `quick` in `lake-data`."""
    folder = tmp_path_factory.mktemp("how-to")
    build(Lake.open(folder / "lake-data", create=True), Campaign(campaign_id="quick", n_measured_batches=1))
    return folder


@pytest.fixture
def fast(capsys, monkeypatch, folder):
    monkeypatch.delenv("FAST_LAKE", raising=False)
    monkeypatch.chdir(folder)
    return Fast(capsys)


def run_lines(fast: Fast, text: str) -> None:
    for line in text.splitlines():
        program, *words = shlex.split(line, comments=True)
        assert program == "fast"
        answer = fast(*words)
        assert answer.status == 0, answer.err


def test_the_guide_has_a_way_in_for_everyone():
    text = "\n".join(PYTHON)
    assert len(PYTHON) == 7
    assert all(len(list(filter(None, block.splitlines()))) <= 4 for block in PYTHON)
    for word in ("pyarrow", "to_pandas", "polars", "connect()", "lake.trace", "duckdb"):
        assert word in text, word


@pytest.mark.parametrize("block", PYTHON, ids=range(len(PYTHON)))
def test_each_way_in_gives_rows(fast, folder, block):
    for module in re.findall(r"import (polars|pandas)", block) + ["pandas"] * ("to_pandas" in block):
        pytest.importorskip(module)
    names: dict = {}
    exec(compile(block, "use-python.md", "exec"), names)
    results = [names[name] for name in ("table", "frame", "quality", "trace", "grasps") if name in names]
    assert len(results) == 1
    n_grasps = len(Lake.open(folder / "lake-data").ids(GraspRow))
    (found,) = results
    if "trace" in names:
        assert found.force_n.shape == found.time_s.shape
    elif "sim_vs_real" in block:
        assert "gap_n" in found.column_names
    else:
        assert len(found) == (n_grasps if "tool_quality" not in block else 3)


def test_files_for_other_programs_hold_the_rows(fast, folder):
    (block,) = blocks("Read the lake with your own tools", "sh")
    run_lines(fast, block)
    n_grasps = len(Lake.open(folder / "lake-data").ids(GraspRow))
    assert len((folder / "grasps.csv").read_text().splitlines()) == n_grasps + 1
    assert (folder / "grasps.parquet").stat().st_size > 0
    assert 1 < len((folder / "tool.csv").read_text().splitlines()) < n_grasps + 1


def test_data_reach_another_lake(fast, folder):
    (block,) = blocks("Exchange data with another lab", "sh")
    run_lines(fast, block)
    other = Lake.open(folder / "other-lake")
    assert other.ids(GraspRow, campaign_id="import-handoff") == Lake.open(folder / "lake-data").ids(GraspRow)
    assert fast("campaign", "status", "import-handoff", "--lake", "other-lake", "--json").json["state"] == "imported"


def test_files_of_another_format_come_in(fast, folder, monkeypatch):
    (code,) = blocks("Import files of another format", "python")
    (command,) = blocks("Import files of another format", "sh")
    (folder / "mylab.py").write_text(code)
    (folder / "pulls").mkdir()
    (folder / "pulls" / "pulls.csv").write_text("t,z,grams\n0,0,0\n0.1,0.5,1000\n0.2,1,10\n")
    run_lines(fast, command)
    (row,) = Lake.open(folder / "other-lake").rows(GraspRow, grasp_id="pull-1")
    assert (row["campaign_id"], row["peak_force_n"]) == ("import-pulls", pytest.approx(9.80665))
    (folder / "mylab.py").write_text(code.replace('"object_id": [3]', '"object_id": [36]'))
    answer = fast(*shlex.split(command)[1:])
    assert answer.status == 2
    assert "grasps.csv row 2, object_id = '36': must be 0 to 35, or an own object" in answer.err
