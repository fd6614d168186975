"""Runs the commands of docs/how-to/drive-an-arm.md: a virtual arm in a process of its own, and a campaign on it."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fast.hardware.arm.settings import ArmSettings
from fast.lake.store import Lake
from fast.tasks.campaign.setup import read_bench, read_real_bench
from tests.docs.pages import DOCS, blocks_of
from tests.docs.test_own_bench_pages import commands_of

ROOT = Path(__file__).parents[2]
PAGE = DOCS / "how-to" / "drive-an-arm.md"
CONFIG, BENCH = [block.text for block in blocks_of(PAGE, "toml")]
FAST = (sys.executable, "-m", "fast.flows.cli.main")
HOST = f"127.0.{os.getpid() % 200 + 20}.9"  # an address of this test, so that port 30004 is free


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The page's virtual arm, in the folder where the page's commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "worlds").mkdir()
    shutil.copy(ROOT / "worlds" / "quick.toml", tmp_path / "worlds")
    # A third as long.
    config = CONFIG.replace("ids = [2, 14]", "ids = [2]").replace("tools_per_batch = 3", "tools_per_batch = 1")
    (tmp_path / "by-arm.toml").write_text(config)
    start = commands_of(PAGE)[0]
    words = [*start[: start.index("--speed-up")], "--speed-up", "25", "--host", HOST]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([*FAST, *words], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    assert "RTDE port 30004" in process.stdout.readline()
    yield
    process.terminate()
    process.communicate(timeout=30)


@pytest.mark.slow
def test_a_campaign_is_measured_by_the_arm(arm: None) -> None:
    command = [sys.executable, "-m", "tests.flows.undrawn_fast", *commands_of(PAGE)[1]]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    began_s = time.monotonic()
    done = subprocess.run(
        command, env=environment | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "a rehearsal: all its addresses are virtual" in done.stderr
    lake = Lake.open("lake-data")
    grasps = lake.query("SELECT batch, status, bench, peak_force_n FROM grasps").to_pylist()
    assert sorted(row["batch"] for row in grasps) == [1, 2, 3, 4]
    assert {(row["status"], row["bench"]) for row in grasps} == {("ok", "real")}
    assert len({round(row["peak_force_n"], 1) for row in grasps}) == 4  # the lake's own designs hang in the rack
    assert Path("lake-data/outputs/by-arm/report/index.html").exists()
    assert time.monotonic() - began_s < 300


def test_the_bench_file_of_the_page_is_read(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(BENCH)
    settings = read_real_bench(path)
    assert isinstance(settings, ArmSettings)
    assert settings.mounts_mm[14] == (400, -350, 40)
    with pytest.raises(Exception, match="bench file of another machine"):
        read_bench(path)
