"""Campaigns that ask for what an arm cannot do: refused before the lake is written and before a person is asked."""

import shutil
from pathlib import Path

import pytest

from tests.flows.cli.cli_lakes import Fast

ROOT = Path(__file__).parents[3]
CONFIG = """
name = "by-arm"
[schedule]
initial_tools = 3
tools_per_batch = 3
guided_batches = 1
[objects]
ids = [2, 14]
[bench]
world = "quick.toml"
real = "arm.toml"
"""
ARM = """
kind = "ur"
host = "127.0.0.1"
travel_z_mm = 480
rack_mm = [[-300, -400, 260], [-170, -400, 260], [-40, -400, 260]]
[mounts_mm]
2 = [250, -350, 40]
14 = [400, -350, 40]
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[objects]",
            "[grasp]\nclosed_gap_mm = 20\n[objects]",
            "closed_gap_mm 20 mm was asked for, but this bench has",
        ),
        ("batch = 3", "batch = 4", "arm.toml: rack_mm has 3, a batch has 4 tools; add slots"),
        ("batch = 3", "batch = 3\nreference_tools = 1", "reference tools hang in the last of 10 slots, rack_mm has 3"),
        ("[2, 14]", "[2, 14, 30]", "arm.toml: mounts_mm has no place of cube (30); teach and add it"),
    ],
)
def test_what_the_arm_cannot_do_is_refused_before_anything_is_written(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, words: str
) -> None:
    shutil.copy(ROOT / "worlds" / "quick.toml", tmp_path)
    (tmp_path / "by-arm.toml").write_text(CONFIG.replace(old, new))
    (tmp_path / "arm.toml").write_text(ARM)
    lake = tmp_path / "lake"
    assert words in Fast(capsys).refused("campaign", "run", tmp_path / "by-arm.toml", "--real", "--lake", lake)
    assert not lake.exists()


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        ("[layout]\nn_slots = 2", "arm.toml: layout.n_slots is 2, a batch has 3 tools; add slots"),
        ("[layout]\nn_places = 9", "arm.toml: Object 14 has no place on the bench; use an id from 0 to 8"),
        ("[layout]\ndock_y_mm = 1600", "arm.toml: Tool slot 0 stands at x 165, y 1600 mm, the workspace ends at"),
    ],
)
def test_what_the_gantry_cannot_do_is_refused_before_anything_is_written(capsys, tmp_path, bench, words):
    shutil.copy(ROOT / "worlds" / "quick.toml", tmp_path)
    (tmp_path / "by-arm.toml").write_text(CONFIG)
    (tmp_path / "arm.toml").write_text(bench)
    lake = tmp_path / "lake"
    assert words in Fast(capsys).refused("campaign", "run", tmp_path / "by-arm.toml", "--real", "--lake", lake)
    assert not lake.exists()
