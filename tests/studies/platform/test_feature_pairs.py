"""Campaigns with many features each, one for each kind of bench, by `make studies`; and pairs refused by design."""

from pathlib import Path

import pytest

from fast.flows.cli.main import run
from tests.studies.platform import feature_pairs
from tests.studies.platform.feature_list import REFUSED, levels, plain_case
from tests.studies.platform.feature_pairs import run_case, try_refused
from tests.studies.platform.pairwise import all_pairs, cover_pairs, pairs_of

CASES = {
    "folder": {
        "family": "graded-fin-ray", "objects": "own on a place", "objectives": "two", "ranges": "narrow",
        "lab": "turin", "prior": "one", "reference tools": "best", "reference finger": "fin-ray", "recipe": "polyjet",
        "material": "lot",
    },
    "gantry": {
        "family": "slotted:Slotted", "objects": "own", "designs": "own", "night": "on", "surrogate": "log",
    },
    "arm": {"family": "free-form", "objects": "own on a place", "gap": "on", "reference tools": "best"},
}  # fmt: skip


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands run in this process, which has imported what they need."""

    def command(folder: Path, *words: str) -> tuple[int, str]:
        monkeypatch.chdir(folder)
        capsys.readouterr()
        status = run([*words, "--lake", "lake"])
        return status, "".join(capsys.readouterr())

    monkeypatch.setattr(feature_pairs, "command", command)


@pytest.mark.study
@pytest.mark.parametrize("bench", CASES)
def test_a_campaign_with_many_features_comes_to_its_report(tmp_path: Path, bench: str) -> None:
    campaign = run_case(plain_case() | {"bench": bench} | CASES[bench], tmp_path / "case")
    assert campaign.problem == ""


@pytest.mark.parametrize("pair", REFUSED, ids=lambda pair: ", ".join(sorted(level for _, level in pair)))
def test_a_pair_that_is_refused_says_so_before_anything_is_written(tmp_path: Path, pair: frozenset) -> None:
    assert try_refused(pair, tmp_path / "case")["problem"] == ""


def test_the_cases_hold_every_pair_but_those_that_are_refused() -> None:
    cases = cover_pairs(levels(), set(REFUSED))
    assert len(cases) <= 25
    assert set().union(*map(pairs_of, cases)) == all_pairs(levels()) - set(REFUSED)
