"""Made-up grasps whose force says which tool gripped which object for which time, whatever their label says.

The trace of a grasp has three plateaus over the lift: `BASE_N`, one that grows with the tool's slot, and one that
grows with the object. The scatter from grasp to grasp of the world multiplies all three, so that the first gives the
factor, and the factor the repeat. They reach the lake over the wires like any other grasp.
"""

from collections.abc import Iterable
from itertools import combinations, count

import numpy as np

from fast.hardware.virtual.world.file import Scatter, World
from fast.hardware.virtual.world.physics import PhysicsRequest, build_request, grasp_curve
from fast.models.design.space import BEST_PUBLISHED
from fast.models.records import GraspSetup, GraspSimulation, Trace

Label = tuple[str, int, int]  # (tool id, object id, repeat)

BASE_N, SLOT_N, OBJECT_N = 30.0, 3.0, 0.8
PLATEAUS_MM = ((6.0, 14.0), (18.0, 26.0), (30.0, 38.0))
RELEASED_MM = 45.0
EDGE_MM = 1.0  # from plateau to plateau
REPEAT_SD = 0.15  # three of these still stay below the full scale of the load cell
LEAST_DIFFERENCE = 0.002  # between the factors of repeats: six times what the load cell resolves


def fingerprint(request: PhysicsRequest) -> GraspSimulation:
    """A `Physics` that costs nothing: the made-up grasp of one tool on one object."""
    heights_n = np.array([BASE_N, _slot_n(slot_of(request.tool_id)), _object_n(request.object_id)])
    edges_mm = np.array([[low - EDGE_MM, low, high, high + EDGE_MM] for low, high in PLATEAUS_MM])
    knots_mm = np.concatenate([[0.0], edges_mm.ravel(), [RELEASED_MM]])
    knots_n = np.concatenate([[0.0], np.outer(heights_n, [0.5, 1.0, 1.0, 0.5]).ravel(), [0.0]])
    closing_s = np.linspace(0.0, 1.35, 8)
    time_s = np.concatenate([closing_s, 1.4 + knots_mm / request.setup.lift_speed_mm_per_s])
    trace = Trace(time_s, np.concatenate([np.zeros(8), knots_mm]), np.concatenate([np.zeros(8), knots_n]))
    peak_n = float(knots_n.max())
    return GraspSimulation(
        trace=trace, peak_force_n=peak_n, contact_force_n=20, work_j=0.4, n_steps=22, n_newton=60, n_dof=800, cpu_s=0
    )


def fingerprint_world(labels: Iterable[Label]) -> World:
    """A quiet world in which the repeats of every (tool, object) can be told apart."""
    known = sorted(labels)
    for seed in count():
        world = World(seed=seed, scatter=Scatter(repeat_sd=REPEAT_SD))
        if _are_told_apart(world, known):
            return world
    raise AssertionError("unreachable")


def repeat_factor(world: World, tool_id: str, object_id: int, repeat: int) -> float:
    """Scatter of one grasp in the world, which multiplies its forces."""
    request = build_request(world, tool_id, BEST_PUBLISHED, object_id, GraspSetup())
    curve = grasp_curve(fingerprint(request), world, request, repeat)
    return curve.lift_force_at(PLATEAUS_MM[0][0]) / BASE_N


def _are_told_apart(world: World, labels: list[Label]) -> bool:
    factors: dict[tuple[str, int], list[float]] = {}
    for tool_id, object_id, repeat in labels:
        factors.setdefault((tool_id, object_id), []).append(repeat_factor(world, tool_id, object_id, repeat))
    pairs = (pair for of_one in factors.values() for pair in combinations(of_one, 2))
    return all(abs(a - b) > LEAST_DIFFERENCE * max(a, b) for a, b in pairs)


def slot_of(tool_id: str) -> int:
    """Slot of `<campaign>/B01T3`."""
    return int(tool_id[-1])


def _slot_n(slot: int) -> float:
    return SLOT_N * (slot + 1)


def _object_n(object_id: int) -> float:
    return OBJECT_N * (object_id + 5)
