"""Data of another lab, from the import to the report, without a campaign of ours."""

import re
from html import unescape
from pathlib import Path

import pytest

from fast.flows.campaign.status import format_status, read_status
from fast.flows.report.campaign.page import write_report
from fast.flows.viewer.campaign import write_recording
from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import import_handoff
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import ConfigError
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.setup import register
from tests.flows.synthetic_lake import Campaign as Synthetic
from tests.flows.synthetic_lake import build
from tests.lake.handoff.handoff_folder import PROVENANCE, good_folder, grasp, read_csv, samples, write_csv

QUICK = Path(__file__).parents[3] / "campaigns" / "quick.toml"
IMPORTED = "import-their-lab"


@pytest.fixture
def lake(tmp_path):
    folder = good_folder(tmp_path / "their-lab")
    rows = read_csv(folder / "grasps.csv")
    places = zip(rows, (0, 1, 0, 1), strict=True)  # spheres, which are drawn fast
    write_csv(folder / "grasps.csv", [row | {"object_id": object_id} for row, object_id in places])
    lake = Lake.open(tmp_path / "lake", create=True)
    import_handoff(lake, folder, PROVENANCE)
    return lake


def text_of(html: str) -> str:
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", html)))


def test_status_counts_what_was_imported(lake):
    status = read_status(lake, IMPORTED)
    assert (status["state"], status["grasps"], status["simulated"]) == ("imported", "2/2", "2/2")
    assert (status["best_tool"], status["best_n"]) == ("lab/B02T4", pytest.approx(8))
    assert "imported" in format_status(status)


def test_the_report_of_a_tiny_import_has_every_section(lake, tmp_path):
    page = write_report(lake, IMPORTED, tmp_path / "report")
    text = text_of(page.read_text(encoding="utf-8"))
    assert "B02T4 holds best: it takes 8.00 N" in text
    assert "operator import of their-lab" in text
    assert 'kind = "imported"' in text
    assert "E 9.5 MPa, friction 0.6" in text


def test_a_report_says_the_same_of_a_campaign_in_another_lake(tmp_path, no_figures):
    ours = build(Lake.open(tmp_path / "ours", create=True), Synthetic())
    export_handoff(ours, tmp_path / "their-lab", campaign_id="demo")
    theirs = Lake.open(tmp_path / "theirs", create=True)
    import_handoff(theirs, tmp_path / "their-lab", PROVENANCE)
    reports = {
        name: write_report(lake, name, tmp_path / name).parent for lake, name in ((ours, "demo"), (theirs, IMPORTED))
    }
    for name in ("object_work", "traces", "simulated_traces"):
        numbers = [read_csv(folder / "data" / f"{name}.csv") for folder in reports.values()]
        for row in [*numbers[0], *numbers[1]]:
            row.pop("object_name", None)  # the made-up campaign names its objects otherwise
        assert numbers[0] == numbers[1], name
    quality = [
        [(row["tool_id"], row["quality_n"]) for row in read_csv(folder / "data" / "tool_quality.csv")]
        for folder in reports.values()
    ]
    assert quality[0] == quality[1]


def test_simulations_alone_make_a_report(tmp_path, no_figures):
    folder = good_folder(tmp_path / "their-lab")
    sim = grasp("s", fidelity="sim", tool_id="")
    write_csv(folder / "grasps.csv", [sim])
    write_csv(folder / "traces.csv", samples("s"))
    write_csv(folder / "simulations.csv", read_csv(folder / "simulations.csv")[:1])
    lake = Lake.open(tmp_path / "lake", create=True)
    import_handoff(lake, folder, PROVENANCE)
    assert read_status(lake, IMPORTED)["simulated"] == "1/1"
    assert write_report(lake, IMPORTED, tmp_path / "report").is_file()
    assert export_handoff(lake, tmp_path / "out", campaign_id=IMPORTED).n_sim == 1


def test_an_imported_campaign_can_be_looked_at(lake, tmp_path):
    assert write_recording(lake, IMPORTED, tmp_path / "all.rrd").stat().st_size > 1000


def test_an_imported_campaign_cannot_be_run(lake):
    config = load_config(QUICK).model_copy(update={"name": IMPORTED})
    with pytest.raises(ConfigError, match=f"campaign `{IMPORTED}` of this lake was imported"):
        register(Campaign(lake, config), "")
    assert len(lake.rows(GraspRow)) == 2
