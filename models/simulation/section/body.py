"""The section of a finger as an elastic body in plane strain: u_y = 0, everything constant over the width."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.simulation.body.assembly import Material, block_map, number_rows
from models.simulation.mesh.plane import PlaneMesh
from models.simulation.plane_width import section_lame_constants
from models.simulation.section.elasticity import add_force, add_stiffness, reference_gradients


@dataclass(frozen=True)
class _Elements:
    """The elements of one kind, ready for assembly (see `reference_gradients`, and `assembly.ElasticBody`)."""

    connectivity: np.ndarray
    slopes: np.ndarray
    volumes: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    places: np.ndarray


class PlaneBody:
    """What `models.simulation.body.assembly.ElasticBody` is for a solid, with 2 x 2 node blocks in (x, z)."""

    def __init__(
        self, mesh: PlaneMesh, nodes: np.ndarray, material: Material, factors: Sequence[np.ndarray] | None = None
    ) -> None:
        """`nodes` (n, 2): the undeformed mesh in the frame of the calculation.

        `material`: neo-Hookean. `factors`: per kind of element, their factors (m) on the modulus.
        """
        self.mesh = mesh
        strip = 2.0 * mesh.width_mm if mesh.is_half else mesh.width_mm, mesh.half_wave_mm
        lame = section_lame_constants(material.young_modulus_mpa, material.poisson_ratio, *strip)
        self._material = *lame, material.stiffening_per_mpa
        self.row_of_node, self.pattern = number_rows(len(nodes), mesh.base_nodes, mesh.connectivities)
        of_part = [None] * len(mesh.connectivities) if factors is None else factors
        self._parts = tuple(
            self._elements(part, nodes, factor) for part, factor in zip(mesh.connectivities, of_part, strict=True)
        )

    def _elements(self, connectivity: np.ndarray, nodes: np.ndarray, factor: np.ndarray | None) -> _Elements:
        slopes, volumes, values = reference_gradients(connectivity, nodes, self.mesh.width_mm)
        weights = volumes if factor is None else volumes * factor[:, None]
        places = block_map(connectivity, self.row_of_node, self.pattern)
        return _Elements(connectivity, slopes, volumes, weights, values, places)

    @property
    def n_dof(self) -> int:
        """Unknown displacements."""
        return 2 * self.pattern.n

    def force(self, x: np.ndarray) -> np.ndarray | None:
        """Internal nodal force (n, 2) in N at deformed nodes x (n, 2); None if an element is inverted."""
        force = np.zeros_like(x)
        for part in self._parts:
            if not add_force(x, part.connectivity, part.slopes, part.weights, *self._material, force):
                return None
        return force

    def stiffness(self, x: np.ndarray, blocks: np.ndarray) -> bool:
        """Overwrite `blocks` (z, 2, 2) with the tangent; False if an element is inverted."""
        blocks[:] = 0.0
        for part in self._parts:
            elements = part.connectivity, part.slopes, part.weights
            if not add_stiffness(x, *elements, *self._material, part.places, blocks):
                return False
        return True

    def lumped_volume(self) -> np.ndarray:
        """Volume of each node in mm3 (n): diagonal of the consistent mass, scaled per element (HRZ lumping)."""
        volume = np.zeros(len(self.mesh.nodes))
        for part in self._parts:
            diagonal = np.einsum("qa,mq->ma", part.values**2, part.volumes)
            diagonal *= (part.volumes.sum(axis=1) / diagonal.sum(axis=1))[:, None]
            np.add.at(volume, part.connectivity.ravel(), diagonal.ravel())
        return volume
