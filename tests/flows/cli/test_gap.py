"""`fast gap`."""

from pathlib import Path

import pytest

from fast.lake.store import Lake
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.flows.cli.cli_lakes import Fast


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str]) -> Fast:
    return Fast(capsys)


def test_the_catalogue_for_people_and_machines(fast: Fast) -> None:
    text = fast("gap", "--catalogue").out
    for spec in CATALOGUE.values():
        assert spec.effect in text
    assert "cost P: post-processing" in text
    rows = fast("gap", "--catalogue", "--json").json
    assert {row["effect"] for row in rows} == set(CATALOGUE)
    assert {"law", "source", "parameters", "scales_with_modulus", "cost", "confusable_with", "alias_of"} < set(rows[0])


def test_a_lake_with_nothing_to_search_is_refused_in_a_sentence(fast: Fast, tmp_path: Path) -> None:
    assert "is not a lake" in fast.refused("gap", "--lake", str(tmp_path / "none"))
    Lake.open(tmp_path / "empty", create=True)
    assert "has no measured grasps; measure tools" in fast.refused("gap", "--lake", str(tmp_path / "empty"))
    assert "has no measured grasps" in fast.refused("gap", "--dry-run", "--lake", str(tmp_path / "empty"))
    few = fast.refused("gap", "--objects", "1", "--lake", str(tmp_path / "empty"))
    assert "a panel of 1 objects tells nothing, 2 are the least" in few
