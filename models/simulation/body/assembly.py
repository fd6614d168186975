"""Elastic force and tangent of a whole mesh, assembled into the blocks of a fixed sparse pattern."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numba as nb
import numpy as np

from fast.models.errors import MeshingFailed, UsageError
from fast.models.simulation.body.elasticity import (
    LAW_CODE,
    VECTOR,
    Constants,
    Elements,
    MaterialLaw,
    add_forces,
    add_tangents,
    lame_constants,
)
from fast.models.simulation.body.shape_functions import quadrature_of, shape_of
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from fast.models.simulation.solver.cholesky import BlockPattern, block_pattern

CLAMPED = -1


@dataclass(frozen=True)
class Material:
    """Elastic law of the compliant body.

    `stiffening`: beta of the strain energy W + beta W^2 / E, for the neo-Hookean law.
    """

    young_modulus_mpa: float
    poisson_ratio: float
    law: MaterialLaw = "neo_hookean"
    stiffening: float = 0.0

    def __post_init__(self) -> None:
        """Check that the law can stiffen."""
        if self.stiffening != 0.0 and self.law != "neo_hookean":
            raise UsageError(f"The material law `{self.law}` cannot stiffen with strain; use `neo_hookean`.")

    @property
    def stiffening_per_mpa(self) -> float:
        """C = 2 beta / E of `models.simulation.body.elasticity`, in 1/MPa."""
        return 2.0 * self.stiffening / self.young_modulus_mpa


class Elastic(NamedTuple):
    """What compiled code reads of a body: always two blocks, of which one may be empty, and the law's constants."""

    first: Elements
    second: Elements
    constants: Constants


_NO_ELEMENTS = Elements(
    np.zeros((0, 1), dtype=np.int32),
    np.zeros((1, 3, VECTOR)),
    *(np.zeros((1, 9, 0)), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((1, 1))),
    np.zeros((0, 1, 1), dtype=np.int32),
)


class SymmetryBlocks(NamedTuple):
    """Numbers of the blocks in the `rows` of nodes on the symmetry plane, in their `columns`, and in both."""

    rows: np.ndarray
    columns: np.ndarray
    diagonal: np.ndarray


