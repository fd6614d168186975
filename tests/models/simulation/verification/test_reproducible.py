"""The same grasp gives the same bits whatever ran before it, and in any process."""

import subprocess
import sys

import numpy as np

from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspSetup
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.version import MeshSettings, SimulatorVersion

CASES = [("best", 1), ("best", 24), ("random", 24)]
COARSE = SimulatorVersion(mesh=MeshSettings(edge_mm=12))  # every mesh walks through the same code


def design_named(name: str) -> Design:
    return BEST_PUBLISHED if name == "best" else random_designs(1, np.random.default_rng(4))[0]


def fingerprint(design: str, object_id: int) -> str:
    result = simulate_grasp(design_named(design), get_object(object_id), COARSE, GraspSetup(max_lift_mm=10))
    return np.concatenate([result.trace.time_s, result.trace.force_n, [result.contact_force_n]]).tobytes().hex()


def test_results_do_not_depend_on_order_or_process() -> None:
    forwards = {case: fingerprint(*case) for case in CASES}
    backwards = {case: fingerprint(*case) for case in reversed(CASES)}
    assert forwards == backwards
    code = f"from {__name__} import fingerprint; print(fingerprint{CASES[-1]})"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == forwards[CASES[-1]]
