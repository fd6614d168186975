"""The features of the how-tos as factors of a tiny campaign: what each level adds to its config, and what is refused.

Three tools at first, three that the scientist chooses, one simulation for each stage, on two objects; simulator and
world are coarse.
"""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fast.flows.server.lab import CHECKOUT
from fast.models.design.families import find_family
from fast.models.design.space import DesignSpace
from tests.studies.platform.pairwise import Case, Pair

NAME, PRIOR = "pairs", "prior"
OFF = "none"
WORLD = "[mesh]\nedge_mm = 20.0\nlayers = 1\n[sensor]\nrate_hz = 20\n"
OBJECT = """
[[parts]]
shape = "cylinder"
diameter_mm = 14
length_mm = 40
at_mm = [0, 0, 20]
[[parts]]
shape = "sphere"
diameter_mm = 30
at_mm = [0, 0, 12]
"""
_RANGE = {
    "fin-ray": ("height_mm", [95.0, 105.0]),
    "graded-fin-ray": ("height_mm", [95.0, 105.0]),
    "free-form": ("height_mm", [95.0, 105.0]),
    "slotted:Slotted": ("wall_mm", [2.0, 3.0]),
}
Config = dict[str, Any]

# By factor and level: what is added to the config. The first level of each factor is the config without it.
FEATURES: Mapping[str, Mapping[str, Config]] = {
    "bench": {
        "gantry": {"bench": {"world": "world.toml"}},
        "folder": {"bench": {"kind": "folder"}},
        "arm": {"bench": {"world": "world.toml", "real": "arm.toml"}},
    },
    "family": {family: {"design": {"family": family}} for family in _RANGE},
    "objects": {
        OFF: {"objects": {"ids": [0, 2]}},
        "own": {"objects": {"ids": [0], "files": ["dumbbell.toml"]}},
        "own on a place": {"objects": {"ids": [0], "files": ["dumbbell.toml"], "places": [14]}},
    },
    "objectives": {
        OFF: {},
        "two": {"scientist": {"objectives": ["mean_peak_n", "mass_g"]}},
        "worst and pressure": {"scientist": {"at_least": {"worst_peak_n": 1.0}, "at_most": {"pressure_kpa": 9000.0}}},
        "work": {"scientist": {"objectives": ["mean_work_j"]}},
    },
    "designs": {OFF: {}, "own": {"designs": "mine.csv"}},
    "ranges": {OFF: {}, "narrow": {}},
    "lab": {OFF: {}, "turin": {"lab": "turin"}},
    "prior": {OFF: {}, "one": {"scientist": {"prior_campaigns": [PRIOR]}}},
    "night": {OFF: {}, "on": {"night": {"active": True}}},
    "gap": {OFF: {}, "on": {"gap": {"active": True, "budget_share": 0.3}}},
    "reference tools": {OFF: {}, "best": {"schedule": {"reference_tools": 1}}},
    "reference finger": {OFF: {}, "fin-ray": {"schedule": {"reference": "fin-ray"}}},
    "recipe": {OFF: {}, "polyjet": {"print": {"recipe": "polyjet.toml"}}},
    "material": {OFF: {}, "lot": {"material": "lot.toml"}},
    "surrogate": {OFF: {}, "log": {"scientist": {"surrogate": "log"}}},
    "repeats": {OFF: {}, "interleaved": {"objects": {"repeats": 2, "repeats_order": "interleaved"}}},
}  # fmt: skip
_BASE: Config = {
    "name": NAME,
    "seed": 5,
    "schedule": {
        "initial_tools": 3, "tools_per_batch": 3, "guided_batches": 1, "initial_simulations": 1,
        "simulations_per_batch": 1,
    },
    "objects": {"repeats": 1},
    "simulator": {"mesh": {"edge_mm": 20.0}},
    "execution": {"simulation_workers": 1, "print_poll_s": 0.2, "again_grasps": 0},
}  # fmt: skip


def _pair(one: str, level: str, other: str, other_level: str) -> Pair:
    return frozenset(((one, level), (other, other_level)))


