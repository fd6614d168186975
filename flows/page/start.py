"""The tab Start: configs with their faults beside the line, jobs for the worker, and one grasp simulated."""

import base64
import io
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fast.flows.campaign.status import read_campaign
from fast.flows.page.by_hand import find_lent, run_on_lent
from fast.flows.page.configs import find_same, keep_config
from fast.flows.page.jobs import require_worker, start_on_worker
from fast.flows.page.strip import LastStart, read_last_start, read_strip
from fast.lake.leases import holder_of
from fast.lake.store import Lake
from fast.models.errors import ConfigError, FastError, UsageError
from fast.tasks.bench.ways_on import choose_way
from fast.tasks.campaign.config import CampaignConfig, load_config
from fast.tasks.campaign.present_run import StaleRequestError
from fast.tasks.campaign.requests import lease_name
from fast.tasks.campaign.setup import is_known
from fast.tasks.campaign.simulator_versions import at_present

JOBS = {
    "report": ("report/report", "write the report of a campaign"),
    "calibration": ("recalibrate/recalibrate", "calibrate the simulator with the newest measurements"),
    "search": ("close-gap/close_gap", "search for what the simulator misses"),
}
_LONGEST_CONFIG = 100_000


@dataclass(frozen=True)
class Fault:
    """What is wrong with a config; `line`: beside which, None where it is of the whole."""

    line: int | None
    sentence: str


@dataclass(frozen=True)
class Checked:
    """A config that was looked at: its faults, or what it would be."""

    text: str
    faults: tuple[Fault, ...]
    summary: str = ""
    is_real: bool = False
    is_folder: bool = False
    campaign_id: str = ""

    @property
    def lines(self) -> list[tuple[int, str, str]]:
        """Number, text and fault of each line."""
        told: dict[int, str] = {}
        for fault in self.faults:
            if fault.line is not None:
                told[fault.line] = f"{told.get(fault.line, '')} {fault.sentence}".strip()
        return [(number, line, told.get(number, "")) for number, line in enumerate(self.text.splitlines(), start=1)]


def check_config(lake: Lake, text: str, base: str) -> Checked:
    """Check a config: what is wrong with it, by line, or what it would be. `base`: the config that it was made of."""
    if len(text) > _LONGEST_CONFIG:
        return Checked(text[:_LONGEST_CONFIG], (Fault(None, f"more than {_LONGEST_CONFIG} letters are no config."),))
    path = keep_config(lake, text, base, f".check-{os.getpid()}")
    try:
        config = load_config(path)
        is_known(lake, config)
    except FastError as error:
        sentence = str(error).replace(str(path), "the config").replace("campaign config `the config`", "the config")
        for folder in (path.parent, path.parent.resolve()):
            sentence = sentence.replace(f"{folder}{os.sep}", "")  # a file that is not there goes by the person's name
        return Checked(text, (Fault(_find_line(text, sentence), sentence),))
    finally:
        path.unlink(missing_ok=True)
    bench = config.bench
    return Checked(text, (), _summarize(config), bench.real is not None, bench.is_folder, config.campaign_id)


def start_campaign(lake: Lake, form: Mapping[str, str], operator: str) -> str:
    """Keep a config and start its campaign: by the worker on a virtual bench or one's own, or on the real one lent.

    Raises:
        FastError: the config has faults, or no worker stands.
    """
    text, base = form.get("text", "").replace("\r\n", "\n"), form.get("base", "")
    checked = check_config(lake, text, base)
    if checked.faults:
        raise ConfigError(f"{checked.faults[0].sentence} Nothing was started.")
    name, is_real = checked.campaign_id, form.get("on") == "real"
    if (holder := holder_of(lake.storage, lease_name(name))) is not None:
        raise UsageError(f"campaign {name} is being run already ({holder.words}); nothing was started.")
    if not is_real:
        require_worker(lake)
    path = find_same(lake, text) or keep_config(lake, text, base, name)
    if is_real:
        return run_on_lent(lake, path, operator)
    parameters = {"config": str(path.resolve()), "auto_print": form.get("auto_print") == "on"}
    start_on_worker(lake, "run-campaign/campaign", parameters, operator)
    return f"{path.name} is started; it shows on the tab Now within a minute."


