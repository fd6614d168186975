"""`fast gantry diagnose`: experiments that tell hidden effects apart; `fast gantry tool`: where the tool is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show, table_text, tell
from fast.flows.cli.gantry import VIRTUAL_BENCH, ChosenBench, open_bench
from fast.flows.cli.virtual import Designs, rack

if TYPE_CHECKING:
    from fast.hardware.bench import Bench
    from fast.hardware.cell.cell import Hang, MeasuredGrasp
    from fast.hardware.cell.diagnostics import DiagnosticPlan, DiagnosticRun
    from fast.hardware.tools.mounted import MountedTool
    from fast.lake.store import Lake
    from fast.models.question import Question
    from fast.models.records import GraspSetup
    from fast.tasks.campaign.state import ProposedTool

Kind = Literal["dwell", "lift_speed", "supply_pressure", "closed_empty", "dead_weight", "reference"]
Slot = Annotated[int, Parameter(help="Slot of the tool in the rack, 0 to 9.", validator=Number(gte=0, lte=9))]
HANGING_STILL_S = 2.0


@Parameter(name="*")
@dataclass(frozen=True)
class ChosenTool:
    """Tool of a slot of a rack of design files, or a tool of the lake in the slot where it hangs."""

    slot: Slot = 0
    tool: Annotated[
        str | None, Parameter(help="Tool of the lake (CAMPAIGN/B01T0) that stands in its slot: rows are written.")
    ] = None
    lake: LakePath = DEFAULT_LAKE
    design: Designs = None


PAPER_TOOL = ChosenTool()


def diagnose(
    *,
    only: Annotated[tuple[Kind, ...], Parameter(help="Kinds of experiments to make; default all.", negative="")] = (),
    config: Annotated[Path | None, Parameter(help="Campaign config with [diagnostics] and [grasp].")] = None,
    weight_kg: Annotated[
        tuple[float, ...], Parameter(help="Dead weights to hang on the gripper; repeat for more.", negative="")
    ] = (),
    chosen: ChosenTool = PAPER_TOOL,
    sure: Annotated[bool, Parameter(negative="", help="Strange weights are so; they are marked in the lake.")] = False,
    bench: ChosenBench = VIRTUAL_BENCH,
    json: AsJson = False,
) -> None:
    """Make the diagnostic experiments with one tool: dwell, lift speed, pressure, empty runs, dead weights.

    Nothing is an ordinary grasp: with --tool the runs go to the lake's table `diagnostics`, else nowhere. A weight that
    the load cell does not confirm is a question, and is not written.
    """
    from fast.models.question import settle

    plan, setup, seed = _what(config, weight_kg)
    runs = [run for run in plan.runs(seed) if not only or run.kind in only]
    if "reference" in only:
        runs += _references(plan)
    made: list[MeasuredGrasp] = []
    strange: list[Question] = []
    store, mounted, slot = _find_tool(chosen)
    write = _writer(store, bench.world if bench.real is None else None)

    left = _time_left(mounted[slot], slot, runs, setup)
    with open_bench(bench, tools=mounted) as opened:

        def record(grasp: "MeasuredGrasp") -> None:
            asked = _ask_about_weight(grasp)
            strange.extend(asked)
            if sure and asked:
                grasp.details["sure"] = asked[0].kind
            if sure or not asked:
                write(grasp)
            made.append(grasp)
            what = grasp.diagnostic.text() if grasp.diagnostic else ""
            tell(f"{len(made)} of {len(runs)}: {what}: {_outcome(grasp)}; {left(opened.clock.now_s())} left")

        opened.cell.measure_tool(slot, runs, setup, record, lambda: False, _hang(opened))
    settle(strange, sure, "Weigh again; the other runs are kept")
    rows = [_row(grasp) for grasp in made]
    show(rows, table_text(rows), json)


def _ask_about_weight(grasp: "MeasuredGrasp") -> "list[Question]":
    """What is strange in a dead weight beside what the load cell says of it."""
    from fast.models.gap.ask.person import find_weight_questions

    reading_n, mass_kg = grasp.details.get("dead_weight_n"), grasp.diagnostic and grasp.diagnostic.mass_kg
    if not mass_kg or not isinstance(reading_n, float):
        return []
    return find_weight_questions(mass_kg, reading_n)


def tool_place(
    *,
    on_head: Annotated[
        int | None, Parameter(help="A person looked: the tool of this slot is on the head.", validator=Number(gte=0))
    ] = None,
    head_empty: Annotated[bool, Parameter(negative="", help="A person looked: there is no tool on the head.")] = False,
    person: Annotated[str, Parameter(help="Who looked.")] = "",
    design: Designs = None,
    bench: ChosenBench = VIRTUAL_BENCH,
    json: AsJson = False,
) -> None:
    """Where the tool is, from the journal and the sensors, and the one safe way on. Homes first; moves no tool."""
    from fast.models.errors import UsageError

    says = on_head is not None or head_empty
    if says and (not person or (on_head is not None and head_empty)):
        raise UsageError("say either --on-head SLOT or --head-empty, and who looked with --person NAME.")
    with open_bench(bench, tools=rack(design)) as opened:
        changer = opened.changer
        status = changer.tell(on_head, person) if says else changer.status()
    data = {"slot": status.slot, "sentence": status.sentence, "way_on": status.way.value}
    show(data, f"{status.sentence} Way on: {status.way.value}.", json)


def _what(config: Path | None, weights_kg: tuple[float, ...]) -> "tuple[DiagnosticPlan, GraspSetup, int]":
    from fast.hardware.cell.diagnostics import DiagnosticPlan
    from fast.models.records import GraspSetup
    from fast.models.validation import load_record
    from fast.tasks.campaign.config import load_config

    plan, setup, seed = DiagnosticPlan(), GraspSetup(), 0
    if config is not None:
        loaded = load_config(config)
        plan, setup, seed = loaded.diagnostics, loaded.grasp, loaded.seed
    weighed = {"dead_weights_kg": weights_kg or plan.dead_weights_kg}
    return load_record(DiagnosticPlan, plan.model_dump() | weighed, "fast gantry diagnose"), setup, seed


def _time_left(
    tool: "MountedTool", slot: int, runs: "list[DiagnosticRun]", setup: "GraspSetup"
) -> Callable[[float], str]:
    """Called with the bench's time after each run: how long the rest takes, by the plan and by what was measured."""
    from fast.flows.progress import describe_duration
    from fast.hardware.cell.cycle_time import plan_time, remaining_s

    modelled_s = plan_time(tool, slot, runs, setup).item_s
    ends_s: list[float] = []

    def left(now_s: float) -> str:
        ends_s.append(now_s)
        # The first run ends after a pick, which is no part of it: it counts as the model says.
        measured_s = [*modelled_s[:1], *(b - a for a, b in zip(ends_s, ends_s[1:], strict=False))]
        return describe_duration(remaining_s(modelled_s, measured_s))

    return left


