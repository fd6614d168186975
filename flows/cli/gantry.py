"""`fast gantry`: move the bench by hand. A virtual bench unless a real one is asked for and confirmed."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, OBJECT_HELP, AsJson, LakePath, make_app, say_progress, show
from fast.flows.cli.real import YesMove, ask_leave
from fast.flows.cli.virtual import Designs, rack, watch_signals
from fast.flows.cli.wire import log_folder
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.hardware.bench import Bench
    from fast.hardware.station.station import MeasuredGrasp
    from fast.hardware.tools.mounted import MountedTool
    from fast.models.objects.rigid import RigidObject

app = make_app(name="gantry", help="Move the bench by hand: home, park, tare, grasp, faults. All of these home first.")
app.command("fast.flows.cli.wire:log", name="log", help="List the wire logs of benches, or print one.")
app.command("fast.flows.cli.wire:replay", name="replay", help="Play a wire log back to the driver of its device.")
app.command("fast.flows.cli.plan:plan", name="plan", help="How long a batch takes, and what the time goes into.")


@Parameter(name="*")
@dataclass(frozen=True)
class ChosenBench:
    """The virtual bench of a world, or the real one of a bench file."""

    world: Annotated[Path, Parameter(help="World of the virtual bench.")] = Path("worlds/quick.toml")
    real: Annotated[Path | None, Parameter(help="Bench file: drive real hardware, after a typed confirmation.")] = None
    yes_move: YesMove = None


Vent = Annotated[
    bool, Parameter(negative="", help="A closed gripper may open before homing: a person looked, nothing hangs in it.")
]
VIRTUAL_BENCH = ChosenBench()


@app.command
def home(*, bench: ChosenBench = VIRTUAL_BENCH, vent: Vent = False, json: AsJson = False) -> None:
    """Connect to all devices and home the gantry."""
    with open_bench(bench, vent) as opened:
        x, y, z = opened.gantry.position_mm()
    text = f"homed; head at x {x:.1f}, y {y:.1f}, z {z:.1f} mm"
    show({"x_mm": x, "y_mm": y, "z_mm": z}, text, json)


@app.command
def park(*, bench: ChosenBench = VIRTUAL_BENCH, vent: Vent = False, json: AsJson = False) -> None:
    """End the safe state after a person looked: open the gripper, dock the tool on the head, close the air supply."""
    with open_bench(bench, vent) as opened:
        opened.station.recover()
        opened.station.park()
    show({"parked": True}, "parked; the head carries no tool and the air supply is closed", json)


@app.command
def tare(*, bench: ChosenBench = VIRTUAL_BENCH, json: AsJson = False) -> None:
    """Zero the load cell with the head hanging free, and say what was taken as zero."""
    with open_bench(bench) as opened:
        opened.force.zero(1.0)
        base = opened.force.baseline(1.0)
    text = f"tared: {base.gross_n:.3f} N gross hang free; net {base.net_n:.3f} N, noise {base.sd_n:.3f} N"
    show({"gross_n": base.gross_n, "net_n": base.net_n, "noise_sd_n": base.sd_n}, text, json)


@app.command
def grasp(
    *,
    object: Annotated[str, Parameter(help=OBJECT_HELP)],
    place: Annotated[int | None, Parameter(help="Place where an own object stands, 0 to 35.")] = None,
    slot: Annotated[int, Parameter(help="Slot of the tool in the rack, 0 to 9.")] = 0,
    repeats: Annotated[int, Parameter(help="How many grasps.", validator=Number(gte=1))] = 1,
    design: Designs = None,
    bench: ChosenBench = VIRTUAL_BENCH,
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Pick a tool, grasp one object, lift to separation, park the tool; exit status 1 when a grasp failed.

    Nothing is written to a lake.
    """
    from fast.models.records import GraspSetup
    from fast.tasks.objects import find_object

    tools, met = rack(design), find_object(object, lake)
    own_objects = () if place is None else ((met.object_id, place),)
    _check_target(met, own_objects, slot, tools)
    made: list[MeasuredGrasp] = []
    plan = [(met.object_id, repeat) for repeat in range(repeats)]
    with open_bench(bench, tools=tools, own_objects=own_objects) as opened:
        opened.station.measure_tool(slot, plan, GraspSetup(), made.append, lambda: False)
    rows = [_grasp_row(g) for g in made]
    show(rows, "\n".join(_grasp_line(row) for row in rows), json)
    if any(row["status"] != "ok" for row in rows):
        sys.exit(1)


@app.command
def faults(*, bench: ChosenBench = VIRTUAL_BENCH, json: AsJson = False) -> None:
    """Connect to every device, home, and say what is wrong, if anything (then exit status 1).

    `fast doctor --real` also looks at noise and rate of the load cell and at the watchdog of the PLC.
    """
    from fast.hardware.checkup.bench import check_open_bench

    with open_bench(bench) as opened:
        wrong = [finding for finding in check_open_bench(opened) if not finding.ok]
        reading = opened.force.read()
        x, y, z = opened.gantry.position_mm()
        is_pressed = opened.pneumatics.is_estop_pressed()
    faults = [f"{finding.name}: {finding.note}" for finding in wrong]
    data = {"position_mm": [x, y, z], "is_estop_pressed": is_pressed, "gross_n": reading.gross_n, "faults": faults}
    lines = [
        f"gantry       ready at {x:.1f}, {y:.1f}, {z:.1f} mm",
        f"PLC          e-stop {'PRESSED' if is_pressed else 'released'}",
        f"load cell    {reading.gross_n:.2f} N gross",
        *(f"FAULT        {fault}" for fault in faults),
    ]
    show(data, "\n".join(lines if faults else [*lines, "no fault"]), json)
    if faults:
        sys.exit(1)


