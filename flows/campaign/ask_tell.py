"""Ask and tell: a campaign on a bench of one's own without a running flow, from the shell and from Python.

`ask` proposes the next batch as the flow would, from the same rows of the lake; `tell` takes what was measured. A
campaign may change between a flow and asking at any time: all that either knows is in the lake.
"""

import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from queue import Queue
from typing import Any

from fast.flows.campaign.batch_folder import is_told, plan_batch, write_batch
from fast.lake.leases import exclusive, is_held
from fast.lake.store import Lake
from fast.lake.tables.campaign import BatchRow, CampaignRow
from fast.models.errors import ConfigError, UsageError
from fast.models.records import Design, GraspRequest
from fast.models.show import html_table
from fast.models.units import spell_count
from fast.tasks.bench.machine_files.format import MachineFormat, read_format
from fast.tasks.bench.machine_files.guess import guess_format, parse_format
from fast.tasks.bench.machine_files.pulls import read_pulls
from fast.tasks.bench.reference_tools import ask_references
from fast.tasks.bench.told import Taken, Telling, ToldGrasp, find_named_tools, take_back, take_told
from fast.tasks.bench.told_files import read_rows_of, read_told
from fast.tasks.bench.told_questions import ask_about
from fast.tasks.campaign.campaign import Campaign, read_own_designs
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.requests import STARTED, append_event, lease_name
from fast.tasks.campaign.setup import enter
from fast.tasks.campaign.simulator_versions import at_stage
from fast.tasks.scientist.insights.advice import describe_stop, has_stopped, note_advice
from fast.tasks.scientist.propose import propose_stage
from fast.tasks.simulation.attempt import hang_limit_s
from fast.tasks.simulation.engine import Engine, open_engine
from fast.tasks.simulation.simulate import simulate_design


@dataclass(frozen=True)
class AskedBatch:
    """What a campaign wants next: designs by tool id, the grasps in order, and the folder if one was written."""

    batch_id: str
    designs: Mapping[str, Design]
    grasps: tuple[GraspRequest, ...]
    folder: Path | None = None

    def _repr_html_(self) -> str:
        tools = {tool_id: design.model_dump() for tool_id, design in self.designs.items()}
        names = list(next(iter(tools.values()), {}))
        rows = [(tool_id, *(str(values[name]) for name in names)) for tool_id, values in tools.items()]
        return html_table((f"{self.batch_id}, {spell_count(len(self.grasps), 'grasp')}", *names), rows)


def ask(
    config_path: Path | str, lake: Path | str, out: Path | str | None = None, say: Callable[[str], None] = print
) -> AskedBatch | None:
    """Return the batch that is to be measured next: the open one, or a new one; None when there is none to come.

    There is none when the schedule is complete, or the campaign ends by itself. Before a guided batch the simulations
    of the schedule are made, which may take long; `say` hears how far they are. out: a new folder for what printer and
    bench need; None writes none.

    Raises:
        UsageError: the config cannot be used, or the folder is there; nothing was written.
        FastError: another process runs the campaign and has no batch open.
    """
    campaign = _open(Path(config_path), lake, create=True)
    folder = Path(out) if out is not None else None
    if folder is not None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is there already and not empty; nothing was written: give a new folder.")
    batch = _find_open(campaign) if is_held(campaign.lake.storage, lease_name(campaign.campaign_id)) else None
    if batch is None:
        with _held(campaign, Path(config_path)):
            batch = _find_open(campaign)
            batch = _propose_next(campaign, say) if batch is None else batch
    if batch is None:
        return None
    ask_references(campaign, campaign.state(), batch)
    state = campaign.state()
    grasps = plan_batch(campaign, state, batch)
    if folder is not None:
        write_batch(campaign, batch, folder)
    wanted = {grasp.tool_id for grasp in grasps}
    designs = {tool.tool_id: tool.design for tool in state.tools if tool.tool_id in wanted}
    return AskedBatch(BatchRow.make_id(campaign.campaign_id, batch), designs, grasps, folder)