def _references(plan: "DiagnosticPlan") -> "list[DiagnosticRun]":
    return [plan.reference(repeat) for repeat in range(plan.repeats)]


def _find_tool(
    chosen: ChosenTool,
) -> "tuple[tuple[Lake, ProposedTool] | None, dict[int, MountedTool], int]":
    """The tool to use, the rack, and its slot; with the lake and the tool's row if one was named.

    Raises:
        UsageError: no such tool, or an empty slot.
    """
    from fast.hardware.tools.mounted import MountedTool
    from fast.lake.store import Lake
    from fast.lake.tables.campaign import ToolRow
    from fast.models.errors import UsageError
    from fast.tasks.campaign.state import ProposedTool, load_designs

    if chosen.tool is None:
        mounted = rack(chosen.design)
        if chosen.slot not in mounted:
            raise UsageError(f"slot {chosen.slot} has no tool; mounted are slots {min(mounted)} to {max(mounted)}.")
        return None, mounted, chosen.slot
    lake = Lake.open(chosen.lake)
    rows = lake.rows(ToolRow, tool_id=chosen.tool)
    if not rows or rows[-1]["status"] != "printed":
        raise UsageError(
            f'`{chosen.tool}` is no printed tool of {chosen.lake}; list them with `fast sql "FROM tools"`.'
        )
    batch, designs = rows[-1]["batch"], load_designs(lake)
    beside = lake.rows(ToolRow, campaign_id=rows[-1]["campaign_id"], batch=batch, status="printed")
    mounted = {_hanging_in(row): MountedTool(row["tool_id"], designs[row["design_id"]]) for row in beside}
    hangs_in = _hanging_in(rows[-1])
    tool = ProposedTool(chosen.tool, batch, rows[-1]["slot"], mounted[hangs_in].design, hangs_in)
    return (lake, tool), mounted, hangs_in


