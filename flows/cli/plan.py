"""`fast gantry plan`: how long a batch takes, what the time goes into, and what the order of the grasps costs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.common import AsJson, show
from fast.flows.cli.virtual import Designs, rack

if TYPE_CHECKING:
    from fast.hardware.bench import BenchSettings
    from fast.hardware.station.cycle_time import PlanTime
    from fast.models.records import GraspSetup
    from fast.tasks.campaign.settings import ObjectPlan

PAPER_GRASPS_PER_HOUR = 240

Config = Annotated[Path | None, Parameter(help="Campaign config with the objects, their order and the grasp setup.")]


def plan(
    *,
    tools: Annotated[int, Parameter(help="Tools of the batch.", validator=Number(gte=1, lte=10))] = 10,
    order: Annotated[Literal["fixed", "random"] | None, Parameter(help="Instead of the config's.")] = None,
    repeats_order: Annotated[
        Literal["together", "interleaved"] | None, Parameter(help="Instead of the config's.")
    ] = None,
    config: Config = None,
    real: Annotated[
        Path | None, Parameter(help="Bench file whose speeds and places count; default: the config's, or the lab's.")
    ] = None,
    design: Designs = None,
    json: AsJson = False,
) -> None:
    """Compute time per tool and batch, grasps per hour beside the paper's 240, and dominant parts. Nothing moves."""
    from fast.hardware.station.cycle_time import add_up
    from fast.models.errors import UsageError

    objects, setup, bench = _what(config, real)
    asked = {"order": order, "repeats_order": repeats_order}
    objects = objects.model_copy(update={name: value for name, value in asked.items() if value is not None})
    if tools > bench.layout.n_slots:
        raise UsageError(f"{tools} tools do not fit a dock of {bench.layout.n_slots} slots; lower --tools.")
    times = _times(objects, setup, bench, tools, design)
    n_grasps = sum(len(time.item_s) for time in times)
    modelled_s = sum(time.total_s for time in times) / n_grasps
    fixed = objects.model_copy(update={"order": "fixed", "repeats_order": "together"})
    shortest_s = sum(time.total_s for time in _times(fixed, setup, bench, tools, design)) / n_grasps
    data = {
        "tools": tools,
        "grasps": n_grasps,
        "order": objects.order,
        "repeats_order": objects.repeats_order,
        "grasp_s": modelled_s,
        "grasps_per_hour": 3600 / modelled_s,
        "paper_grasps_per_hour": PAPER_GRASPS_PER_HOUR,
        "tool_s": [time.total_s for time in times],
        "batch_s": sum(time.total_s for time in times),
        "order_costs_s_per_grasp": modelled_s - shortest_s,
        "parts_s_per_grasp": {name: s / n_grasps for name, s in add_up(time.parts_s for time in times).items()},
    }
    show(data, _text(data), json)


def _what(config: Path | None, real: Path | None) -> "tuple[ObjectPlan, GraspSetup, BenchSettings]":
    """Return objects and setup of a config, and its bench; one that is no gantry has the times of the lab's."""
    from fast.hardware.bench import BenchSettings
    from fast.models.records import GraspSetup
    from fast.tasks.campaign.config import load_config, relative_to
    from fast.tasks.campaign.settings import ObjectPlan
    from fast.tasks.campaign.setup import read_bench, read_real_bench

    bench = BenchSettings() if real is None else read_bench(real)
    if config is None:
        return ObjectPlan(), GraspSetup(), bench
    loaded = load_config(config)
    if real is None and loaded.bench.real is not None:
        named = read_real_bench(relative_to(config, loaded.bench.real))
        bench = named if isinstance(named, BenchSettings) else bench
    return loaded.objects, loaded.grasp, bench


def _times(
    objects: "ObjectPlan", setup: "GraspSetup", bench: "BenchSettings", n_tools: int, design: list[Path] | None
) -> "list[PlanTime]":
    """Make one plan per tool, each with its own order; fewer designs than tools are used again."""
    from fast.hardware.station.cycle_time import plan_time

    mounted, layout, profile = list(rack(design).values()), objects.stand_on(bench.layout), bench.gantry_profile

    def plan_slot(slot: int) -> "PlanTime":
        tool, cells = mounted[slot % len(mounted)], objects.list_grasps(slot)
        return plan_time(tool, slot, cells, setup, layout, profile, from_slot=max(slot - 1, 0))

    return [plan_slot(slot) for slot in range(n_tools)]


def _text(data: dict[str, Any]) -> str:
    parts = [f"  {name.replace('_', ' '):<16} {s:6.2f} s" for name, s in data["parts_s_per_grasp"].items()]
    slowest, fastest = max(data["tool_s"]), min(data["tool_s"])
    return "\n".join([
        f"{data['grasps']} grasps with {data['tools']} tools, order {data['order']}, repeats {data['repeats_order']}",
        f"batch {_duration(data['batch_s'])}; a tool {_duration(fastest)} to {_duration(slowest)}",
        f"{data['grasp_s']:.2f} s a grasp: {data['grasps_per_hour']:.0f} an hour in theory "
        f"(the paper: {data['paper_grasps_per_hour']}); "
        f"the order costs {data['order_costs_s_per_grasp']:.2f} s of it",
        "of a grasp's time:",
        *parts,
    ])  # fmt: skip


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"
