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
    from fast.lake.handoff import HandoffTables
    from fast.lake.store import Lake
    from fast.models.design.fin_ray import FinRay
    from fast.models.design.space import BEST_PUBLISHED, from_unit, random_unit, to_unit
    from fast.models.errors import FastError, SimulationFailed
    from fast.models.objects.catalogue import get_object
    from fast.models.objects.rigid import RigidObject
    from fast.models.records import Design, GraspSetup, Placement, Theta, Trace
    from fast.models.scientist.bridge.entropy import MaxValueEntropy
    from fast.models.scientist.bridge.model import SurrogateModel
    from fast.models.scientist.surrogate.fit import fit_surrogate
    from fast.models.scientist.surrogate.observations import ObservationSet
    from fast.models.simulation.grasp import simulate_grasp
    from fast.models.simulation.output.recording import GraspRecording
    from fast.models.simulation.output.surface import skin_of
    from fast.models.simulation.version import SimulatorVersion
    from fast.tasks.traces.features import update_features

_HOMES = {
    "BEST_PUBLISHED": "models.design.space",
    "Campaign": "flows.library",
    "Design": "models.records",
    "FastError": "models.errors",
    "FinRay": "models.design.fin_ray",
    "GraspRecording": "models.simulation.output.recording",
    "GraspSetup": "models.records",
    "HandoffTables": "lake.handoff",
    "Lake": "lake.store",
    "MaxValueEntropy": "models.scientist.bridge.entropy",
    "ObservationSet": "models.scientist.surrogate.observations",
    "Placement": "models.records",
    "RigidObject": "models.objects.rigid",
    "SimulationFailed": "models.errors",
    "SimulatorVersion": "models.simulation.version",
    "SurrogateModel": "models.scientist.bridge.model",
    "Theta": "models.records",
    "Trace": "models.records",
    "find_gap": "flows.library",
    "fit_surrogate": "models.scientist.surrogate.fit",
    "from_unit": "models.design.space",
    "get_object": "models.objects.catalogue",
    "grasp_function": "flows.library",
    "random_unit": "models.design.space",
    "simulate": "flows.library",
    "simulate_grasp": "models.simulation.grasp",
    "simulate_many": "flows.library",
    "skin_of": "models.simulation.output.surface",
    "to_unit": "models.design.space",
    "update_features": "tasks.traces.features",
}

__all__ = [
    "BEST_PUBLISHED",
    "Campaign",
    "Design",
    "FastError",
    "FinRay",
    "GraspRecording",
    "GraspSetup",
    "HandoffTables",
    "Lake",
    "MaxValueEntropy",
    "ObservationSet",
    "Placement",
    "RigidObject",
    "SimulationFailed",
    "SimulatorVersion",
    "SurrogateModel",
    "Theta",
    "Trace",
    "find_gap",
    "fit_surrogate",
    "from_unit",
    "get_object",
    "grasp_function",
    "random_unit",
    "simulate",
    "simulate_grasp",
    "simulate_many",
    "skin_of",
    "to_unit",
    "update_features",
]


def __getattr__(name: str) -> Any:
    """Return the public name, from where it is defined."""
    if name not in _HOMES:
        raise AttributeError(f"module `fast` has no `{name}`; it has {', '.join(__all__)}")
    found = getattr(import_module(f"fast.{_HOMES[name]}"), name)
    if hasattr(found, "model_rebuild"):  # a record knows its arguments only then, and notebooks complete them
        found.model_rebuild()
    return found


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
