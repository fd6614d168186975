"""Kills aimed at steps of a phase, and a judge that finds what a bad writer leaves."""

from pathlib import Path

import pytest

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow
from fast.models.design.space import BEST_PUBLISHED
from tests.studies.benchmarks.base import Options
from tests.studies.crash import aimed
from tests.studies.crash.phases import Phase

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # it forks
N_KILLS = 5
PROVENANCE = Provenance(code_version="x", code_dirty=False)


def write(folder: Path) -> None:
    """What a phase of the product does: rows of two appends."""
    lake = Lake.open(folder / "lake", create=True)
    for height_mm in (95.0, 100.0):
        lake.append([DesignRow.of(BEST_PUBLISHED.model_copy(update={"height_mm": height_mm}))], PROVENANCE)


def write_badly(folder: Path) -> None:
    """The same by a writer that gives a file its name before it is whole."""
    write(folder)
    path = folder / "lake" / "designs" / "rows-0123456789abcdef01234567.parquet"
    path.write_bytes(b"PAR1 half")
    path.unlink()


def kill(folder: Path, work: object) -> dict[str, object]:
    phase = Phase("some", None, work)  # type: ignore[arg-type] - a stand-in for a phase
    start = aimed._begin(folder, phase, folder / "life")
    life = aimed._in_child(aimed._counted, start, phase)
    life["content"] = aimed._in_child(aimed._look, start)["content"]
    return aimed._kill_phase(folder, phase, life, N_KILLS, lambda _: None)


@pytest.mark.slow
def test_a_writer_of_the_product_is_killed_at_its_steps_and_leaves_nothing_wrong(tmp_path):
    row = kill(tmp_path, write)
    assert row["kills"] == N_KILLS
    assert row["steps"] >= 8
    assert row["lakes_half_way"] > 0
    assert row["problems"] == 0, row["first_problem"]


@pytest.mark.slow
def test_a_bad_writer_is_found(tmp_path):
    row = kill(tmp_path, write_badly)
    assert row["problems"] > 0
    assert "is not a whole Parquet file" in row["first_problem"]


def test_steps_are_spread_from_the_first_to_the_last():
    assert aimed._spread(list(range(1, 101)), 3) == [1, 51, 100]
    assert aimed._spread([4, 5], 10) == [4, 5]
    assert aimed._spread([], 3) == aimed._spread([1], 0) == []


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_a_campaigns_life_stands_aimed_kills_and_full_disks():
    tables = aimed.measure_aimed_kills(Options(n=10))
    assert all(row["kills"] >= 10 and row["problems"] == 0 for row in tables["kills"]), tables
    assert all(row["problems"] == 0 for row in tables["full"]), tables
