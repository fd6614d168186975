"""Cantilever under a dead end load: the elastica, and the same beam in solid elements.

Inextensible Euler-Bernoulli beam, E I theta'' + F cos(theta) = 0 with theta(0) = 0 and theta'(L) = 0, theta the
slope of the beam and F the load across the undeformed beam (Bisshopp and Drucker 1945). The solid is one element
wide with u_y = 0 and nu = 0, so that plane strain adds nothing to E I. What the beam leaves out is of the order
(h / L)^2 in shear and of the outer fibre strain squared in the material law, both below 1e-3 here.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp

from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.shape_functions import ElementKind
from tests.models.simulation.verification.bricks import brick, equilibrium, everything

LENGTH_MM, HEIGHT_MM, WIDTH_MM = 100.0, 1.0, 2.0
MODULUS_MPA = 11.5


@dataclass(frozen=True)
class Tip:
    """Tip of the beam in parts of its length: `drop` across, `shortening` along."""

    drop: float
    shortening: float


def elastica_shape(load: float) -> np.ndarray:
    """Centre line (2, n) along and across, in parts of the length, for the load F L^2 / (E I)."""

    def slope(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        theta, curvature = y[:2]
        return np.vstack([curvature, -load * np.cos(theta), np.cos(theta), np.sin(theta)])

    def ends(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        return np.array([start[0], end[1], start[2], start[3]])

    s = np.linspace(0.0, 1.0, 101)
    guess = np.vstack([s, 1.0 - s, s, 0.5 * s**2])
    return np.asarray(solve_bvp(slope, ends, s, guess, tol=1e-8).y[2:])


def elastica_tip(load: float) -> Tip:
    """Tip of the elastica for the load F L^2 / (E I)."""
    along, across = elastica_shape(load)[:, -1]
    return Tip(float(across), float(1.0 - along))


def solid_shapes(kind: ElementKind, loads: list[float], n_elements: int = 25) -> list[np.ndarray]:
    """Deformed centre lines (2, n) along and across, in parts of the length, at rising loads F L^2 / (E I)."""
    grid = (np.linspace(0, LENGTH_MM, n_elements + 1), np.array([0, WIDTH_MM]), np.array([0, HEIGHT_MM]))
    mesh = brick(kind, grid, base=lambda p: p[:, 0] == 0.0, symmetry=everything)
    body = ElasticBody(mesh, mesh.nodes, Material(MODULUS_MPA, 0.0))
    stiffness = MODULUS_MPA * WIDTH_MM * HEIGHT_MM**3 / 12.0
    end = np.flatnonzero(mesh.nodes[:, 0] == LENGTH_MM)
    lower, upper = (_edge(mesh.nodes, z) for z in (0.0, HEIGHT_MM))
    x, shapes = mesh.nodes, []
    for load in np.concatenate([np.linspace(a, b, 6)[1:] for a, b in zip([0.0, *loads], loads, strict=False)]):
        force = np.zeros_like(x)
        force[end, 2] = load * stiffness / LENGTH_MM**2 / len(end)
        x = equilibrium(body, x, force)
        if load in loads:
            centre = 0.5 * (x[lower] + x[upper])[:, [0, 2]] - [0.0, 0.5 * HEIGHT_MM]
            shapes.append(centre.T / LENGTH_MM)
    return shapes


def _edge(nodes: np.ndarray, z: float) -> np.ndarray:
    """Nodes along the beam on y = 0 at a height, in order."""
    found = np.flatnonzero((nodes[:, 1] == 0.0) & (nodes[:, 2] == z))
    return found[np.argsort(nodes[found, 0])]
