"""Files of testing machines, told to a campaign on a bench of one's own."""

import random
from pathlib import Path

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.design.fin_ray import FinRay
from fast.tasks.bench.machine_files.grid import LARGEST_MB
from tests.flows.cli.cli_lakes import ROOT, Fast

CASES = ROOT / "tests" / "data" / "cases"
HEADER = ["name", *FinRay.model_fields]
DESIGNS = (
    ",".join(HEADER)
    + """
Stiff one,32.3,32,99.5,22.3,2.9,2.9,2.9,7,-10
soft,27.1,30.2,104.6,23.7,2.2,2.3,2.1,5,12.5
soft,27.1,30.2,104.6,23.7,2.2,2.3,2.1,6,12.5
"""
)


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fast:
    """A campaign with three own designs, asked."""
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_text(DESIGNS)
    text = (CASES / "people" / "pull.toml").read_text().replace("seed = 1", 'seed = 1\ndesigns = "mine.csv"', 1)
    Path("pull.toml").write_text(text)
    fast = Fast(capsys)
    assert fast("ask", "pull.toml").status == 0
    return fast


def rows() -> list:
    return Lake.open("lake-data").rows(GraspRow)


def test_a_guess_is_shown_with_its_first_samples_and_peaks(fast: Fast) -> None:
    told = fast("tell", "pull.toml", CASES / "machine-cycles" / "B01T0_2.csv", "--format", "utm.toml")
    assert told.status == 0, told
    assert "nothing was written (look at utm.toml, then give the same command again)" in told.out
    assert 'file_name = "{tool}_{object}.csv"' in told.err
    assert '[cycle]\nname = "Cycle"' in told.err
    assert "  0.05   0.1875   0.1185" in told.err
    pulls = [line.split() for line in told.err.splitlines() if line.startswith("B01T0_2.csv  ")]
    assert [(pull[3], pull[4], pull[-2], pull[-1]) for pull in pulls] == [
        ("0", "161", "6", "14.81"),
        ("1", "161", "5.8", "14.81"),
        ("2", "161", "5.9", "14.81"),
    ]
    assert "samples of the way back were left out" in told.err
    assert rows() == []


def test_a_dry_run_leaves_no_guess_behind(fast: Fast) -> None:
    told = fast("tell", "pull.toml", CASES / "machine-cycles" / "B01T0_2.csv", "--format", "utm.toml", "--dry-run")
    assert told.status == 0, told
    assert "utm.toml is not there: guessed:\n" in told.err
    assert "nothing was written (--dry-run)" in told.out
    assert not Path("utm.toml").exists()


@pytest.mark.parametrize("name", ["Stiff one", "stiff_one"])
def test_a_design_names_its_tool(fast: Fast, name: str) -> None:
    data = (CASES / "machine-summary" / "B01T0_2_0.csv").read_bytes()
    (path := Path(f"{name}_2_0.csv")).write_bytes(data)
    told = fast("tell", "pull.toml", path, "--format", "utm.toml")
    assert (told.status, rows()) == (0, []), told
    assert 'file_name = "{tool}_{object}_{repeat}.csv"' in Path("utm.toml").read_text()
    assert fast("tell", "pull.toml", path, "--format", "utm.toml", "--sure").status == 0
    (row,) = rows()
    assert row["tool_id"].endswith("/B01T0")
    Path("results.csv").write_text(f"tool_id,object_id,repeat,peak_force_n\n{name},14,0,5.5\n")
    assert fast("tell", "pull.toml", "results.csv", "--sure").status == 0
    assert len(rows()) == 2


def test_a_name_of_two_designs_is_asked_about(fast: Fast) -> None:
    Path("results.csv").write_text("tool_id,object_id,repeat,peak_force_n\nsoft,14,0,5.5\n")
    assert "`soft` was printed as" in fast.refused("tell", "pull.toml", "results.csv")
    assert rows() == []


JUNK = {
    "empty": b"",
    "random": random.Random(0).randbytes(3000),
    "zeros": bytes(3000),
    "letters": b"lorem ipsum " * 500,
    "one line": b"1,2,3",
    "head alone": b"Time,Extension,Load\n(s),(mm),(N)\n",
    "infinite": b"Time (s),Extension (mm),Load (N)\n" + b"1,nan,inf\n" * 40,
    "overflow": b"Time (s),Extension (mm),Load (N)\n" + b"1,2,1e999\n" * 40,
    "one long cell": b'"' + b"x" * 300_000,
    "torn spreadsheet": b"PK\x03\x04" + bytes(100),
    "old spreadsheet": b"\xd0\xcf\x11\xe0" + bytes(100),
    "pdf": b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n" + b"1 0 obj\n" * 50,
    "escapes": b"Time,Extension,Load\n" + b"\x1b[31m1,2,3\n" * 40,
    "no force": b"Time (s),Extension (mm)\n" + b"".join(b"%d,%d\n" % (n, n) for n in range(40)),
    "constant": b"Time (s),Extension (mm),Load (N)\n" + b"1,2,3\n" * 40,
    "one million": b"Time (s),Extension (mm),Load (N)\n" + b"".join(b"%d,%d,1000000\n" % (n, n) for n in range(40)),
}


def test_what_is_no_pull_is_refused_in_a_sentence_and_nothing_is_written(fast: Fast) -> None:
    Path("known.toml").write_text('[lift]\nname = "Extension"\n[force]\nname = "Load"\n')
    for kind, content in JUNK.items():
        Path("B01T0_2_0.csv").write_bytes(content)
        refused = fast.refused("tell", "pull.toml", "B01T0_2_0.csv", "--format", "known.toml")
        assert refused.endswith("."), kind
        if kind not in ("constant", "one million"):  # these can be read, and are refused as pulls
            fast.refused("tell", "pull.toml", "B01T0_2_0.csv", "--format", "utm.toml")
            assert not Path("utm.toml").exists(), kind
    with Path("B01T0_2_0.csv").open("wb") as file:
        file.truncate(int(1.1e6 * LARGEST_MB))
    assert f"at most {LARGEST_MB} MB" in fast.refused("tell", "pull.toml", "B01T0_2_0.csv", "--format", "known.toml")
    assert "cannot be read" in fast.refused("tell", "pull.toml", "B01T0_2_1.csv", "--format", "utm.toml")
    assert rows() == []
