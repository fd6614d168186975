"""FAST: simulate soft fingers, propose better ones, measure them, and find where the simulator is wrong.

    import fast

    result = fast.simulate(fast.FinRay(length_mm=30, ...), "cube")
    campaign = fast.Campaign("pull.toml")
    batch = campaign.ask()

Names are loaded when they are first used: `import fast` itself takes milliseconds. The layers below are packages of
their own: `fast.flows`, `fast.tasks`, `fast.lake`, `fast.hardware` and `fast.models`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fast.flows.library import Campaign, find_gap, grasp_function, simulate, simulate_many
    from fast.lake.store import Lake
    from fast.models.design.fin_ray import FinRay
    from fast.models.design.space import BEST_PUBLISHED
    from fast.models.errors import FastError
    from fast.models.objects.catalogue import get_object
    from fast.models.records import Design, GraspSetup, Theta, Trace
    from fast.models.simulation.version import SimulatorVersion

_HOMES = {
    "BEST_PUBLISHED": "models.design.space",
    "Campaign": "flows.library",
    "Design": "models.records",
    "FastError": "models.errors",
    "FinRay": "models.design.fin_ray",
    "GraspSetup": "models.records",
    "Lake": "lake.store",
    "SimulatorVersion": "models.simulation.version",
    "Theta": "models.records",
    "Trace": "models.records",
    "find_gap": "flows.library",
    "get_object": "models.objects.catalogue",
    "grasp_function": "flows.library",
    "simulate": "flows.library",
    "simulate_many": "flows.library",
}

__all__ = [
    "BEST_PUBLISHED",
    "Campaign",
    "Design",
    "FastError",
    "FinRay",
    "GraspSetup",
    "Lake",
    "SimulatorVersion",
    "Theta",
    "Trace",
    "find_gap",
    "get_object",
    "grasp_function",
    "simulate",
    "simulate_many",
]


def __getattr__(name: str) -> Any:
    """The public name, from where it is defined."""
    if name not in _HOMES:
        raise AttributeError(f"module `fast` has no `{name}`; it has {', '.join(__all__)}")
    return getattr(import_module(f"fast.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
