"""The section of a finger as an elastic body in plane strain: u_y = 0, everything constant over the width."""

from dataclasses import dataclass

import numpy as np

from models.fem.assembly import block_map, number_rows
from models.fem.plane_elasticity import add_force, add_stiffness, reference_gradients
from models.fem.plane_width import section_lame_constants
from models.mesh.plane import PlaneMesh


@dataclass(frozen=True)
class _Elements:
    """The elements of one kind, ready for assembly (see `reference_gradients`)."""

    connectivity: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    places: np.ndarray


class PlaneBody:
    """What `models.fem.assembly.ElasticBody` is for a solid, with 2 x 2 node blocks in (x, z)."""

    def __init__(self, mesh: PlaneMesh, nodes: np.ndarray, young_modulus_mpa: float, poisson_ratio: float) -> None:
        """`nodes` (n, 2): the undeformed mesh in the frame of the calculation."""
        self.mesh = mesh
        strip = 2.0 * mesh.width_mm if mesh.is_half else mesh.width_mm, mesh.half_wave_mm
        self._lam, self._mu = section_lame_constants(young_modulus_mpa, poisson_ratio, *strip)
        self.row_of_node, self.pattern = number_rows(len(nodes), mesh.base_nodes, mesh.connectivities)
        self._parts = tuple(self._elements(part, nodes) for part in mesh.connectivities)

    def _elements(self, connectivity: np.ndarray, nodes: np.ndarray) -> _Elements:
        gradients = reference_gradients(connectivity, nodes, self.mesh.width_mm)
        return _Elements(connectivity, *gradients, block_map(connectivity, self.row_of_node, self.pattern))

    @property
    def n_dof(self) -> int:
        """Unknown displacements."""
        return 2 * self.pattern.n

    def force(self, x: np.ndarray) -> np.ndarray | None:
        """Internal nodal force (n, 2) in N at deformed nodes x (n, 2); None if an element is inverted."""
        force = np.zeros_like(x)
        for part in self._parts:
            if not add_force(x, part.connectivity, part.slopes, part.weights, self._lam, self._mu, force):
                return None
        return force

    def stiffness(self, x: np.ndarray, blocks: np.ndarray) -> bool:
        """Overwrite `blocks` (z, 2, 2) with the tangent; False if an element is inverted."""
        blocks[:] = 0.0
        for part in self._parts:
            elements = part.connectivity, part.slopes, part.weights
            if not add_stiffness(x, *elements, self._lam, self._mu, part.places, blocks):
                return False
        return True

    def lumped_volume(self) -> np.ndarray:
        """Volume of each node in mm3 (n): diagonal of the consistent mass, scaled per element (HRZ lumping)."""
        volume = np.zeros(len(self.mesh.nodes))
        for part in self._parts:
            diagonal = np.einsum("qa,mq->ma", part.values**2, part.weights)
            diagonal *= (part.weights.sum(axis=1) / diagonal.sum(axis=1))[:, None]
            np.add.at(volume, part.connectivity.ravel(), diagonal.ravel())
        return volume