class ElasticBody:
    """A meshed elastic body: its internal force, its tangent, and its lumped volumes.

    Blocks refer to `pattern`; `row_of_node` (n) is a node's block row, `CLAMPED` for base nodes. Block maps hold
    the place z of a block in the pattern, -2 - z for its transpose, and -1 for a clamped node.
    """

    def __init__(
        self,
        mesh: SolidMesh,
        nodes: np.ndarray,
        material: Material,
        n_axial_points: int = 3,
        factors: Sequence[np.ndarray] | None = None,
    ) -> None:
        """Take `nodes` (n, 3): the undeformed mesh in the frame of the calculation (the finger frame, rotated).

        `n_axial_points`: see `models.simulation.body.shape_functions.quadrature_of`. `factors`: per block of the mesh,
        factors (m) of its elements on the modulus.
        """
        self.mesh, self._n_axial_points = mesh, n_axial_points
        self._material = _constants(material)
        connectivities = [block.connectivity for block in mesh.blocks]
        self.row_of_node, self.pattern = number_rows(len(nodes), mesh.base_nodes, connectivities)
        of_block = [None] * len(mesh.blocks) if factors is None else factors
        self._parts = [
            self._prepared(block, nodes, factor) for block, factor in zip(mesh.blocks, of_block, strict=True)
        ]
        self.symmetry = _symmetry_blocks(mesh, self.row_of_node, self.pattern)

    def _prepared(self, block: ElementBlock, nodes: np.ndarray, factor: np.ndarray | None) -> Elements:
        gradients, inverses, volumes, values = _reference_gradients(block, nodes, self._n_axial_points)
        weights = volumes if factor is None else volumes * factor
        connectivity = np.ascontiguousarray(block.connectivity, dtype=np.int32)
        places = block_map(connectivity, self.row_of_node, self.pattern)
        return Elements(connectivity, gradients, inverses, volumes, weights, values, places)

    def coupled(self, groups: np.ndarray) -> Self:
        """Return the same body; its tangent also has room for blocks between all nodes of each group (p, k)."""
        other = copy.copy(self)
        connectivities = [part.connectivity for part in self._parts]
        rows, pattern = number_rows(len(self.row_of_node), self.mesh.base_nodes, [*connectivities, groups])
        other.row_of_node, other.pattern = rows, pattern
        parts = [part._replace(places=block_map(part.connectivity, rows, pattern)) for part in self._parts]
        other._parts, other.symmetry = parts, _symmetry_blocks(self.mesh, rows, pattern)  # noqa: SLF001 - a copy of this object
        return other

    def moved(self, nodes: np.ndarray, material: Material, factors: Sequence[np.ndarray] | None) -> Self:
        """Return the same elements with undeformed nodes (n, 3), material and factors of their own; pattern shared."""
        other = copy.copy(self)
        of_block = [None] * len(self._parts) if factors is None else factors
        parts = []
        for block, part, factor in zip(self.mesh.blocks, self._parts, of_block, strict=True):
            _, inverses, volumes, _ = _reference_gradients(block, nodes, self._n_axial_points)
            weights = volumes if factor is None else volumes * factor
            parts.append(part._replace(inverses=inverses, volumes=volumes, weights=weights))
        other._parts, other._material = parts, _constants(material)  # noqa: SLF001 - a copy of this object
        return other

    def numbered_as(self, body: Self) -> Self:
        """Return the same body, its unknowns in the order of one that differs only in the pattern of its tangent."""
        other = copy.copy(self)
        other.row_of_node, other.pattern = body.row_of_node, body.pattern
        parts = [part._replace(places=numbered.places) for part, numbered in zip(self._parts, body._parts, strict=True)]
        other._parts, other.symmetry = parts, body.symmetry  # noqa: SLF001 - a copy of this object
        return other

    @property
    def n_dof(self) -> int:
        """Unknown displacements."""
        return 3 * self.pattern.n - len(self.symmetry.diagonal)

    @property
    def compiled(self) -> Elastic:
        """What compiled code reads."""
        first, *others = self._parts
        return Elastic(first, others[0] if others else _NO_ELEMENTS, self._material)

    def force(self, x: np.ndarray) -> np.ndarray | None:
        """Compute the internal nodal force (n, 3) at deformed nodes x (n, 3); None if an element is inverted."""
        force = np.zeros(x.shape)
        return force if add_elastic_forces(self.compiled, x, force) else None

    def stiffness(self, x: np.ndarray, blocks: np.ndarray) -> bool:
        """Overwrite `blocks` (z, 3, 3) with the tangent at x (symmetry not yet applied); False if one is inverted."""
        blocks[:] = 0.0
        return bool(add_stiffness(self.compiled, x, blocks))

    def lumped_volume(self) -> np.ndarray:
        """Return each node's volume in mm3 (n): the consistent mass's diagonal, scaled per element (HRZ lumping)."""
        volume = np.zeros(len(self.mesh.nodes))
        for part in self._parts:
            diagonal = np.einsum("qa,qm->ma", part.values**2, part.volumes)
            diagonal *= (part.volumes.sum(axis=0) / diagonal.sum(axis=1))[:, None]
            np.add.at(volume, part.connectivity.ravel(), diagonal.ravel())
        return volume


def _constants(material: Material) -> Constants:
    """Return what the kernels take of a material."""
    lame = lame_constants(material.young_modulus_mpa, material.poisson_ratio)
    return Constants(LAW_CODE[material.law], *lame, float(material.stiffening_per_mpa))


def block_map(connectivity: np.ndarray, row_of_node: np.ndarray, pattern: BlockPattern) -> np.ndarray:
    """Return places (m, k, k) of the blocks between the nodes of each element or face, in the code of `ElasticBody`."""
    rows = row_of_node[connectivity].astype(np.int64)
    first, second = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
    low, high = np.minimum(first, second), np.maximum(first, second)
    columns = np.repeat(np.arange(pattern.n, dtype=np.int64), np.diff(pattern.indptr))
    keys = columns * pattern.n + pattern.indices
    places = np.searchsorted(keys, (low * pattern.n + high).ravel()).reshape(low.shape)
    places = np.where(first >= second, places, -2 - places)
    return np.where(low < 0, -1, places).astype(np.int32)