def tell(
    config_path: Path | str,
    lake: Path | str,
    told: Iterable[Path | str] | Iterable[Mapping[str, Any]],
    how: Telling = Telling(),  # noqa: B008 - frozen record
    format_path: Path | str | None = None,
) -> Taken:
    """Take measured grasps: tables of peaks, hand-off folders, files of a testing machine, or rows as mappings.

    A mapping has `tool_id`, `object_id`, `repeat`, and `peak_force_n`, `trace` (a `models.records.Trace`) or `reason`.
    format_path: how a testing machine writes its files.

    Raises:
        UsageError: something cannot be used or is strange; nothing was written.
    """
    campaign = _open(Path(config_path), lake, create=False)
    if not campaign.lake.ids(CampaignRow, campaign_id=campaign.campaign_id):
        raise UsageError(
            f"campaign `{campaign.campaign_id}` is not in {campaign.lake.address}; `fast ask {config_path}` begins it."
        )
    if not how.is_dry:
        enter(campaign, Path(config_path))
    given = _list_told(told)
    machine = read_format(Path(format_path)) if format_path is not None else None
    return tell_campaign(campaign, given, how, machine)


def _list_told(told: Any) -> list[Any]:
    """List what was told, one by one: also the rows of a data frame or Arrow table, and what came without a list.

    Raises:
        UsageError: something is neither a mapping nor a path.
    """
    if isinstance(told, Path | str | Mapping):
        return [told]
    ways = (("to_pylist", ()), ("to_dicts", ()), ("to_dict", ("records",)))  # of Arrow, polars and pandas
    rows = next((getattr(told, way)(*options) for way, options in ways if hasattr(told, way)), told)
    given = [dict(row) if hasattr(row, "keys") else row for row in rows]
    for number, one in enumerate(given, start=1):
        if not isinstance(one, Path | str | dict):
            raise UsageError(
                f"grasp {number} is of type {type(one).__name__}; tell mappings, a data frame or paths of files."
            )
    return given


def tell_campaign(
    campaign: Campaign,
    given: Sequence[Any],
    how: Telling,
    machine: MachineFormat | None = None,
    way: str = "--sure",
) -> Taken:
    """Take measured grasps of a campaign that is in the lake; see `tell`. `way`: how a person says that they are sure.

    Raises:
        UsageError: something cannot be used or is strange; nothing was written.
    """
    notes: list[str] = []
    if given and all(isinstance(one, Mapping) for one in given):
        grasps = read_rows_of(given)
    elif machine is not None:
        grasps, notes = read_pulls([Path(path) for path in given], machine, find_named_tools(campaign))
    else:
        grasps = read_told(campaign, [Path(path) for path in given], notes)
    taken = take_told(campaign, grasps, how, ask_about, way)
    return replace(taken, notes=tuple(notes))


def guess(
    config_path: Path | str, lake: Path | str, files: Sequence[Path], format_path: Path
) -> tuple[str, list[ToldGrasp]]:
    """Guess how a testing machine writes, and write it as a format file if all files can be read so.

    Returns the text of the file, and the grasps that are read with it.

    Raises:
        UsageError: it cannot be told, or a file cannot be read so; nothing was written.
    """
    text, grasps = guess_for(_open(Path(config_path), lake, create=False), files, str(format_path))
    try:
        format_path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{format_path} cannot be written ({error.strerror}); give another path.") from error
    return text, grasps


def guess_for(campaign: Campaign, files: Sequence[Path], place: str) -> tuple[str, list[ToldGrasp]]:
    """Guess how a testing machine writes: the text of a format file called `place`, and the grasps read with it.

    Raises:
        UsageError: it cannot be told, or a file cannot be read so.
    """
    names = find_named_tools(campaign)
    text = guess_format(files, names)
    return text, read_pulls(files, parse_format(text, place), names).grasps


def describe_pull(one: ToldGrasp) -> dict[str, Any]:
    """Describe a pull of a testing machine as it was read, for a table."""
    row: dict[str, Any] = {"tool": one.tool_id, "object": one.object_id, "repeat": one.repeat}
    trace = one.trace
    if trace is not None:
        row |= {
            "samples": len(trace.time_s),
            "time, s": f"{trace.time_s[0]:.4g} to {trace.time_s[-1]:.4g}",
            "lift, mm": f"{trace.lift_mm.min():.4g} to {trace.lift_mm.max():.4g}",
            "peak, N": f"{trace.force_n.max():.4g}",
        }
    return row


def untell(config_path: Path | str, lake: Path | str, operator: str) -> int:
    """Take back the last telling of a campaign; returns how many grasps are to be told again.

    Raises:
        UsageError: there is none.
    """
    return take_back(_open(Path(config_path), lake, create=False), operator)


