"""The runner of studies: its commands, options and refusals."""

import re
import subprocess
import sys

import pytest

from fast.flows.cli.main import run
from tests.flows.cli.cli_lakes import ROOT
from tests.studies.__main__ import Chosen, app
from tests.studies.benchmarks.base import Options
from tests.studies.registry import STUDIES


def test_every_study_says_what_it_measures_and_has_options_of_the_command_line() -> None:
    assert all(study.about for study in STUDIES.values())
    asked = {option for study in STUDIES.values() for option in study.options}
    assert asked == set(vars(Chosen())) == set(vars(Options())) - {"tell"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["kills", "--worlds", "3"], "`kills` has no option --worlds"),
        (["host-kills", "--n", "0"], "--n is 0, at least 1 is needed"),
        (["gap-sealt"], "there is no study `gap-sealt`; did you mean `gap-sealed`?"),
        (["kills", "--grips", "3"], "See `python -m tests.studies --help`"),
        (["grasp", "--objects", "1,x"], "--objects `1,x` is no list of object ids"),
        (["grasp", "--objects", "36"], "object 36 does not exist"),
        (["grasp", "--tiers", "productoin"], "there is no tier `productoin`; did you mean `production`?"),
        (["grasp", "--designs", "0"], "--designs is 0, at least 1 is needed"),
        (["lake", "--grasps", "many"], "--grasps `many` is no list of numbers of grasps"),
    ],
)
def test_wrong_use_is_refused(capsys: pytest.CaptureFixture[str], words: list[str], sentence: str) -> None:
    assert run(words, app) == 2
    assert sentence in capsys.readouterr().err


def test_every_study_guards_a_claim() -> None:
    page = (ROOT / "docs" / "reference" / "studies.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| `([\w-]+)` \|", page, flags=re.M)) == sorted(STUDIES)


def test_it_runs_as_a_module() -> None:
    command = [sys.executable, "-m", "tests.studies", "list"]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    assert [line.split()[0] for line in answer.stdout.splitlines()] == list(STUDIES)
