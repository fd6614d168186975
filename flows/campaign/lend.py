"""Lending a bench to the lab's page: what the process near it does with the orders that come."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fast.flows.server.server import address_for_others
from fast.hardware.arm.by_hand import open_arm_by_hand
from fast.hardware.arm.settings import ArmSettings
from fast.hardware.bench import BenchSettings, LogFolders, open_real_bench, open_virtual_bench
from fast.hardware.by_hand import ByHand
from fast.hardware.hand import Hand
from fast.hardware.own_bench import OwnBenchSettings
from fast.hardware.parts.layout import N_SLOTS
from fast.hardware.tools.mounted import MountedTool
from fast.lake.store import Lake
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import ConfigError, UsageError
from fast.models.ids import tool_label
from fast.tasks.bench.lend import Lender
from fast.tasks.campaign.config import load_config, relative_to
from fast.tasks.campaign.requests import bench_log_folder
from fast.tasks.campaign.setup import read_real_bench, read_world


def lend_bench(
    lake: Lake, world: Path, real: Path | None, should_end: Callable[[], bool], first_holder: str = ""
) -> str:
    """Lend the bench of a file, for which leave was given, or the virtual one of a world; how it ended, a sentence.

    Raises:
        FastError: a file cannot be used, or another process lends a bench of this lake.
    """
    logs = bench_log_folder(lake)
    tools = {slot: MountedTool(tool_label(0, slot), BEST_PUBLISHED) for slot in range(N_SLOTS)}
    file = world if real is None else real
    given = file.read_bytes() if file.is_file() else b""
    read_world(world) if real is None else _read_lent(real)  # its faults are said before anything is lent

    @contextmanager
    def open_bench(may_vent: bool) -> Iterator[Hand]:
        if real is None:
            kept = LogFolders(on_a_fault=logs)
            with open_virtual_bench(read_world(world), tools, wires="memory", logs=kept) as bench:
                yield ByHand(bench)
            return
        _require_same(real, given)
        settings = _read_lent(real)
        if isinstance(settings, ArmSettings):
            with open_arm_by_hand(settings, may_grip=may_vent) as arm:
                yield arm
            return
        with open_real_bench(settings, tools, may_vent=may_vent, log_folder=logs) as bench:
            yield ByHand(bench)

    def run(config: str) -> str:
        if real is None:
            raise UsageError("a virtual bench is lent; a campaign on it needs no leave, start it on the tab Start.")
        _require_same(real, given)
        return _run_campaign(lake, Path(config), real)

    return Lender(lake, file.stem, str(file.resolve()), real is not None, open_bench, run, should_end).lend(
        first_holder
    )


def find_bench_file(config: Path) -> Path | None:
    """Find the bench file of a campaign's config; None where it names none.

    Raises:
        ConfigError: the config cannot be used.
    """
    named = load_config(config).bench.real
    return relative_to(config, named).resolve() if named is not None else None


def _read_lent(file: Path) -> BenchSettings | ArmSettings:
    """Read the bench of a file, if people can move it by hand; raises UsageError otherwise."""
    settings = read_real_bench(file)
    if isinstance(settings, OwnBenchSettings):
        raise UsageError(f"{file} names a driver of your own, which moves in campaigns only; it cannot be lent.")
    return settings


def _require_same(file: Path, given: bytes) -> None:
    """Raise UsageError where a bench file is not the one any more that leave was given for."""
    if not file.is_file() or file.read_bytes() != given:
        raise UsageError(f"{file} has changed since leave was given for it; lend the bench again. Nothing was moved.")


def _run_campaign(lake: Lake, config: Path, real: Path) -> str:
    """Run a campaign on the bench that leave was given for, in a process of its own; how it ended."""
    if find_bench_file(config) != real.resolve():
        raise ConfigError(f"{config} is not for the bench of {real}, which is lent; nothing was started.")
    command = [sys.executable, "-m", "fast.flows.cli.main", "campaign", "run", str(config)]
    leave = ["--lake", address_for_others(lake), "--real", "--yes-move", real.stem]
    done = subprocess.run([*command, *leave], check=False)
    return f"the campaign of {config.name} ended{'' if done.returncode == 0 else f' with status {done.returncode}'}"
