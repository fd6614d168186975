import re
from contextlib import nullcontext
from pathlib import Path

import pytest

from fast.flows.report.campaign.content import Content
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow
from fast.models.errors import ConfigError
from fast.models.simulation.tolerances import Tolerances
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig, differences, load_config, read_stored_config
from fast.tasks.campaign.retired import RETIRED
from fast.tasks.campaign.settings import NightSettings, ObjectPlan, Schedule
from fast.tasks.campaign.setup import register

ROOT = Path(__file__).parents[3]
QUICK = ROOT / "campaigns" / "quick.toml"


def edited(tmp_path: Path, old: str, new: str) -> Path:
    """The quick campaign with one edit, its world beside it."""
    text = QUICK.read_text().replace(old, new).replace("../worlds/quick.toml", str(ROOT / "worlds" / "quick.toml"))
    assert new in text
    path = tmp_path / "edited.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["quick", "paper"])
def test_shipped_campaigns_are_valid(name):
    assert load_config(ROOT / "campaigns" / f"{name}.toml").name == name


def test_paper_schedule_is_the_papers():
    schedule = load_config(ROOT / "campaigns" / "paper.toml").schedule
    assert schedule.batches_of(0) == [1, 2, 3]
    assert [schedule.tools_of(batch) for batch in (1, 2, 3, 4)] == [10, 10, 10, 10]
    assert schedule.n_stages == 9
    assert schedule.batches_of(8) == [11]
    assert schedule.simulations_of(0) == 50
    assert schedule.simulations_of(1) == 100


def test_last_initial_tray_may_be_partly_filled():
    schedule = Schedule(initial_tools=13, tools_per_batch=5)
    assert [schedule.tools_of(batch) for batch in schedule.batches_of(0)] == [5, 5, 3]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("repeats = 2", "repeat = 2", r"unknown key `objects\.repeat`; did you mean `repeats`\?"),
        ("ids = [2,", "ids = [36,", "object 36 does not exist, ids are 0 to 35"),
        (
            "ids = [2,",
            'ids = ["cube", 2,',
            r"toml: `objects\.ids\.0` is 'cube', it must be a whole number; change it\.$",
        ),
        (
            "seed = 1",
            f'seed = "{200 * "1,"}"',
            r"`seed` is '(1,){39}1\.\.\., it must be a whole number; change it\.$",
        ),
        ("tools_per_batch = 4", "tools_per_batch = 11", r"`schedule\.tools_per_batch` is 11, it must be at most 10"),
        ("friction = 0.56", "friction = 2.5", r"`simulator\.theta\.friction` is 2\.5, it must be at most 2"),
        (
            "[bench]",
            "[grasp]\nclosed_gap_mm = 100\n[bench]",
            r"edited\.toml: closed_gap_mm 100 is not below open_gap_mm 70 mm, so the jaws would not close",
        ),
        ('name = "quick"', 'name = "Quick!"', "`name` is 'Quick!'"),
        ("seed = 1", "seed = one", "is not TOML"),
        ('world = "', 'world = "missing/', "does not exist"),
        (
            "[bench]",
            '[simulator]\ntier = "fine"\n[bench]',
            r"`simulator\.tier` is 'fine', it must be 'production' or 'reference'; change it",
        ),
        (
            "[bench]",
            '[scientist]\nacquisition = "ucb"\n[bench]',
            r"is 'ucb': it must be \"mes\" or \"random\" or \"module:function\"; change it",
        ),
        (
            "[bench]",
            "[diagnostics]\nprotocol_slot = 0\n[bench]",
            r"edited\.toml: `diagnostics` is gone: a gap search asks the bench for grasps .*Remove it\.",
        ),
    ],
)
def test_bad_values_get_one_sentence(tmp_path, old, new, message):
    with pytest.raises(ConfigError, match=message):
        load_config(edited(tmp_path, old, new))


@pytest.mark.parametrize(("path", "instead"), RETIRED.items())
def test_a_key_that_is_gone_is_refused_in_a_file_and_dropped_from_a_lake(tmp_path, path, instead):
    section, _, key = path.partition(".")
    text = f"[{section}]\n{key or 'protocol_slot'} = 0\n[bench]"
    file = edited(tmp_path, "[bench]", text)
    with pytest.raises(ConfigError, match=re.escape(f"`{path}` is gone: {instead}. Remove it.")):
        load_config(file)
    stored = QUICK.read_text()
    assert read_stored_config(stored.replace("[bench]", text), "quick") == read_stored_config(stored, "quick")


def test_a_campaign_that_followed_calibrations_has_nights():
    text = QUICK.read_text().replace("[bench]", '[simulator]\nfollow = "latest"\nreruns = 5\n[bench]')
    assert read_stored_config(text, "quick").night == NightSettings(active=True, max_designs=5)


def test_a_config_from_an_editor_of_windows_is_read(tmp_path: Path) -> None:
    path = tmp_path / "windows.toml"
    path.write_text('\ufeffname = "windows"\r\nseed = 1\r\n[bench]\r\nkind = "folder"\r\n', "utf-8", newline="")
    assert load_config(path).name == "windows"


def test_missing_file_says_so(tmp_path):
    with pytest.raises(ConfigError, match="does not exist; give the path of a TOML file"):
        load_config(tmp_path / "none.toml")


