"""`fast report` and `fast view`: what a campaign found, as pages and recordings."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show, tell

if TYPE_CHECKING:
    from lake.store import Lake

LIVE_PORT = 9876  # Rerun's own default
_WEB = ("--web-viewer", "--bind", "127.0.0.1")  # Rerun prints the address, and opens a browser where there is one


def report(
    campaign: Annotated[
        str | None, Parameter(help="Campaign, or calibration (C...); not needed when the lake has one campaign.")
    ] = None,
    *,
    lake: LakePath = DEFAULT_LAKE,
    out: Annotated[Path | None, Parameter(help="Folder to write to; default: beside the lake's other outputs.")] = None,
    against: Annotated[
        list[Path] | None,
        Parameter(negative="", help="Lake with another approach, for Fig. 2a; may be given several times."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Write a report as one folder of HTML, figures and data: of a campaign, finished or not, or of a calibration."""
    from flows.cli.campaign import open_lake, resolve_campaign
    from flows.report.calibration.page import write_calibration_report
    from flows.report.campaign.page import add_features, write_report
    from lake.tables.campaign import CalibrationRow

    found = open_lake(lake)
    if campaign is not None and found.has(CalibrationRow, campaign):
        page = write_calibration_report(found, campaign, out or found.root / "outputs" / campaign / "report")
        show({"calibration": campaign, "report": str(page)}, str(page), json)
        return
    name = resolve_campaign(found, campaign)
    others = [open_lake(path) for path in against or []]
    add_features(found, name)
    page = write_report(found, name, out or found.root / "outputs" / name / "report", others)
    show({"campaign": name, "report": str(page)}, str(page), json)


def view(
    what: Annotated[str, Parameter(help="Grasp id (K...), design id (D...) or campaign.")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    save: Annotated[Path | None, Parameter(help="Write the recording (.rrd) to this file and open no viewer.")] = None,
    live: Annotated[bool, Parameter(negative="", help="Follow a running campaign until it ends.")] = False,
    web: Annotated[
        bool, Parameter(negative="", help="In the browser: serve the viewer to this machine until Ctrl-C.")
    ] = False,
    json: AsJson = False,
) -> None:
    """Show a grasp, the fingers of a design, or a whole campaign in the Rerun viewer."""
    from flows.cli.campaign import open_lake

    found = open_lake(lake)
    folder, write = _choose_recording(found, what)
    path = save or found.root / "outputs" / folder / f"{what.replace('/', '-')}.rrd"
    viewer = None if save else [_find_viewer(), *(_WEB if web else ())]
    if live:
        shown = _follow(found, what, path, viewer)
        show({"shown": what, "recording": str(path), "grasps": shown}, f"{shown} grasps written to {path}", json)
        return
    write(path)
    show({"shown": what, "recording": str(path)}, str(path), json)
    if viewer:
        with suppress(KeyboardInterrupt):
            subprocess.run([*viewer, str(path)], check=False)


def _follow(lake: "Lake", campaign_id: str, path: Path, viewer: list[str] | None) -> int:
    """Send a campaign to a file, and to a viewer, as it grows, until both end; returns the number of grasps.

    Raises:
        UsageError: it is no campaign.
    """
    from flows.cli.campaign import resolve_campaign
    from flows.viewer.campaign import follow
    from tasks.campaign.requests import is_held

    name = resolve_campaign(lake, campaign_id)
    child = subprocess.Popen([*viewer, "--port", str(LIVE_PORT)]) if viewer else None
    address = f"rerun+http://127.0.0.1:{LIVE_PORT}/proxy" if viewer else None
    shown = follow(lake, name, path, lambda: is_held(lake, f"campaign-{name}"), address=address, tell=tell)
    if child is not None:
        tell("all of it is shown; close the viewer, or Ctrl-C, to end")
        with suppress(KeyboardInterrupt):
            child.wait()
    return shown


def _choose_recording(lake: "Lake", what: str) -> tuple[str, Callable[[Path], Path]]:
    """The folder of outputs, and what writes the recording of a grasp, design or campaign.

    Raises:
        UsageError: the lake has nothing of this name.
    """
    from flows.cli.campaign import campaign_ids
    from flows.viewer.campaign import write_recording
    from flows.viewer.design import write_design_recording
    from flows.viewer.grasp import write_grasp_recording
    from lake.tables.campaign import DesignRow, GraspRow
    from models.errors import UsageError

    if lake.has(GraspRow, what):
        campaign_id = lake.records(GraspRow, grasp_id=what)[-1].campaign_id
        return campaign_id or ".", lambda path: write_grasp_recording(lake, what, path)
    if lake.has(DesignRow, what):
        return ".", lambda path: write_design_recording(lake, what, path)
    if what in campaign_ids(lake):
        return what, lambda path: write_recording(lake, what, path)
    raise UsageError(
        f"`{what}` is no grasp, design or campaign of this lake; list them with "
        '`fast sql "SELECT grasp_id, tool_id, object_id FROM grasps"`, `fast sql "FROM designs"` or '
        "`fast campaign list`."
    )


def _find_viewer() -> str:
    """The Rerun viewer beside this Python, or on the path.

    Raises:
        MissingDependencyError: there is none.
    """
    from models.errors import MissingDependencyError

    beside = str(Path(sys.executable).parent)
    viewer = shutil.which("rerun", path=beside) or shutil.which("rerun")
    if viewer is None:
        raise MissingDependencyError(
            "the viewer `rerun` is not installed; run `make setup`, or write the recording to a file with --save."
        )
    return viewer
