"""Leave to move real hardware: what will move is printed, and a person types the name of the bench.

Simulation is the default everywhere. A process without a terminal moves nothing, unless the bench is named on its
command line; an automatic build (environment variable CI) moves nothing real at all.
"""

import ipaddress
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from fast.flows.cli.common import say_progress
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.hardware.arm.settings import ArmSettings
    from fast.hardware.bench import BenchSettings
    from fast.hardware.tools.mounted import MountedTool
    from fast.tasks.campaign.setup import RealBench

YesMove = Annotated[
    str | None,
    Parameter(help="With --real and no terminal: name of the bench (its file without .toml); a person watches it."),
]
BUILD_VARIABLE = "CI"


def ask_leave(
    bench_file: Path,
    settings: "RealBench",
    tools: "Mapping[int, MountedTool] | None",
    yes_move: str | None,
) -> None:
    """Print what will move, then have a person type the name of the bench (or take `yes_move` for it).

    Args:
        bench_file: its name without ending is the name of the bench.
        settings: of that bench.
        tools: what is mounted, or None while that is still to be decided.
        yes_move: name of the bench as given on the command line, or None.

    Raises:
        UsageError: no leave; nothing was moved.
    """
    name = bench_file.stem
    say_progress(what_moves(name, settings, tools))
    if os.environ.get(BUILD_VARIABLE, "").lower() in ("1", "true", "yes") and not is_rehearsal(settings):
        raise UsageError(f"{BUILD_VARIABLE} is set: an automatic build never moves a machine; nothing was moved.")
    if yes_move is not None:
        if yes_move == name:
            return
        raise UsageError(f"--yes-move names `{yes_move}`, but this bench is `{name}`; nothing was moved.")
    if not has_terminal():
        raise UsageError(
            "--real was not confirmed: there is no terminal. If a person watches the machine, add "
            f"`--yes-move {name}`; nothing was moved."
        )
    say_progress(
        f"Is the workspace clear, and a hand at the emergency stop? Type the name of the bench, `{name}`, to go on:"
    )
    if _typed() != name:
        raise UsageError("--real was not confirmed; nothing was moved.")


def has_terminal() -> bool:
    """Return whether a person can type here."""
    return sys.stdin is not None and sys.stdin.isatty()


def is_rehearsal(settings: "RealBench") -> bool:
    """Return whether all addresses are this computer's own pty and loopback: a virtual bench, nothing that can move."""
    from fast.hardware.arm.settings import ArmSettings
    from fast.hardware.own_bench import OwnBenchSettings

    if isinstance(settings, OwnBenchSettings):
        return False  # only its driver knows
    if isinstance(settings, ArmSettings):
        return _is_loopback(settings.host)
    ports = [settings.serial_port, settings.transmitter_serial_port]
    hosts = [settings.plc_host] if settings.transmitter_serial_port else [settings.plc_host, settings.transmitter_host]
    return all(port is None or os.path.realpath(port).startswith("/dev/pts/") for port in ports) and all(
        _is_loopback(host) for host in hosts
    )


def what_moves(name: str, settings: "RealBench", tools: "Mapping[int, MountedTool] | None") -> str:
    """Say what a bench will do when it is let: axes, box, speeds, tools, air and valves."""
    from fast.hardware.arm.settings import ArmSettings
    from fast.hardware.own_bench import OwnBenchSettings

    rehearsal = " (a rehearsal: all its addresses are virtual)" if is_rehearsal(settings) else ""
    first = f"--real moves hardware: bench `{name}`{rehearsal}"
    if isinstance(settings, ArmSettings):
        return "\n".join([first, *_arm_lines(settings)])
    if isinstance(settings, OwnBenchSettings):
        lines = [first, f"  driver     {settings.kind}", f"  moves      {settings.moves}"]
        return "\n".join([*lines, *_tool_lines({}, tools)])
    from fast.hardware.click import tags
    from fast.hardware.grbl.workspace import Workspace

    profile = settings.gantry_profile
    x_mm, y_mm, z_mm = Workspace.nominal(profile, settings.layout.workspace_mm).size_mm
    x_speed, y_speed, z_speed = profile.max_speed_mm_per_s
    ends = "".join("+" if profile.homes_to_plus_end(axis) else "-" for axis in range(3))
    lines = [
        first,
        f"  gantry     {settings.serial_port}: homes to the ends {ends[2]}Z, then {ends[0]}X and {ends[1]}Y, "
        f"at {profile.seek_mm_per_s:g} mm/s",
        f"  box        x 0 to {x_mm:g}, y 0 to {y_mm:g}, z 0 to {z_mm:g} mm, at up to {x_speed:g}, {y_speed:g}, "
        f"{z_speed:g} mm/s",
        f"  air        {settings.supply_pressure_psi:g} psi: supply valve {tags.SUPPLY_OUTPUT}, gripper valve "
        f"{tags.GRIP_OUTPUT}, tool lock {tags.LOCK_OUTPUT}, by the PLC at {settings.plc_host}:{settings.plc_port}",
        f"  load cell  {_transmitter(settings)}",
    ]
    return "\n".join([*lines, *_tool_lines(settings.tool_mass_kg, tools)])


def _arm_lines(settings: "ArmSettings") -> list[str]:
    return [
        f"  arm        {settings.host}: straight lines at up to {settings.travel_speed_mm_per_s:g} mm/s, between "
        f"places with the flange at {settings.travel_z_mm:g} mm",
        f"  places     {len(settings.rack_mm)} of the rack, {len(settings.mounts_mm)} of objects",
        f"  air        output {settings.grip_output} closes the gripper, output {settings.lock_output} locks the tool",
        f"  force      of the wrist; a grasp ends above {settings.most_force_n:g} N",
        *_tool_lines({}, None),
    ]


def _transmitter(settings: "BenchSettings") -> str:
    if settings.transmitter_serial_port is not None:
        return settings.transmitter_serial_port
    return f"{settings.transmitter_host}:{settings.transmitter_port}"


def _tool_lines(weighed: "Mapping[int, float]", tools: "Mapping[int, MountedTool] | None") -> list[str]:
    if tools is None:
        return ["  tools      those of each batch, picked from slots 0 to 9 once a person has said they are mounted"]
    lines: list[str] = []
    for slot, tool in sorted(tools.items()):
        weighed_kg = weighed.get(slot, tool.mass_kg)
        mass = f"{weighed_kg:.3f} kg weighed" if weighed_kg is not None else f"{tool.expected_mass_kg:.3f} kg estimated"
        lines.append(f"  {'tools' if not lines else '':<10} slot {slot}: {tool.tool_id}, {mass}")
    return lines or ["  tools      none"]


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _typed() -> str:
    try:
        return input().strip()
    except EOFError:
        return ""
