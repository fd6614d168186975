"""`fast report` and `fast view`: what a campaign found, as pages and recordings."""

import subprocess
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show


def report(
    campaign: str | None = None, *, lake: LakePath = DEFAULT_LAKE, out: Path | None = None, json: AsJson = False
) -> None:
    """Write a campaign's report as one folder of HTML, figures and data; works on an unfinished campaign too."""
    from flows.cli.campaign import open_lake, resolve_campaign
    from flows.report.build import write_report

    found = open_lake(lake)
    name = resolve_campaign(found, campaign)
    page = write_report(found, name, out or found.root / "outputs" / name / "report")
    show({"campaign": name, "report": str(page)}, str(page), json)


def view(
    what: Annotated[str, Parameter(help="grasp id (K...) or campaign name")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    save: Annotated[Path | None, Parameter(help="write the recording here and open no viewer")] = None,
) -> None:
    """Show force traces with finger and object in the Rerun viewer."""
    from flows.cli.campaign import open_lake, resolve_campaign
    from flows.viewer.rerun import write_grasp_recording, write_recording
    from lake.tables import GraspRow

    found = open_lake(lake)
    path = save or found.root / "outputs" / f"{what.replace('/', '-')}.rrd"
    path.parent.mkdir(parents=True, exist_ok=True)
    if found.has(GraspRow, what):
        write_grasp_recording(found, what, path)
    else:
        write_recording(found, resolve_campaign(found, what), path)
    show({"recording": str(path)}, str(path), False)
    if save is None:
        subprocess.run(["rerun", str(path)], check=False)
