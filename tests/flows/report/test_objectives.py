"""The report's section on objectives: the front as a picture and a table, from the lake alone."""

import csv
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.objectives import _name_points, prepare_objectives
from fast.flows.report.folder import Folder
from fast.flows.report.style import figure_style
from fast.lake.tables.campaign import CampaignRow
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.templates import render
from tests.tasks.campaign.small_campaign import begun, small_campaign

TOML = """
name = "small"
seed = 3
[schedule]
initial_tools = 4
tools_per_batch = 4
guided_batches = 1
initial_simulations = 4
simulations_per_batch = 2
[objects]
ids = [4, 7]
repeats = 2
order = "fixed"
[scientist]
{scientist}
[bench]
world = "world.toml"
"""
SCHEDULE = {
    "initial_tools": 4, "tools_per_batch": 4, "guided_batches": 1, "initial_simulations": 4, "simulations_per_batch": 2,
}  # fmt: skip


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return begun(small_campaign(tmp_path, schedule=SCHEDULE))


def section_of(campaign: Campaign, folder: Path, scientist: str) -> str:
    row = CampaignRow(campaign_id="small", name="small", config_toml=TOML.format(scientist=scientist))
    campaign.lake.append([row], campaign.provenance())
    with figure_style():
        content = Content.load(campaign.lake, "small")
        told = prepare_objectives(content, Folder(folder))
        return "" if told is None else render("flows/report/campaign/objectives.html.j2", content=content, told=told)


def test_two_objectives_are_drawn_with_their_front(campaign: Campaign, tmp_path: Path) -> None:
    asked = 'objectives = ["mean_peak_n", "mass_g"]\nat_least = {worst_peak_n = 15}'
    text = section_of(campaign, tmp_path / "r", asked)
    assert "Tools are chosen for high mean peak and low mass." in text
    assert "3 of 4 measured tools keep the limits (worst peak (N) at least 15)." in text  # worst: 14, 15, 16, 17 N
    assert "figures/front.svg" in text
    assert (tmp_path / "r" / "figures" / "front.svg").stat().st_size > 1000
    rows = list(csv.DictReader((tmp_path / "r" / "data" / "objectives.csv").read_text().splitlines()))
    assert len(rows) == 4
    strongest = max(rows, key=lambda row: float(row["mean_peak_n"]))
    assert strongest["on_front"] == "true"
    assert f"<td>{strongest['tool_id'].split('/')[1]}</td>" in text


def test_one_objective_has_a_table_alone(campaign: Campaign, tmp_path: Path) -> None:
    text = section_of(campaign, tmp_path / "r", 'objectives = ["worst_peak_n"]')
    assert "1 lie on the front" in text
    assert "front.svg" not in text


def test_a_campaign_for_the_mean_peak_has_no_such_section(campaign: Campaign, tmp_path: Path) -> None:
    assert section_of(campaign, tmp_path / "r", "best_predicted = 0") == ""


def test_a_limit_that_nothing_keeps_is_said(campaign: Campaign, tmp_path: Path) -> None:
    text = section_of(campaign, tmp_path / "r", "at_least = {worst_peak_n = 99}")
    assert "0 of 4 measured tools keep the limits" in text
    assert "No measured tool keeps all limits yet." in text


def test_a_name_on_another_one_is_left_out() -> None:
    """9 % of the width and 4 % of the height of the axes, wherever these begin."""
    axes = Figure().subplots()
    axes.set_xlim(100.0, 200.0)
    axes.set_ylim(-1.0, 1.0)
    places = {"first": (110.0, 0.0), "on it": (118.0, 0.07), "beside": (119.5, 0.07), "above": (110.0, 0.09)}
    _name_points(axes, [(name, *place) for name, place in places.items()])
    assert [text.get_text() for text in axes.texts] == ["first", "beside", "above"]
    assert axes.texts[1].xy == (119.5, 0.07)
