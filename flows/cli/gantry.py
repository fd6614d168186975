"""`fast gantry`: move the bench by hand. A virtual bench unless a real one is asked for and confirmed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from flows.cli.common import AsJson, say, show
from flows.cli.virtual import Designs, rack

if TYPE_CHECKING:
    from hardware.bench import Bench
    from hardware.cell import MeasuredGrasp

app = App(name="gantry", help="Move the bench by hand: home, park, tare, grasp, faults.")

WorldFile = Annotated[Path, Parameter(help="world of the virtual bench")]
RealFile = Annotated[Path | None, Parameter(help="bench file: drive real hardware, after a typed confirmation")]
DEFAULT_WORLD = Path("worlds/quick.toml")


@app.command
def home(*, world: WorldFile = DEFAULT_WORLD, real: RealFile = None) -> None:
    """Connect to all devices and home the gantry."""
    with _bench(world, real, None) as bench:
        x, y, z = bench.gantry.position_mm()
        say(f"homed; head at x {x:.1f}, y {y:.1f}, z {z:.1f} mm")


@app.command
def park(*, world: WorldFile = DEFAULT_WORLD, real: RealFile = None) -> None:
    """Dock the tool on the head, if any, and close the air supply."""
    with _bench(world, real, None) as bench:
        bench.cell.park()
        say("parked; the head carries no tool and the air supply is closed")


@app.command
def tare(*, world: WorldFile = DEFAULT_WORLD, real: RealFile = None) -> None:
    """Zero the load cell with the head hanging free, and print the force that was taken as zero."""
    with _bench(world, real, None) as bench:
        bench.force.tare()
        base = bench.force.baseline(1.0)
        say(f"tared: {base.gross_n:.3f} N gross hang free; net {base.net_n:.3f} N, noise {base.sd_n:.3f} N")


@app.command
def grasp(
    *,
    object: Annotated[int, Parameter(help="object id, 0 to 35")],
    slot: Annotated[int, Parameter(help="slot of the tool in the rack, 0 to 9")] = 0,
    repeats: int = 1,
    design: Designs = None,
    world: WorldFile = DEFAULT_WORLD,
    real: RealFile = None,
    json: AsJson = False,
) -> None:
    """Pick a tool, grasp one object, lift to separation, park the tool. Nothing is written to a lake."""
    from models.features import peak_force_n, work_j
    from models.records import GraspSetup

    made: list[MeasuredGrasp] = []
    plan = [(object, repeat) for repeat in range(repeats)]
    with _bench(world, real, design) as bench:
        bench.cell.measure_tool(slot, plan, GraspSetup(), made.append, lambda: False)
    rows: list[dict[str, Any]] = [
        {
            "object_id": g.object_id,
            "repeat": g.repeat,
            "status": g.status,
            "reason": g.reason,
            "peak_force_n": peak_force_n(g.trace),
            "work_j": work_j(g.trace),
            "n_samples": len(g.trace.force_n),
        }
        for g in made
    ]
    text = "\n".join(_grasp_line(row) for row in rows)
    show(rows, text, json)


def _grasp_line(row: dict[str, Any]) -> str:
    line = (
        f"object {row['object_id']} repeat {row['repeat']}: peak {row['peak_force_n']:.2f} N, "
        f"work {1000 * row['work_j']:.1f} mJ, {row['n_samples']} samples"
    )
    return line if row["status"] == "ok" else f"{line}; failed: {row['reason']}"


@app.command
def faults(*, world: WorldFile = DEFAULT_WORLD, real: RealFile = None) -> None:
    """Connect to every device and say what is wrong with it, if anything."""
    with _bench(world, real, None) as bench:
        reading = bench.force.read()
        say(f"gantry       ready at {', '.join(f'{v:.1f}' for v in bench.gantry.position_mm())} mm")
        say(f"PLC          e-stop {'PRESSED' if bench.pneumatics.is_estop_pressed() else 'released'}")
        say(f"load cell    {reading.gross_n:.2f} N gross, no fault")


@contextmanager
def _bench(world: Path, real: Path | None, designs: list[Path] | None) -> "Iterator[Bench]":
    """The bench asked for, connected and homed.

    Raises:
        UsageError: the real bench was not confirmed.
    """
    from flows.cli.campaign import typed_confirmation
    from flows.launch import read_bench, read_world
    from hardware.bench import open_real_bench, open_virtual_bench
    from models.errors import UsageError

    tools = rack(designs)
    if real is None:
        with open_virtual_bench(read_world(world), tools) as bench:
            yield bench
        return
    settings = read_bench(real)
    if not typed_confirmation("move", str(real)):
        raise UsageError("--real was not confirmed; nothing was moved.")
    with open_real_bench(settings, tools) as bench:
        yield bench