def _reference_gradients(
    block: ElementBlock, nodes: np.ndarray, n_axial_points: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute gradients (q, 3, k'), inverses (q, 9, m), volumes (q, m) and values (q, k) of `_Elements`."""
    rule = quadrature_of(block.kind, n_axial_points)
    values, gradients = shape_of(block.kind, rule.points)
    jacobian = np.einsum("mai,qaj->mqij", nodes[block.connectivity], gradients)
    determinant = np.linalg.det(jacobian)
    if not determinant.min() > 0.0:
        raise MeshingFailed(
            f"{int((determinant.min(axis=1) <= 0).sum())} of {len(determinant)} elements are inverted before any "
            "load; change the mesh settings.",
            reason="inverted_element",
        )
    n_points, k = values.shape
    padded = np.zeros((n_points, 3, -(-k // VECTOR) * VECTOR))
    padded[:, :, :k] = gradients.transpose(0, 2, 1)
    inverses = np.linalg.inv(jacobian).reshape(-1, n_points, 9).transpose(1, 2, 0)
    volumes = (determinant * rule.weights).T
    return padded, np.ascontiguousarray(inverses), np.ascontiguousarray(volumes), values


def number_rows(
    n_nodes: int, base_nodes: np.ndarray, connectivities: Sequence[np.ndarray]
) -> tuple[np.ndarray, BlockPattern]:
    """Block row of each node (n), `CLAMPED` for base nodes, and the pattern of the tangent of elements (m, k)."""
    free = np.ones(n_nodes, dtype=bool)
    free[base_nodes] = False
    compact = np.where(free, np.cumsum(free) - 1, CLAMPED)
    pairs = np.vstack([_node_pairs(compact[part]) for part in connectivities])
    pattern = block_pattern(int(free.sum()), pairs[(pairs >= 0).all(axis=1)])
    return np.where(free, pattern.position[compact], CLAMPED).astype(np.int32), pattern


def _node_pairs(local: np.ndarray) -> np.ndarray:
    """List all pairs (m k^2, 2) of nodes that share an element (m, k)."""
    first, second = np.broadcast_arrays(local[:, :, None], local[:, None, :])
    return np.column_stack([first.ravel(), second.ravel()])


def _symmetry_blocks(mesh: SolidMesh, row_of_node: np.ndarray, pattern: BlockPattern) -> SymmetryBlocks:
    rows = row_of_node[mesh.symmetry_nodes]
    constrained = np.zeros(pattern.n, dtype=bool)
    constrained[rows[rows >= 0]] = True
    columns = np.repeat(np.arange(pattern.n), np.diff(pattern.indptr))
    by_row, by_column = constrained[pattern.indices], constrained[columns]
    diagonal = by_row & (pattern.indices == columns)
    return SymmetryBlocks(np.flatnonzero(by_row), np.flatnonzero(by_column), np.flatnonzero(diagonal))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_elastic_forces(elastic: Elastic, x: np.ndarray, force: np.ndarray) -> bool:
    """Add the internal nodal forces (n, 3) at deformed nodes x (n, 3); False if an element is inverted."""
    for part in (elastic.first, elastic.second):
        if not add_forces(x, part, elastic.constants, force):
            return False
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_stiffness(elastic: Elastic, x: np.ndarray, blocks: np.ndarray) -> bool:
    """Add the tangent at deformed nodes x (n, 3); False if an element is inverted."""
    for part in (elastic.first, elastic.second):
        if not add_tangents(x, part, elastic.constants, blocks):
            return False
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def decouple_y(symmetry: SymmetryBlocks, blocks: np.ndarray) -> None:
    """Clear what couples the y displacement of the nodes on the symmetry plane, and put a 1 on its diagonal."""
    for z in symmetry.rows:
        blocks[z, 1, :] = 0.0
    for z in symmetry.columns:
        blocks[z, :, 1] = 0.0
    for z in symmetry.diagonal:
        blocks[z, 1, 1] = 1.0