def _hanging_in(tool_row: "Mapping[str, Any]") -> int:
    """Slot of the rack where a printed tool hangs."""
    return int(tool_row["slot"] if tool_row["rack_slot"] is None else tool_row["rack_slot"])


def _writer(store: "tuple[Lake, ProposedTool] | None", world: Path | None) -> "Callable[[MeasuredGrasp], None]":
    """What writes each run to the lake, or does nothing."""
    if store is None:
        return lambda grasp: None
    from fast.lake.tables.campaign import GraspRow
    from fast.tasks.bench.measure import append_diagnostic
    from fast.tasks.campaign.campaign import stored_provenance
    from fast.tasks.campaign.setup import read_world

    lake, tool = store
    campaign_id = tool.tool_id.partition("/")[0]
    provenance = stored_provenance(lake, campaign_id, [tool.tool_id, tool.design.design_id])
    n_before = len(lake.rows(GraspRow, tool_id=tool.tool_id, status="ok"))
    world_hash = None if world is None else read_world(world).world_hash

    def write(grasp: "MeasuredGrasp") -> None:
        append_diagnostic(
            lake, provenance, tool, grasp, campaign_id=campaign_id, n_grasps_before=n_before, world_hash=world_hash
        )

    return write


def _hang(bench: "Bench") -> "Hang":
    """A person hangs weights on a real gripper; on a virtual one they appear."""

    def by_person(mass_kg: float) -> None:
        what = f"Hang {mass_kg:g} kg on the open gripper" if mass_kg else "Take the weight off"
        tell(f"{what}, keep clear, then press Enter.")
        input()
        bench.clock.sleep(HANGING_STILL_S)

    def by_itself(mass_kg: float) -> None:
        if bench.virtual is not None:
            bench.virtual.state.hung_kg = mass_kg
        bench.clock.sleep(HANGING_STILL_S)

    return by_person if bench.virtual is None else by_itself


def _row(grasp: "MeasuredGrasp") -> dict[str, Any]:
    from fast.models.traces import peak_force_n

    run = grasp.diagnostic
    return {
        "kind": run.kind if run else "",
        "setting": ", ".join(f"{name} {value:g}" for name, value in run.parameters.items()) if run else "",
        "object_id": grasp.object_id,
        "repeat": grasp.repeat,
        "status": grasp.status,
        "peak_force_n": peak_force_n(grasp.trace),
        "separation_mm": grasp.details.get("separation_mm"),
        "dead_weight_n": grasp.details.get("dead_weight_n"),
        "reason": grasp.reason,
    }


def _outcome(grasp: "MeasuredGrasp") -> str:
    row = _row(grasp)
    if row["status"] != "ok":
        return f"failed: {row['reason']}"
    return f"{row['peak_force_n'] if row['dead_weight_n'] is None else row['dead_weight_n']:.2f} N"
