"""Keys of a campaign config that are gone: a file is told what took their place, a config in a lake loses them."""

from collections.abc import Mapping
from typing import Any

from fast.models.errors import ConfigError

RETIRED: Mapping[str, str] = {
    "diagnostics": (
        "a gap search asks the bench for grasps with another dwell, speed or pressure (gap.active = true), and "
        "schedule.reference_tools measures tools again"
    ),
    "simulator.objective": "simulated grasps teach their peak force, which predicts a bench best",
    "scientist.min_distance": "tools of a batch keep 0.05 of the unit cube of designs from each other",
    "simulator.follow": "night.active = true takes the newest accepted version before each batch",
    "simulator.old_versions": "older simulations are converted where enough designs of both versions are known",
    "simulator.reruns": "night.max_designs says how many designs are simulated with a new version",
    "simulator.find_branches": "grasps are simulated once; the flag `snap` of a simulation says where it is unsure",
}
"""By `section` or `section.key`: what took its place."""


def refuse_retired(data: Mapping[str, Any], source: str) -> None:
    """Raise ConfigError where a config file has a key that is gone; `source` names the file."""
    for path, instead in RETIRED.items():
        section, _, key = path.partition(".")
        if section in data and (not key or _has(data[section], key)):
            raise ConfigError(f"{source}: `{path}` is gone: {instead}. Remove it.")


def drop_retired(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a lake's config without the keys that are gone; one that followed calibrations has nights instead."""
    kept = {section: values for section, values in data.items() if section not in RETIRED}
    simulator = kept.get("simulator", {})
    if simulator.get("follow") == "latest" and "night" not in kept:
        kept["night"] = {"active": True, "max_designs": simulator.get("reruns", 20)}
    for path in RETIRED:
        section, _, key = path.partition(".")
        if key and _has(kept.get(section), key):
            kept[section] = {name: value for name, value in kept[section].items() if name != key}
    return kept


def _has(section: Any, key: str) -> bool:
    return isinstance(section, Mapping) and key in section
