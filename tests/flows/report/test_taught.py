"""The section of the report on what a campaign has taught."""

from pathlib import Path

from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.insights import FILE, prepare_insights
from fast.flows.report.folder import Folder
from fast.flows.report.style import figure_style
from fast.tasks.templates import render
from tests.tasks.scientist.test_insights import measured, store_config


def test_effects_are_drawn_and_told(tmp_path: Path) -> None:
    lake = store_config(measured(tmp_path)).lake
    content, folder = Content.load(lake, "small"), Folder(tmp_path / "report")
    with figure_style():
        told = prepare_insights(content, folder)
    html = render("flows/report/campaign/taught.html.j2", content=content, told=told)
    assert "What each parameter does" in html
    assert "figures/effect_height_mm.svg" in html
    assert (folder.root / "figures" / "effect_height_mm.svg").exists()
    assert (folder.root / "figures" / "shares.svg").exists()
    assert 'class="tone red"' in html  # object 4 decides everything
    assert "By class of object" in html
    assert told is not None
    assert told["next_batch"].next_step in html
    assert (folder.root / "data" / FILE).exists()