# Pairs that are refused by design, and words of the sentence that says so.
REFUSED: Mapping[Pair, str] = {
    _pair("reference finger", "fin-ray", "family", "free-form"): "the family `free-form` cannot draw",
    _pair("reference finger", "fin-ray", "family", "slotted:Slotted"): "the family `slotted:Slotted` cannot draw",
}


def levels() -> dict[str, list[str]]:
    """The levels of each factor."""
    return {factor: list(found) for factor, found in FEATURES.items()}


def plain_case() -> Case:
    """The case without any feature: the first level of each factor."""
    return {factor: next(iter(found)) for factor, found in FEATURES.items()}


def make_config(case: Case) -> Config:
    """The config of a case, as the data of its TOML file."""
    config = json.loads(json.dumps(_BASE))
    for factor, level in case.items():
        _merge(config, FEATURES[factor][level])
    if case["ranges"] != OFF:
        name, limits = _RANGE[case["family"]]
        config["design"] |= {"ranges": {name: limits}}
        config["design"]["limits"] = [{"of": {"length_mm": 1.0, "width_mm": 1.0}, "at_most": 66.0}]
    return config


def write_case(case: Case, folder: Path) -> Path:
    """Write the config of a case with all files that it names; returns the config's path."""
    folder.mkdir(parents=True, exist_ok=True)
    page = (CHECKOUT / "docs" / "how-to" / "add-a-family.md").read_text(encoding="utf-8")
    (folder / "slotted.py").write_text(page.partition("```python\n")[2].partition("```")[0], encoding="utf-8")
    (folder / "world.toml").write_text(WORLD, encoding="utf-8")
    (folder / "dumbbell.toml").write_text(OBJECT, encoding="utf-8")
    shutil.copy(CHECKOUT / "recipes" / "polyjet.toml", folder / "polyjet.toml")
    shutil.copy(CHECKOUT / "materials" / "paper.toml", folder / "lot.toml")
    (folder / "mine.csv").write_text(_own_designs(_space_of(case, folder)), encoding="utf-8")
    path = folder / f"{NAME}.toml"
    path.write_text(write_toml(make_config(case)), encoding="utf-8")
    return path


def write_prior(case: Case, folder: Path) -> Path:
    """Write the config of a campaign on a folder bench that the case learns from: three tools on the first object."""
    config = make_config(plain_case() | {"bench": "folder", "family": case["family"], "ranges": case["ranges"]})
    config |= {"name": PRIOR, "seed": 8, "simulator": {"simulate_tools": False}}
    config["schedule"] = {
        "initial_tools": 3, "tools_per_batch": 3, "guided_batches": 0, "initial_simulations": 0,
        "simulations_per_batch": 0,
    }  # fmt: skip
    config["objects"] = {"ids": [0], "repeats": 1}
    path = folder / f"{PRIOR}.toml"
    path.write_text(write_toml(config), encoding="utf-8")
    return path


def write_toml(config: Config) -> str:
    """TOML of a config: values first, then a table for each section."""
    values = [f"{key} = {_value(value)}" for key, value in config.items() if not isinstance(value, dict)]
    tables = [
        "\n".join([f"[{name}]", *(f"{key} = {_value(value)}" for key, value in section.items())])
        for name, section in config.items()
        if isinstance(section, dict)
    ]
    return "\n\n".join(["\n".join(values), *tables]) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_value(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)


def _merge(config: Config, more: Config) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(config.get(key), dict):
            _merge(config[key], value)
        else:
            config[key] = json.loads(json.dumps(value))


def _space_of(case: Case, folder: Path) -> DesignSpace:
    """The narrow ranges of a case's family; one of a user's own is found in the folder."""
    name, (low, high) = _RANGE[case["family"]]
    before = Path.cwd()
    os.chdir(folder)
    try:
        return DesignSpace.of(find_family(case["family"]), {name: (low, high)}, ())
    finally:
        os.chdir(before)


def _own_designs(space: DesignSpace) -> str:
    """A CSV file with a design for the first batch and one for the last."""
    designs = [design.model_dump() for design in space.random_designs(2, np.random.default_rng(3))]
    rows = [
        ",".join(["name", "batch", *designs[0]]),
        *(",".join([f"mine {n}", str(n), *map(str, design.values())]) for n, design in enumerate(designs, start=1)),
    ]
    return "\n".join(rows) + "\n"
