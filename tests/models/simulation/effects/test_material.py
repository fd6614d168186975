"""Material effects inside the elements: energies, tangents, and moduli by part."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.errors import UsageError
from fast.models.records import GraspSetup, Theta
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.elasticity import lame_constants
from fast.models.simulation.body.shape_functions import quadrature_of, shape_of
from fast.models.simulation.effects.material import HyperelasticStiffening, PrintAnisotropy
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.problem import FingerProblem
from fast.models.simulation.version import MeshSettings
from tests.models.simulation.dead_load import solve_dead_load
from tests.models.simulation.test_elements import add_one, reference_nodes, tangent_of

E_MPA, NU, BETA = 11.5, 0.45, 3.0
COARSE = MeshSettings(edge_mm=14.0)


def wedge() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, gradients and weights of one reference element."""
    rule = quadrature_of("C3D15", 3)
    return reference_nodes("C3D15"), shape_of("C3D15", rule.points)[1], rule.weights


def pull(stretch: float, per_mpa: float, lam: float, mu: float) -> float:
    """Force on the end of an element stretched along z alone, N."""
    nodes, slopes, weights = wedge()
    force = np.zeros((15, 3))
    assert add_one(nodes * [1, 1, stretch], slopes, weights, 0, lam, mu, per_mpa, force)
    return float(force[nodes[:, 2] > 0.5, 2].sum())


def test_stress_is_multiplied_by_one_plus_twice_beta_w_over_e() -> None:
    lam, mu = lame_constants(E_MPA, 0.3)
    per_mpa = Material(E_MPA, 0.3, stiffening=BETA).stiffening_per_mpa
    for stretch in (0.8, 1.1, 1.4):
        log = np.log(stretch)
        energy = 0.5 * mu * (stretch**2 - 1.0 - 2.0 * log) + 0.5 * lam * log**2
        ratio = pull(stretch, per_mpa, lam, mu) / pull(stretch, 0.0, lam, mu)
        assert ratio == pytest.approx(1.0 + 2.0 * BETA * energy / E_MPA, rel=1e-12)


def test_small_tension_stiffens_with_the_square_of_the_strain() -> None:
    strain = 1e-2
    lam, mu = lame_constants(E_MPA, 0.0)  # without lateral strain the element is in uniaxial tension
    linear, stiff = (pull(1.0 + strain, 2.0 * beta / E_MPA, lam, mu) for beta in (0.0, BETA))
    assert stiff / linear - 1.0 == pytest.approx(BETA * strain**2, rel=2 * strain)


def test_tangent_of_the_stiffening_solid_is_the_derivative_of_its_force() -> None:
    rng = np.random.default_rng(3)
    nodes, slopes, weights = wedge()
    x = nodes @ np.array([[0.9, 0.2, 0], [-0.2, 1.1, 0.1], [0, 0, 1.0]]) + 0.02 * rng.standard_normal(nodes.shape)
    lam, mu = lame_constants(E_MPA, NU)

    def force_of(at: np.ndarray) -> np.ndarray:
        force = np.zeros(at.shape)
        assert add_one(at, slopes, weights, 0, lam, mu, 0.5, force)
        return force

    tangent = tangent_of(x, slopes, weights, 0, lam, mu, 0.5)
    direction = rng.standard_normal(x.shape)
    difference = (force_of(x + 1e-6 * direction) - force_of(x - 1e-6 * direction)) / 2e-6
    assert np.allclose(tangent @ direction.ravel(), difference.ravel(), rtol=1e-6, atol=1e-5)


def test_only_the_neo_hookean_law_stiffens() -> None:
    with pytest.raises(UsageError, match="`st_venant_kirchhoff` cannot stiffen with strain; use `neo_hookean`"):
        Material(E_MPA, NU, "st_venant_kirchhoff", BETA)


def test_a_factor_on_all_elements_is_a_factor_on_the_modulus_and_moves_no_mass() -> None:
    mesh = build_mesh(BEST_PUBLISHED, COARSE)
    x = mesh.nodes * [1.02, 1.0, 0.99]
    stiff = ElasticBody(mesh, mesh.nodes, Material(1.25 * E_MPA, NU))
    scaled = ElasticBody(
        mesh, mesh.nodes, Material(E_MPA, NU), factors=[np.full(len(c), 1.25) for c in mesh.connectivities]
    )
    expected, force = stiff.force(x), scaled.force(x)
    assert expected is not None
    assert force is not None
    assert np.allclose(force, expected, rtol=1e-12)
    assert np.array_equal(stiff.lumped_volume(), scaled.lumped_volume())


def test_anisotropy_acts_on_the_ribs_alone() -> None:
    for design in [BEST_PUBLISHED, *random_designs(4, np.random.default_rng(2))]:
        mesh = build_mesh(design, MeshSettings())
        problem = FingerProblem(mesh, design, Theta(), GraspSetup(), (PrintAnisotropy(0.3),))
        factors = problem.factors()
        assert factors is not None
        middles = np.vstack([mesh.nodes[c][:, :, [0, 2]].mean(axis=1) for c in mesh.connectivities])
        factor = np.concatenate(factors)
        assert set(factor) == {1.0, 1.3}
        in_front = middles[:, 0] < design.front_thickness_mm
        in_tip = middles[:, 1] > design.height_mm - design.tip_length_mm
        assert (factor[in_front | in_tip] == 1.0).all()
        assert 0.1 < (factor == 1.3).mean() < 0.8
        neutral = FingerProblem(mesh, design, Theta(), GraspSetup(), (PrintAnisotropy(0.0),))
        assert neutral.factors() is None


def test_a_stiffening_finger_bends_less() -> None:
    mesh = build_mesh(BEST_PUBLISHED, COARSE)
    load = np.zeros_like(mesh.nodes)
    tip = np.flatnonzero(mesh.nodes[:, 2] > BEST_PUBLISHED.height_mm - 1e-6)
    load[tip, 0] = 3.0 / len(tip)
    linear, stiff = (
        np.abs(solve_dead_load(ElasticBody(mesh, mesh.nodes, Material(E_MPA, NU, stiffening=beta)), mesh.nodes, load))
        for beta in (0.0, HyperelasticStiffening(5.0).strain_stiffening())
    )
    assert 0.9 < stiff.max() / linear.max() < 0.999