def continue_campaign(lake: Lake, campaign_id: str, seen_run: str, operator: str) -> str:
    """Have a campaign that has ended early go on, once for each of its runs: by the worker, or on a lent real bench.

    Raises:
        StaleRequestError: it runs again already, or is complete.
        UsageError: it needs a terminal.
    """
    start = find_start(lake, campaign_id, seen_run)
    if start.is_real:
        return run_on_lent(lake, Path(start.config), operator)
    parameters = {"config": start.config, "auto_print": start.auto_print}
    start_on_worker(lake, "run-campaign/campaign", parameters, operator, key=f"page-continues-{start.run}")
    return f"campaign {campaign_id} goes on within a minute, at the missing grasp."


def find_start(lake: Lake, campaign_id: str, seen_run: str) -> LastStart:
    """Find how a campaign that ended early was started, and can be again; errors as of `continue_campaign`."""
    strip = read_strip(lake, campaign_id, False, False)
    start = read_last_start(lake, campaign_id)
    if not strip.may_continue or start is None:
        raise StaleRequestError(f"campaign {campaign_id} is {strip.word}, so there is nothing to continue.")
    if seen_run != start.run:
        raise StaleRequestError(f"campaign {campaign_id} ran again since this page showed it; look, then decide.")
    if not start.config or not Path(start.config).is_file():
        raise UsageError(
            f"the config of {campaign_id} ({start.config or 'not known'}) is not there any more; continue it with "
            "`fast campaign run CONFIG`."
        )
    if strip.word == "emergency stop, waits for a person":
        raise UsageError(
            f"campaign {campaign_id} was ended by the emergency stop: look at the bench, then "
            f"`fast campaign run {start.config} --acknowledge`."
        )
    return start


def go_on_after_fault(lake: Lake, form: Mapping[str, str], operator: str) -> str:
    """Take a way on after a fault, and have the worker continue; nothing is changed where it cannot.

    Raises:
        UsageError: it needs a terminal, or there is no such way.
    """
    campaign_id, seen_run = form.get("campaign", ""), form.get("run", "")
    start = find_start(lake, campaign_id, seen_run)
    if start.is_real:
        find_lent(lake, Path(start.config))
    else:
        require_worker(lake)
    said = choose_way(
        at_present(read_campaign(lake, campaign_id)), form.get("way", ""), form.get("reason", ""), operator
    )
    return f"{said} {continue_campaign(lake, campaign_id, seen_run, operator)}"


def start_job(lake: Lake, job: str, campaign_id: str, operator: str) -> str:
    """Have the worker write a report, calibrate, or search.

    Raises:
        UsageError: there is no such job, or no worker.
    """
    if job not in JOBS:
        raise UsageError(f"there is no job `{job}`; there are {', '.join(JOBS)}.")
    deployment, words = JOBS[job]
    start_on_worker(lake, deployment, {"campaign": campaign_id} if campaign_id else {}, operator)
    return f"In the queue: {words}{f' ({campaign_id})' if campaign_id else ''}."


