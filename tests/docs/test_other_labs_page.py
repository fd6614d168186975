"""Runs the commands of docs/how-to/work-with-other-labs.md: two labs, one config, and what they have in common."""

import csv
import json
from pathlib import Path

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import FitRow
from tests.docs.pages import DOCS, blocks_of
from tests.docs.test_own_bench_pages import commands_of
from tests.flows.cli.cli_lakes import Fast

PAGE = DOCS / "how-to" / "work-with-other-labs.md"
CONFIG, PRIOR = [block.text for block in blocks_of(PAGE, "toml")]
DELFT_FACTOR = 1.25  # Delft's fingers are of a stiffer lot


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fast:
    monkeypatch.chdir(tmp_path)
    Path("turin.toml").write_text(CONFIG)
    Path("delft.toml").write_text(CONFIG.replace('lab = "turin"', 'lab = "delft"') + PRIOR)
    return Fast(capsys)


def measure(results: Path, factor: float) -> None:
    """Fill in the table: the higher the slot, the stronger; repeats differ by 0.1 N."""
    rows = list(csv.DictReader(results.read_text().splitlines()))
    with results.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        for row in rows:
            force_n = factor * (10.0 + 2 * int(row["tool_id"][-1]) + int(row["object_id"]) / 10)
            writer.writerow(row | {"peak_force_n": force_n + 0.1 * int(row["repeat"])})


def test_two_labs_measure_learn_and_are_compared(fast: Fast) -> None:
    asked, told, exported, imported, ask, tell, ask_more, compare = commands_of(PAGE)
    assert fast(*asked).status == 0
    measure(Path("turin-B01/results.csv"), 1.0)
    for command in (told, exported, imported, ask):
        done = fast(*command)
        assert done.status == 0, done.err
    measure(Path("delft-B01/results.csv"), DELFT_FACTOR)
    assert fast(*tell).status == 0
    assert fast(*ask_more).status == 0

    lake = Lake.open("delft-lake")
    designs = lake.query("SELECT lab, list(DISTINCT design_id ORDER BY design_id) AS d FROM grasps GROUP BY lab")
    both = {row["lab"]: row["d"] for row in designs.to_pylist()}
    assert both["turin"] == both["delft"]  # one config, one set of first fingers
    ids = lake.query("SELECT grasp_id, lab FROM grasps").to_pylist()
    assert all(row["grasp_id"].startswith(f"{row['lab']}.K") for row in ids)
    (fit,) = lake.rows(FitRow, purpose="tools")
    assert (fit["n_real"], fit["n_prior"] in (0, 4)) == (4, True)
    assert fit["without_prior_loo_rmse_n"] > 0

    shown = json.loads(fast(*compare, "--json").out)
    bias = {row["lab"]: row["bias"]["mean"] for row in shown["labs"]}
    expected = (DELFT_FACTOR - 1) / (DELFT_FACTOR + 1)
    assert bias["delft"] == pytest.approx(expected, rel=0.02)
    assert bias["turin"] == pytest.approx(-expected, rel=0.02)
    assert shown["overall"]["repeat_sd_n"] == pytest.approx(0.1 / 2**0.5, rel=0.01)
    text = Path(shown["report"]).read_text(encoding="utf-8")
    assert "4 designs that each lab printed" in text
    assert "14 tube" in text


def test_a_lake_of_one_lab_cannot_be_compared(fast: Fast) -> None:
    asked, told = commands_of(PAGE)[:2]
    fast(*asked)
    measure(Path("turin-B01/results.csv"), 1.0)
    fast(*told)
    done = fast("lake", "labs", "--lake", "turin-lake")
    assert done.status == 2
    assert "no finger that two labs measured" in done.err
    assert "turin" in done.err


def test_a_prior_campaign_that_the_lake_lacks_is_named(fast: Fast) -> None:
    done = fast("ask", "delft.toml", "--lake", "empty-lake", "--out", "B01")
    assert done.status == 2
    assert "the lake has no campaign `turin.robin`" in done.err
    assert not Path("B01").exists()
