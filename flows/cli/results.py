"""`fast report` and `fast view`: what a campaign found, as pages and recordings."""

import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fast.flows.cli.campaign import campaign_ids, open_lake, resolve_campaign
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say_progress, show
from fast.flows.cli.virtual import wait_for
from fast.flows.dependencies import require
from fast.models.errors import UsageError
from fast.models.units import spell_count

if TYPE_CHECKING:
    from fast.lake.store import Lake


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
    from fast.flows.report.campaign.insights import read_written
    from fast.flows.report.campaign.page import add_features, write_report
    from fast.lake.tables.campaign import CalibrationRow

    found = open_lake(lake)
    if campaign is not None and found.has(CalibrationRow, campaign):
        from fast.flows.report.calibration.page import write_calibration_report

        page = write_calibration_report(found, campaign, out or found.root / "outputs" / campaign / "report")
        show({"calibration": campaign, "report": str(page)}, str(page), json)
        return
    name = resolve_campaign(found, campaign)
    others = [open_lake(path) for path in against or []]
    add_features(found, name)
    page = write_report(found, name, out or found.root / "outputs" / name / "report", others)
    show({"campaign": name, "report": str(page), "insights": read_written(page.parent)}, str(page), json)


def view(
    what: Annotated[str, Parameter(help="Grasp id (K...), design id (D...), tool (quick/B03T2) or campaign.")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    save: Annotated[Path | None, Parameter(help="Write the recording (.rrd) to this file and show nothing.")] = None,
    live: Annotated[bool, Parameter(negative="", help="Follow a running campaign until it ends.")] = False,
    json: AsJson = False,
) -> None:
    """Show a grasp, the fingers of a design or a tool, or a whole campaign in Rerun's viewer, in the browser.

    It is served to this machine until Ctrl-C. The printed address lets a browser in; nobody else gets in, neither pages
    of other sites nor other users of the computer.
    """
    found = open_lake(lake)
    folder, write = _choose_recording(found, what)
    path = save or found.root / "outputs" / folder / f"{what.replace('/', '-')}.rrd"
    if save is None:
        require(["prefect", "rerun"])  # Prefect brings the web server
    is_whole = threading.Event()
    data: dict[str, Any] = {"shown": what, "recording": str(path)}
    text = str(path)
    with ExitStack() as stack:
        show_page = None if save else _prepare_page(stack, found, path, is_whole)
        if live:
            n_grasps = _follow(found, what, path, show_page)
            data["grasps"], text = n_grasps, f"{spell_count(n_grasps, 'grasp')} written to {path}"
        else:
            write(path)
        is_whole.set()
        show(data, text, json)
        if show_page is None:
            return
        if live:
            say_progress("all of it is shown; Ctrl-C ends the page")
        else:
            show_page()
        with suppress(KeyboardInterrupt):
            wait_for(threading.Event())


def _prepare_page(stack: ExitStack, lake: "Lake", path: Path, is_whole: threading.Event) -> Callable[[], None]:
    """Prepare what opens the page of a recording until the stack ends, and tells its address on a line of its own.

    Raises:
        FastError: the key of the lake is another user's.
    """
    from fast.flows.server.access import own_login
    from fast.flows.viewer.page import open_page

    login = own_login(lake.root)

    def show_page() -> None:
        address = stack.enter_context(open_page(path, login, is_whole))
        say_progress("Open this address in a browser on this machine; Ctrl-C ends it:")
        say_progress(address)  # no browser is started with it: other users see what programs are started with

    return show_page


def _follow(lake: "Lake", campaign_id: str, path: Path, began: Callable[[], None] | None) -> int:
    """Write a campaign to a file, as it grows, until it ends; returns the number of grasps.

    Raises:
        UsageError: it is no campaign.
    """
    from fast.flows.viewer.campaign import follow
    from fast.lake.leases import is_held
    from fast.tasks.campaign.requests import lease_name

    name = resolve_campaign(lake, campaign_id)
    return follow(lake, name, path, lambda: is_held(lake.storage, lease_name(name)), began=began, progress=say_progress)


def _choose_recording(lake: "Lake", what: str) -> tuple[str, Callable[[Path], Path]]:
    """Choose the folder of outputs, and what writes the recording of a grasp, design, tool or campaign.

    Raises:
        UsageError: the lake has nothing of this name.
    """
    from fast.flows.viewer.campaign import write_recording
    from fast.flows.viewer.design import write_design_recording
    from fast.flows.viewer.grasp import write_grasp_recording
    from fast.lake.tables.campaign import DesignRow, GraspRow, ToolRow

    if lake.has(GraspRow, what):
        campaign_id = lake.records(GraspRow, grasp_id=what)[-1].campaign_id
        return campaign_id or ".", lambda path: write_grasp_recording(lake, what, path)
    if lake.has(DesignRow, what):
        return ".", lambda path: write_design_recording(lake, what, path)
    if tools := lake.records(ToolRow, tool_id=what):
        return tools[-1].campaign_id, lambda path: write_design_recording(lake, tools[-1].design_id, path)
    if what in campaign_ids(lake):
        return what, lambda path: write_recording(lake, what, path)
    raise UsageError(
        f"`{what}` is no grasp, design, tool or campaign of this lake; list them with "
        '`fast sql "SELECT grasp_id, tool_id, object_id FROM grasps"`, `fast sql "FROM designs"`, '
        '`fast sql "FROM tools"` or `fast campaign list`.'
    )
