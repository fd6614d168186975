"""The solver against CalculiX 2.20: dead loads to 1e-5, frictionless contact to 1 %."""

from pathlib import Path

import numpy as np
import pytest

from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.contact.law import NO_STOP, ContactLaw, ContactSurface, PointSpacing
from fast.models.simulation.finger import FingerStep
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from fast.models.simulation.solver.newton import NewtonSettings, NewtonSolver, make_workspace
from fast.models.simulation.solver.stepping import Path as BasePath
from fast.models.simulation.solver.stepping import StepLimits, Stepper
from tests.models.simulation.dead_load import solve_dead_load
from tests.models.simulation.obstacles import make_rod

CALCULIX = np.load(Path(__file__).parents[2] / "data" / "fem" / "calculix.npz")
PUSH = np.array([-1.0, 0.0, 0.0])


def reference_body(mesh: str) -> tuple[ElasticBody, np.ndarray]:
    nodes = CALCULIX[f"{mesh}_nodes"]
    solid = SolidMesh(
        nodes,
        (ElementBlock("C3D10" if mesh.startswith("t10") else "C3D15", CALCULIX[f"{mesh}_elements"]),),
        CALCULIX[f"{mesh}_base"],
        CALCULIX[f"{mesh}_symmetry"],
        CALCULIX[f"{mesh}_faces"],
    )
    return ElasticBody(solid, nodes, Material(11.5, 0.45, "st_venant_kirchhoff"), n_axial_points=3), nodes


@pytest.mark.parametrize(
    ("mesh", "case"), [("t10", "t10_tip12N"), ("w15half", "w15half_tip"), ("w15half", "w15half_mid")]
)
def test_dead_load_agrees_with_calculix(mesh: str, case: str) -> None:
    body, nodes = reference_body(mesh)
    load = np.zeros_like(nodes)
    loaded = CALCULIX[f"{case}_loaded"]
    load[loaded] = CALCULIX[f"{case}_force"] / len(loaded)
    expected = CALCULIX[f"{case}_u"]
    displacement = solve_dead_load(body, nodes, load)
    assert np.abs(displacement - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("mesh", ["w15half", "t10c"])
def test_frictionless_cylinder_agrees_with_calculix(mesh: str) -> None:
    body, nodes = reference_body(mesh)
    surface = ContactSurface(body, nodes, ContactLaw(20.0, 20.0, 1e-3), PointSpacing(0.5, 3.0))
    finger = FingerStep(body, surface, nodes, make_rod(-25.5, -45.0, 25.0), stop_mm=NO_STOP)
    newton = NewtonSolver(make_workspace(body.pattern), NewtonSettings(tolerance_n=1e-4))
    stepper = Stepper(finger, newton, StepLimits(), lambda _: np.zeros(len(surface.areas)))
    state, reached = finger.undeformed(np.zeros(3), np.zeros(3)), 0.0
    share = 1.0 if body.mesh.is_half else 2.0
    for fraction, f_x, _, f_z in CALCULIX[f"{mesh}_cylinder_ccx"]:
        push = BasePath(state.base, PUSH, 8.5 * (fraction - reached), 0.5, lambda _: 1.0)
        *_, last = stepper.walk(state, push)
        state, reached = last.state, fraction
        assert last.clamp_n[0] == pytest.approx(f_x, rel=0.01)
        assert last.clamp_n[2] == pytest.approx(f_z, abs=0.06 * share)
    sampled = CALCULIX[f"{mesh}_cylinder_nodes"]
    error = (state.x - nodes)[sampled] - CALCULIX[f"{mesh}_cylinder_u"]
    assert np.abs(error).max() < 0.003 * 8.5
