"""Making a challenge: worlds drawn from a secret seed, each a hand-off folder, and their keys in a folder beside."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from fast.flows.challenge.answers import LIFT_MM
from fast.flows.challenge.bank_table import write_bank
from fast.flows.challenge.hidden.bound import Bound
from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from fast.flows.challenge.hidden.worlds import Group, WorldKey, Worlds
from fast.flows.challenge.keys import SealedKey, find_keys, hash_forces, name_challenge, write_keys
from fast.flows.challenge.manifest import BANK, EFFECTS, NOT_LISTED, OBJECTS, Manifest
from fast.flows.challenge.world_folder import Made, name_grasp, write_world
from fast.lake.handoff.export_folder import write_csv
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.gap.data import GapData
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.where.strata import object_shape
from fast.models.ids import seed_from
from fast.models.records import Trace
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import is_usable
from fast.models.traces.step_noise import SensorNoise

N_WORLDS = 12
SHORTEST_SEED = 16  # characters
N_TOOLS, N_OBJECTS = 9, 7  # of a world; of each, one is asked for alone
SEED = "seed.txt"
_SHARES: tuple[tuple[Group, float], ...] = (("null", 1 / 3), ("single", 5 / 12), ("unlisted", 1 / 4))
STRENGTHS = (0.03, 0.08, 0.2)  # of the force, before the simulator's constants take up their part
_ROUNDS = 10_000  # through all effects, from which a world's is drawn


@dataclass(frozen=True)
class _Numbered:
    """A world by its name in the challenge, and its key."""

    name: str
    key: WorldKey


def read_seed(path: Path) -> str:
    """Read the secret of a seed's file.

    Raises:
        UsageError: it cannot be read, or is too short to be a secret.
    """
    try:
        seed = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(
            f"the seed {path} cannot be read ({error}); write {SHORTEST_SEED} random characters or more into it."
        ) from error
    if len(seed) < SHORTEST_SEED:
        raise UsageError(
            f"the seed in {path} has {len(seed)} characters, too few for a secret; write {SHORTEST_SEED} or more."
        )
    return seed


def make_challenge(
    seed: str,
    folder: Path,
    n_worlds: int = N_WORLDS,
    panel: Path = PANEL,
    progress: Callable[[str], None] = lambda _: None,
) -> Manifest:
    """Make a challenge's folder, and its keys beside it; always the same from a seed and a panel.

    Raises:
        UsageError: a folder is there already, or cannot be written.
    """
    keys_folder = find_keys(folder)
    for there in (folder, keys_folder):
        if there.exists():
            raise UsageError(f"{there} is there already; nothing was written: name a new folder.")
    worlds = open_worlds(seed, panel)
    try:
        folder.mkdir(parents=True)
        return _write_challenge(worlds, seed, folder, n_worlds, progress)
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise UsageError(f"{folder} cannot be written ({error}); name another folder.") from error


def open_worlds(seed: str, panel: Path) -> Worlds:
    """Open what draws the worlds of a challenge from a seed.

    Raises:
        UsageError: the panel is no file of one.
    """
    try:
        panels, bank = read_small(panel)
    except (OSError, ValueError, KeyError, StopIteration, BadZipFile) as error:
        raise UsageError(
            f"{panel} is no panel of true grasps ({error}); `python -m tests.studies gap-truth` writes panel.npz."
        ) from error
    return Worlds(panels, bank, seed, has_other_laws=True, n_designs=N_TOOLS, n_objects=N_OBJECTS, strengths=STRENGTHS)


def _write_challenge(
    worlds: Worlds, seed: str, folder: Path, n_worlds: int, progress: Callable[[str], None]
) -> Manifest:
    names = {number: f"D{place + 1:02d}" for place, number in enumerate(worlds.panels.designs)}
    _write_shared(folder, worlds, list(names.values()))
    bound = Bound.of(worlds)
    keys: list[SealedKey] = []
    withheld: dict[str, dict[str, np.ndarray]] = {}
    for one in draw_keys(worlds, seed, n_worlds):
        measured, own = _Measured.of(worlds, one.key), worlds.of(one.key).panels
        designs = {names[number]: numbered_design(number) for number in own.designs}
        write_world(folder / one.name, measured.list_made(), designs, own.objects)
        withheld[one.name], before_n = measured.forces, measured.measure_theta_alone()
        key = SealedKey(
            world=one.name,
            salt=hashlib.sha256(f"{seed}|{one.name}".encode()).hexdigest()[:32],
            key=one.key,
            before_n=before_n,
            twin_n=_Measured.of(worlds, worlds.twin(one.key)).measure_theta_alone() if one.key.effects else before_n,
            bound=round(bound.measure_power(one.key, measured.data.grasps), 4),
            withheld=hash_forces(withheld[one.name]),
        )
        keys.append(key)
        progress(f"{one.name} sealed, {keys[-1].key_hash[:12]}")
    hashes = {key.world: key.key_hash for key in keys}
    how = keys[0].key.nuisance
    noise = SensorNoise(how.noise_sd_n, how.noise_correlation_s, how.rate_hz)
    manifest = Manifest(challenge=name_challenge(hashes), load_cell=noise, worlds=hashes)
    manifest.write(folder)
    write_keys(find_keys(folder), keys, withheld)
    (find_keys(folder) / SEED).write_text(seed + "\n", encoding="utf-8")
    return manifest


def draw_keys(worlds: Worlds, seed: str, n_worlds: int) -> list[_Numbered]:
    """Draw keys in an order that tells nothing: 1/3 hide nothing, 5/12 a listed effect, the rest another."""
    rng = np.random.default_rng(seed_from("challenge", seed))
    counts = {group: round(share * n_worlds) for group, share in _SHARES}
    counts["unlisted"] += n_worlds - sum(counts.values())
    wanted = [(group, number) for group, n in counts.items() for number in _draw_numbers(worlds, group, n, rng)]
    width = max(2, len(str(n_worlds)))
    order = rng.permutation(len(wanted))
    return [_Numbered(f"w{place + 1:0{width}d}", worlds.draw(*wanted[int(at)])) for place, at in enumerate(order)]


def _draw_numbers(worlds: Worlds, group: Group, n: int, rng: np.random.Generator) -> list[int]:
    """Draw the numbers of n worlds of a group, so that each effect comes once before any comes again."""
    n_effects = max(len(worlds.list_effects(group)), 1)
    rounds = [rng.permutation(n_effects) for _ in range(-(-n // n_effects))]
    return [int(effect + n_effects * rng.integers(_ROUNDS)) for effect in np.concatenate(rounds)[:n]]


def find_withheld(key: WorldKey, n_tools: int, n_objects: int) -> tuple[int, int]:
    """Find the tool and the object of a world (numbers) whose grasps are asked for."""
    rng = np.random.default_rng(seed_from("asked", key.seed))
    return int(rng.integers(n_tools)), int(rng.integers(n_objects))


@dataclass(frozen=True, eq=False)
class _Measured:
    """A world as its lab measured it. traces: by tool, object and repeat; data: with what is asked for held out."""

    worlds: Worlds
    key: WorldKey
    traces: dict[tuple[int, int, int], Trace]
    data: GapData

    @staticmethod
    def of(worlds: Worlds, key: WorldKey) -> "_Measured":
        measured = [(site, trace) for site, trace in worlds.measure(key) if is_usable(trace)]
        problem = worlds.make_problem(key, measured)
        counts = (len(problem.grasps.tools), len(problem.grasps.objects))
        tools, objects = (np.arange(n) == one for n, one in zip(counts, find_withheld(key, *counts), strict=True))
        traces = {(site.tool, site.obj, site.context.repeat): trace for site, trace in measured}
        return _Measured(worlds, key, traces, GapData(problem.grasps, problem.bank, tools, objects))

    @property
    def forces(self) -> dict[str, np.ndarray]:
        """What the asked grasps measured (80 each, N) by name; only of cells that the bank has."""
        grasps = self.data.held_out.grasps
        each = zip(grasps.tool.tolist(), grasps.obj.tolist(), grasps.contexts, grasps.steps_n, strict=True)
        return {
            name_grasp(tool, grasps.objects[obj], context.repeat): steps_n[: len(LIFT_MM)]
            for tool, obj, context, steps_n in each
        }

    def list_made(self) -> list[Made]:
        """List all grasps in order; a withheld one that cannot be asked for, since it got lost, is a failed one."""
        data, asked, made = self.data, self.forces, []
        for site in self.worlds.lab(self.key).order():
            is_asked = name_grasp(site.tool, data.grasps.objects[site.obj], site.context.repeat) in asked
            is_withheld = bool(data.held_out_tools[site.tool] or data.held_out_objects[site.obj])
            trace = self.traces.get((site.tool, site.obj, site.context.repeat))
            shown = None if is_withheld and not is_asked else trace
            made.append(Made(site.tool, site.obj, site.context, shown, is_asked))
        return made

    def measure_theta_alone(self) -> float:
        """Measure the error of the asked grasps by the simulator with theta fitted to the others, N."""
        fit, asked = recalibrate(self.data.training), self.data.held_out
        rest_n = asked.grasps.steps_n - asked.predict_steps(fit.theta, (), fit.tool_factor)
        return round(float(np.sqrt(np.mean(rest_n[:, : len(LIFT_MM)] ** 2))), 4)


def _write_shared(folder: Path, worlds: Worlds, design_ids: list[str]) -> None:
    """Write the bank of the whole panel, measures of its objects, and the effects that an answer may name."""
    write_bank(folder / BANK, worlds.bank, design_ids)
    shapes = [object_shape(number) for number in worlds.panels.objects]
    columns = ("object_id", "name", "object_class", "height_mm", "width_mm")
    write_csv(folder / OBJECTS, columns, [{name: getattr(shape, name) for name in columns} for shape in shapes])
    effects = [
        {"effect": name, "family": spec.family, "title": spec.title, "formula": spec.formula}
        for name, spec in CATALOGUE.items()
    ]
    effects.append({"effect": NOT_LISTED, "family": "", "title": "Something that this list lacks", "formula": ""})
    write_csv(folder / EFFECTS, tuple(effects[0]), effects)