def simulate_one(lake_address: str, tool_id: str, object_id: int) -> dict[str, Any]:
    """Simulate one grasp of a tool of the lake, or of the best published finger, with its picture; in a worker process.

    Raises:
        FastError: there is no such tool, or the solver gave up.
    """
    from fast.flows.page.now import thin
    from fast.flows.report.campaign.grasp import draw_instants
    from fast.flows.report.grasp_frames import five_instants
    from fast.flows.report.style import figure_style
    from fast.lake.tables.campaign import CampaignRow, GraspRow
    from fast.models.design.space import BEST_PUBLISHED
    from fast.models.objects.catalogue import get_object
    from fast.models.records import Design, GraspSetup, Placement
    from fast.models.simulation.grasp import simulate_grasp
    from fast.models.simulation.inputs import GraspInputs
    from fast.models.simulation.output.recording import GraspRecording
    from fast.models.simulation.placement import place
    from fast.models.simulation.scatter import find_scatter
    from fast.models.simulation.tolerances import Tolerances
    from fast.models.simulation.version import SimulatorVersion
    from fast.models.traces import peak_force_n

    lake, version = Lake.open(lake_address), SimulatorVersion()
    design: Design = BEST_PUBLISHED
    setup, tolerances = GraspSetup(), Tolerances()
    if tool_id:
        campaign_id = tool_id.rpartition("/")[0]
        if not lake.rows(CampaignRow, campaign_id=campaign_id):
            raise UsageError(f"tool `{tool_id}` is of no campaign that this lake ran; name one like quick/B01T0.")
        campaign = at_present(read_campaign(lake, campaign_id))
        found = next((tool for tool in campaign.state().tools if tool.tool_id == tool_id), None)
        if found is None:
            raise UsageError(f"campaign {campaign.campaign_id} has no tool {tool_id}.")
        design, version = found.design, campaign.version
        setup, tolerances = campaign.config.grasp, campaign.config.tolerances
    obj, recording = get_object(object_id), GraspRecording()
    result = simulate_grasp(design, obj, version, setup, recorder=recording.add, deadline_s=60.0)
    scatter = find_scatter(GraspInputs(design, obj, version, setup), tolerances)
    file, title = io.BytesIO(), f"{tool_id or 'best published finger'} on {obj.name} ({object_id})"
    with figure_style():
        draw_instants(place(obj, Placement()), five_instants(recording, result.trace), title).savefig(file, dpi=110)
    lift, force = thin(result.trace.lift_mm, result.trace.force_n, 300)
    measured = (
        [row for row in lake.records(GraspRow, tool_id=tool_id, object_id=object_id) if row.status == "ok"]
        if tool_id
        else []
    )
    return {
        "title": title,
        "picture": f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}",
        "peak_force_n": peak_force_n(result.trace),
        "peak_sd_n": scatter.sd_n,
        "sd_is_of": tolerances.describe(scatter.missing),
        "measured_n": [row.peak_force_n for row in measured],
        "version_id": version.version_id,
        "traces": [{"label": "simulated", "colour": 2, "simulated": True, "lift": lift, "force": force}],
    }


def _find_line(text: str, sentence: str) -> int | None:
    """Find the line that a fault is about: as TOML says it, or of the key that is named first."""
    if found := re.search(r"at line (\d+)", sentence):
        return int(found[1])
    for key in re.findall(r"`?([a-z_]+(?:\.[a-z_0-9]+)*)`?", sentence):
        section, _, name = key.rpartition(".")
        current = ""
        for number, line in enumerate(text.splitlines(), start=1):
            head = re.match(r"\s*\[+\s*([^\]]+?)\s*\]+", line)
            if head:
                current = head[1]
                if current == key:
                    return number
            elif re.match(rf"\s*{re.escape(name)}\s*=", line) and (current == section or not section == current == ""):
                if current == section:
                    return number
    return None


def _summarize(config: CampaignConfig) -> str:
    schedule, objects = config.schedule, config.objects
    n_tools = schedule.initial_tools + schedule.guided_batches * schedule.tools_per_batch
    n_sims = sum(schedule.simulations_of(stage) for stage in range(schedule.n_stages))
    bench = "a bench of your own" if config.bench.is_folder else "a virtual bench"
    return (
        f"campaign {config.campaign_id} on {bench}: {n_tools} tools in {schedule.guided_batches + 1} stages, "
        f"{n_tools * objects.n_grasps} grasps, {n_sims} simulated designs on {len(objects.object_ids)} objects each"
    )
