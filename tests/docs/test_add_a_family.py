"""Runs the code of docs/how-to/add-a-family.md as it is printed there: one finger, and a campaign of them."""

import json
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fast.lake.tables.campaign import DesignRow
from fast.models.design.families import check_section, find_family, read_design
from fast.models.errors import ConfigError, UsageError
from fast.models.records import Design
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.version import MeshSettings
from fast.tasks.campaign.config import load_config
from fast.tasks.scientist.propose import propose_guided
from tests.docs.pages import DOCS, ROOT, blocks_of
from tests.flows.cli.cli_lakes import WORLD, Fast
from tests.tasks.campaign.small_campaign import begun, small_campaign

PAGE = DOCS / "how-to" / "add-a-family.md"
(CLASS,) = [block.text for block in blocks_of(PAGE, "python")]
(FINGER,) = [block.text for block in blocks_of(PAGE, "json")]
(CONFIG,) = [block.text for block in blocks_of(PAGE, "toml")]
(SQL,) = [block.text for block in blocks_of(PAGE, "sql")]
NAME = "slotted:Slotted"


@pytest.fixture(autouse=True)
def slotted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's class as `slotted.py` in the present folder."""
    (tmp_path / "slotted.py").write_text(CLASS)
    (tmp_path / "finger.json").write_text(FINGER)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "slotted", raising=False)


def write_campaign(folder: Path, design: str) -> Path:
    config = folder / "own.toml"
    quick = (ROOT / "campaigns" / "quick.toml").read_text()
    config.write_text(quick.replace("../worlds/quick.toml", str(WORLD)) + design)
    return config


def test_the_class_is_short() -> None:
    assert len(CLASS.splitlines()) < 150


def test_random_fingers_can_be_meshed_and_keep_the_limits_of_the_page(tmp_path: Path) -> None:
    space = load_config(write_campaign(tmp_path, CONFIG)).design.space
    fingers: list[Any] = list(space.random_designs(8, np.random.default_rng(1)))
    assert all(f.wall_mm + f.rib_mm <= 7.0 and 2.0 <= f.wall_mm <= 3.0 for f in fingers)
    assert {f.ribs for f in fingers} == {"soft", "hard"}
    for finger in fingers:
        check_section(finger)
        assert len(build_mesh(finger, MeshSettings()).nodes) > 100


def test_hard_ribs_hold_otherwise_than_soft_ones(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    fast = Fast(capsys)
    hard = fast("simulate", "--design", "finger.json", "--object", "30", "--json").json
    (tmp_path / "soft.json").write_text(json.dumps(json.loads(FINGER) | {"ribs": "soft"}))
    soft = fast("simulate", "--design", "soft.json", "--object", "30", "--json").json
    assert abs(hard["peak_force_n"] - soft["peak_force_n"]) > 0.1


def test_a_campaign_measures_keeps_and_proposes_such_fingers(tmp_path: Path) -> None:
    campaign = begun(small_campaign(tmp_path, design=tomllib.loads(CONFIG)["design"]))
    propose_guided(campaign, 2)
    tools = campaign.state().tools
    assert len(tools) == 4
    assert {type(tool.design).__name__ for tool in tools} == {"Slotted"}
    rows = campaign.lake.query(SQL).to_pylist()
    assert {int(row["slots"]) for row in rows} <= set(range(1, 9))
    assert len(rows) == 2
    row = campaign.lake.records(DesignRow, design_id=tools[0].design.design_id)[0]
    assert row.design == tools[0].design
    assert row.rib_count is None
    assert row.height_mm == tools[0].design.height_mm


def test_what_the_class_forbids_is_one_sentence(tmp_path: Path) -> None:
    values = {name: value for name, value in json.loads(FINGER).items() if name != "family"}
    with pytest.raises(ConfigError, match="`slot_count` is 9, it must be at most 8; change it"):
        read_design(NAME, values | {"slot_count": 9})
    for wrong, words in (
        ("ranges = {wall_mm = [1.0, 3.0]}", "wall_mm"),
        ("ranges = {rib_count = [1, 3]}", "rib_count"),
        ("limits = [{of = {wall_mm = 1.0}, at_most = 1.5}]", "keep the limits of the design space"),
    ):
        with pytest.raises(ConfigError, match=words) as refused:
            load_config(write_campaign(tmp_path, f'[design]\nfamily = "{NAME}"\n{wrong}\n'))
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("drawn", "words"),
    [
        ("return wedge.buffer(3.0)", "ends at x .* it must stay within length"),
        ("return wedge.difference(Polygon([(-1, 40), (99, 40), (99, 60), (-1, 60)]))", "no single valid polygon"),
        ("return wedge.intersection(wedge.buffer(-1)).buffer(0)", "must stay within length .* and reach height"),
    ],
)
def test_a_section_that_cannot_be_made_is_refused_before_anything_is_printed(
    tmp_path: Path, drawn: str, words: str
) -> None:
    (tmp_path / "slotted.py").write_text(CLASS.replace("return wedge\n", f"{drawn}\n"))
    with pytest.raises(ConfigError, match=words):
        load_config(write_campaign(tmp_path, f'[design]\nfamily = "{NAME}"\n'))


def test_unknown_families_are_named() -> None:
    with pytest.raises(UsageError, match="did you mean `free-form`"):
        find_family("freeform")
    with pytest.raises(UsageError, match="no design family"):
        find_family("fast.models.records:Theta")
    assert issubclass(find_family(NAME), Design)