def test_execution_is_no_part_of_the_science(tmp_path):
    original, faster = (
        load_config(QUICK),
        load_config(edited(tmp_path, "simulation_workers = 1", "simulation_workers = 2")),
    )
    faster = CampaignConfig.model_validate(faster.model_dump() | {"bench": original.bench.model_dump()})
    assert faster.config_hash == original.config_hash


def test_differences_name_what_changed():
    assert differences({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3}}) == ["a.c 2 -> 3"]


@pytest.mark.parametrize(
    ("before", "after", "n_changes"),
    [
        ("../worlds/quick.toml", "/lab/worlds/quick.toml", 0),
        ("/lab/worlds/quick.toml", "./worlds/quick.toml", 0),
        ("../worlds/quick.toml", "/lab/worlds/paper.toml", 1),
        ("../worlds/quick.toml", "/lab/others/quick.toml", 1),
        ("/lab/worlds/quick.toml", None, 1),
    ],
)
def test_a_file_of_a_config_is_the_same_where_its_paths_end_alike(before, after, n_changes):
    old, new = {"bench": {"world": before}}, {"bench": {"world": after}}
    assert len(differences(old, new)) == len(differences(new, old)) == n_changes
    if n_changes == 0:
        assert differences({"name": before}, {"name": after})  # what is no file is compared by its letters


def test_cells_are_the_same_for_a_seed_and_cover_everything():
    plan = ObjectPlan(ids=(3, 1, 2), repeats=2, order="random")
    assert plan.list_grasps(5) == plan.list_grasps(5)
    assert sorted(plan.list_grasps(5)) == [(o, r) for o in (1, 2, 3) for r in (0, 1)]
    assert plan.list_grasps(5) != plan.list_grasps(7), "each tool has its own order"
    assert ObjectPlan(ids=(3, 1), repeats=2, order="fixed").list_grasps(5) == [(1, 0), (1, 1), (3, 0), (3, 1)]
    assert ObjectPlan(repeats=1, order="fixed").list_grasps(1) == ObjectPlan(repeats=1, order="fixed").list_grasps(2)
    passes = ObjectPlan(ids=(3, 1, 2), repeats=2, repeats_order="interleaved").list_grasps(5)
    assert [repeat for _, repeat in passes] == [0, 0, 0, 1, 1, 1]
    assert sorted(passes) == sorted(plan.list_grasps(5))


@pytest.mark.parametrize(
    ("first", "wanted", "message"),
    [
        (
            "initial_tools = 2\ninitial_simulations = 2",
            'objectives = ["mean_peak_n", "mean_work_j"]',
            "limit `mean_work_j` is learned from 3 tools at least, there are 2 before .*raise schedule.initial_tools",
        ),
        (
            "initial_tools = 3\ninitial_simulations = 2",
            "at_most = {pressure_kpa = 100}",
            "`pressure_kpa` is learned from 3 simulated designs at least, there are 2 .*schedule.initial_simulations",
        ),
        ("initial_tools = 3\ninitial_simulations = 0", "at_least = {worst_peak_n = 1}", None),
        ("initial_tools = 2\ninitial_simulations = 1", 'objectives = ["mean_peak_n", "mass_g"]', None),
    ],
)
def test_objectives_need_enough_first_tools(tmp_path: Path, first: str, wanted: str, message: str | None) -> None:
    path = tmp_path / "few.toml"
    path.write_text(
        f'name = "few"\n[schedule]\n{first}\n[scientist]\n{wanted}\n[simulator]\nsimulate_tools = false\n'
        '[bench]\nkind = "folder"\n'
    )
    with pytest.raises(ConfigError, match=message) if message else nullcontext():
        load_config(path)


def test_tolerances_may_change_and_a_report_reads_the_new_ones(tmp_path: Path) -> None:
    lake, path = Lake.open(tmp_path / "lake", create=True), edited(tmp_path, "seed = 1", "seed = 1")
    text = path.read_text()
    for size_mm, n_written in ((0.1, 1), (0.3, 2), (0.3, 2)):
        path.write_text(f"{text}\n[tolerances]\nwall_offset_mm = {size_mm}\n")
        register(Campaign(lake, load_config(path)), path.read_text())
        assert Content.load(lake, "quick").tolerances == Tolerances(wall_offset_mm=size_mm)
        assert len(list((tmp_path / "lake" / CampaignRow.table).rglob("*.parquet"))) == n_written


ROBUST = '[scientist]\nobjectives = ["robust_peak_n"]'


def test_tolerances_of_walls_decide_a_campaign_that_wants_what_prints_hold(tmp_path: Path) -> None:
    path = tmp_path / "robust.toml"

    def hash_of(scientist: str, tolerances: str) -> str:
        first = 'name = "robust"\n[schedule]\ninitial_tools = 3\n[bench]\nkind = "folder"'
        path.write_text(f"{first}\n{scientist}\n[tolerances]\n{tolerances}\n")
        return load_config(path).config_hash

    usual = hash_of(ROBUST, "wall_offset_mm = 0.1")
    assert hash_of(ROBUST, "wall_offset_mm = 0.2") != usual
    assert hash_of(ROBUST, "offset_z_mm = 1.0") == usual
    assert hash_of("", "wall_offset_mm = 0.2") == hash_of("", "wall_offset_mm = 0.1")
    with pytest.raises(ConfigError, match=r"tolerances.wall_offset_mm is 0; set it to the standard deviation"):
        hash_of(ROBUST, "wall_offset_mm = 0")