def find_told_campaign(lake: Lake, tool_ids: Sequence[str]) -> Campaign | None:
    """Find the campaign on a bench of its own that these tools are of, if they are of one."""
    from fast.flows.campaign.status import read_campaign
    from fast.lake.tables.imported import is_imported

    names = {tool_id.rpartition("/")[0] for tool_id in tool_ids}
    if len(names) != 1 or "" in names:
        return None
    rows = lake.rows(CampaignRow, campaign_id=names.pop())
    if not rows or is_imported(rows[-1]["config_toml"]):
        return None
    if tomllib.loads(rows[-1]["config_toml"]).get("bench", {}).get("kind") != "folder":
        return None
    return read_campaign(lake, rows[-1]["campaign_id"])


def _open(config_path: Path, lake: Path | str, *, create: bool) -> Campaign:
    config = load_config(config_path)
    if not config.bench.is_folder:
        raise ConfigError(
            f'{config_path}: bench.kind is "gantry", which `fast campaign run` measures on; set bench.kind = "folder" '
            "for a bench of your own."
        )
    own_designs = read_own_designs(config_path, config)
    return Campaign(Lake.open(lake, create=create), config, config_path=config_path, own_designs=own_designs)


@contextmanager
def _held(campaign: Campaign, config_path: Path) -> Iterator[None]:
    """Hold the campaign in the lake, so that nobody else has it meanwhile."""
    name = campaign.campaign_id
    busy = f"campaign {name} is being run, and asks for nothing now"
    with exclusive(campaign.lake.storage, lease_name(name), busy) as lease:
        enter(campaign, config_path)
        append_event(campaign.lake, name, STARTED, "asked for the next batch", run=lease.token)
        yield


def _find_open(campaign: Campaign) -> int | None:
    """Find the first batch that is proposed and not told."""
    state = campaign.state()
    batches = sorted({tool.batch for tool in state.tools})
    return next((batch for batch in batches if not is_told(campaign, state, batch)), None)


def _propose_next(campaign: Campaign, say: Callable[[str], None]) -> int | None:
    """Propose the first stage that has batches without tools; the number of its first new batch."""
    schedule, state = campaign.config.schedule, campaign.state()
    for stage in range(schedule.n_stages):
        if all(state.tools_of(batch) for batch in schedule.batches_of(stage)):
            continue
        if stage > 0:
            _simulate(at_stage(campaign, stage - 1), stage - 1, say)
            advice = note_advice(at_stage(campaign, stage - 1))
            if has_stopped(campaign, stage):
                say(describe_stop(campaign))
                return None
            if advice is not None:
                say(advice.sentence)
        return propose_stage(at_stage(campaign, stage), stage)[0]
    advice = note_advice(at_stage(campaign, schedule.n_stages - 1))
    if advice is not None:
        say(advice.sentence)
    return None


def _simulate(campaign: Campaign, stage: int, say: Callable[[str], None]) -> None:
    """Make the simulations that the schedule has for a stage, as the flow does while tools are measured."""
    # Seconds of imports, of Prefect, which a schedule without simulations does without.
    from fast.flows.campaign.loops import SimulationLoop

    execution = campaign.config.execution
    limit_s = hang_limit_s(campaign.config.simulator.grasp_deadline_s)
    engine = open_engine(execution.engine, execution.simulation_workers, limit_s)
    try:
        with ThreadPoolExecutor(execution.simulation_workers) as threads:
            run = _Simulating(campaign, engine, threads, say)
            loop = SimulationLoop(run, stage)
            while loop.advance(campaign.state()):
                loop.finish(run.ended.get())
    finally:
        engine.close()


@dataclass
class _Simulating:
    """What `SimulationLoop` needs of a process that has no flow."""

    campaign: Campaign
    engine: Engine
    threads: ThreadPoolExecutor
    say: Callable[[str], None]
    ended: "Queue[Future[int]]" = field(default_factory=Queue)

    def on_simulated(self, label: str, n_failed: int) -> None:
        """Tell how far it is."""
        self.say(f"{label}{f', {n_failed} failed' if n_failed else ''}")

    def submit_simulation(self, label: str, design: Design) -> "Future[int]":
        """Have a design simulated on the objects that it misses."""
        future = self.threads.submit(partial(simulate_design, self.campaign, design, pool=self.engine))
        future.add_done_callback(self.ended.put)
        return future

    def should_stop(self) -> bool:
        """Return False, since nobody asks."""
        return False