@app.command
def lend(*, bench: ChosenBench = VIRTUAL_BENCH, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Lend the bench to the lab's page until Ctrl-C: people move it by hand there, and start campaigns on a real one.

    Of a real bench this terminal gives the leave to move, once, for as long as it lends it. Stay at the emergency stop.
    """
    from fast.flows.campaign.lend import lend_bench
    from fast.tasks.campaign.setup import read_real_bench

    found = open_lake(lake, create=True)
    if bench.real is not None:
        ask_leave(bench.real, read_real_bench(bench.real), None, bench.yes_move)
    asked = watch_signals()
    say_progress(f"lent to the page of {found.address} until Ctrl-C")
    sentence = lend_bench(found, bench.world, bench.real, asked.is_set)
    show({"lent": False}, sentence, json)


@app.command(name="tool")
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
    """Find where the tool is, from journal and sensors, and the one safe way on. Homes first; moves no tool."""
    says = on_head is not None or head_empty
    if says != bool(person) or (on_head is not None and head_empty):
        raise UsageError("say either --on-head SLOT or --head-empty, and who looked with --person NAME.")
    with open_bench(bench, tools=rack(design)) as opened:
        changer = opened.changer
        status = changer.note_tool(on_head, person) if says else changer.status()
    data = {"slot": status.slot, "sentence": status.sentence, "way_on": status.way.value}
    show(data, f"{status.sentence} Way on: {status.way.value}.", json)


def _check_target(
    met: "RigidObject", own_objects: tuple[tuple[int, int], ...], slot: int, tools: "Mapping[int, MountedTool]"
) -> None:
    """Raise UsageError for an object without a place or an empty slot, before a bench is opened."""
    from fast.hardware.parts.layout import N_OBJECTS, BenchLayout

    is_own = met.shape is not None
    if is_own and not own_objects:
        raise UsageError(f"say with --place where `{met.name}` stands: a number from 0 to {N_OBJECTS - 1}.")
    if own_objects and not is_own:
        raise UsageError(f"--place is of an own object; `{met.name}` stands on place {met.object_id}, leave it out.")
    BenchLayout(own_objects=own_objects).object_xy_mm(met.object_id)
    if slot not in tools:
        raise UsageError(f"slot {slot} has no tool; mounted are slots {min(tools)} to {max(tools)}.")


def _grasp_row(made: "MeasuredGrasp") -> dict[str, Any]:
    from fast.models.traces import peak_force_n, work_j

    return {
        "object_id": made.object_id,
        "repeat": made.repeat,
        "status": made.status,
        "reason": made.reason,
        "peak_force_n": peak_force_n(made.trace),
        "work_j": work_j(made.trace),
        "n_samples": len(made.trace.force_n),
    }


def _grasp_line(row: dict[str, Any]) -> str:
    from fast.models.objects.catalogue import name_object

    line = (
        f"{name_object(row['object_id'])}, repeat {row['repeat']}: peak {row['peak_force_n']:.2f} N, "
        f"work {1000 * row['work_j']:.1f} mJ, {row['n_samples']} samples"
    )
    return line if row["status"] == "ok" else f"{line}; failed: {row['reason']}"


@contextmanager
def open_bench(
    chosen: ChosenBench,
    may_vent: bool = False,
    tools: "Mapping[int, MountedTool] | None" = None,
    own_objects: tuple[tuple[int, int], ...] = (),
) -> "Iterator[Bench]":
    """Open the bench asked for, connected and homed; `own_objects`: numbers of own objects with their places.

    Raises:
        UsageError: a wrong file, or the real bench was not confirmed.
    """
    from fast.hardware.bench import LogFolders, open_real_bench, open_virtual_bench
    from fast.hardware.parts.layout import BenchLayout
    from fast.tasks.campaign.setup import read_bench, read_world

    mounted = rack(None) if tools is None else tools
    if chosen.real is None:
        layout = BenchLayout(own_objects=own_objects)
        world, logs = read_world(chosen.world), LogFolders(log_folder(None))
        with open_virtual_bench(world, mounted, logs=logs, layout=layout) as bench:
            yield bench
        return
    settings = read_bench(chosen.real)
    if own_objects:
        settings = settings.model_copy(
            update={"layout": settings.layout.model_copy(update={"own_objects": own_objects})}
        )
    ask_leave(chosen.real, settings, mounted, chosen.yes_move)
    with open_real_bench(settings, mounted, may_vent=may_vent, log_folder=log_folder(None)) as bench:
        yield bench
