"""A campaign of made-up grasps and simulations: all of it is real but the physics."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import build_request
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.simulation.attempt import Attempt, GraspJob
from tests.studies.benchmarks.fingerprints import fingerprint, fingerprint_world

if TYPE_CHECKING:
    from fast.flows.campaign.process import CampaignOutcome
    from fast.flows.progress import ProgressReporter

N_TOOLS, OBJECTS, N_REPEATS = 10, (0, 7, 14, 24, 30), 2
N_SIMULATIONS = 20
SIMULATION_S = 0.2  # wall time of a made-up simulation


@dataclass(frozen=True)
class Size:
    """How much a made-up campaign does."""

    n_tools: int = N_TOOLS
    object_ids: tuple[int, ...] = OBJECTS
    n_repeats: int = N_REPEATS
    n_simulations: int = N_SIMULATIONS
    print_poll_s: float = 0.5  # between looks whether a person has confirmed; campaigns of people have 5 s


def made_up_attempt(job: GraspJob, wall_s: float = SIMULATION_S) -> Attempt:
    """What `tasks.simulation.attempt.attempt_grasp` does, without a solver."""
    time.sleep(wall_s)
    request = build_request(World(), "made-up/B01T0", job.design, job.object_id, job.setup)
    return Attempt(fingerprint(request), "", "", cpu_s=0.0, mesh_cpu_s=0.0, wall_s=wall_s, worker=os.getpid())


def run_made_up_campaign(
    config_path: Path,
    lake: Path,
    *,
    auto_print: bool,
    reporter: "ProgressReporter",
    attempt: Callable[[GraspJob], Attempt] = made_up_attempt,
) -> "CampaignOutcome":
    """Run a campaign in which nothing is computed: neither simulations nor the truth of the virtual bench.

    `attempt` stands in for a simulation, in this process from now on.
    """
    from fast.flows.campaign.launch import run_campaign
    from fast.tasks.simulation import simulate as simulating

    simulating.attempt_grasp = attempt  # type: ignore[assignment]  # a partial has no name for its argument
    return run_campaign(config_path, lake, auto_print=auto_print, reporter=reporter, physics_of_truth=fingerprint)


def config_of(name: str, size: Size = Size()) -> CampaignConfig:
    """One batch of tools, with simulations beside it; nothing is learnt."""
    schedule = {"initial_tools": size.n_tools, "initial_simulations": size.n_simulations, "guided_batches": 0}
    objects = {"ids": size.object_ids, "repeats": size.n_repeats}
    execution = {"simulation_workers": 1, "print_poll_s": size.print_poll_s}
    data = {"name": name, "schedule": schedule, "objects": objects, "bench": {"world": "world.toml"}}
    return CampaignConfig.model_validate({**data, "execution": execution})


def write_files(folder: Path, name: str, size: Size = Size()) -> Path:
    """Config of a campaign, and its world, in which a trace says of what grasp it is; returns the config's path."""
    config, world = config_of(name, size), world_of(name)
    rows = [f'name = "{name}"', "[schedule]", *_lines(config.schedule.model_dump(exclude_defaults=True))]
    rows += ["[objects]", f"ids = {list(size.object_ids)}", f"repeats = {size.n_repeats}"]
    rows += ['[bench]\nworld = "world.toml"']
    rows += ["[execution]", "simulation_workers = 1", f"print_poll_s = {size.print_poll_s}"]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(rows) + "\n")
    (folder / "world.toml").write_text(f"seed = {world.seed}\n[scatter]\nrepeat_sd = {world.scatter.repeat_sd}\n")
    return path


def labels_of(name: str) -> list[tuple[str, int, int]]:
    """Every grasp that the campaign owes."""
    tools = [f"{name}/B01T{slot}" for slot in range(N_TOOLS)]
    return [(tool, o, repeat) for tool in tools for o in OBJECTS for repeat in range(N_REPEATS)]


def world_of(name: str) -> World:
    """The world of a campaign."""
    return fingerprint_world(labels_of(name))


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {value}" for key, value in table.items()]
