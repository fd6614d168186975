"""A volume mesh of one finger's compliant body, with the node and face sets that the solver needs."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from fast.models.simulation.body.shape_functions import N_NODES, ElementKind

_NODE_SETS = ("base_nodes", "symmetry_nodes", "contact_faces")


@dataclass(frozen=True)
class ElementBlock:
    """All elements of one kind: `connectivity` (m, k) int32 node numbers, in the order of Abaqus and CalculiX."""

    kind: ElementKind
    connectivity: np.ndarray

    def __post_init__(self) -> None:
        """Check the number of nodes per element."""
        if self.connectivity.ndim != 2 or self.connectivity.shape[1] != N_NODES[self.kind]:
            raise ValueError(f"{self.kind} has {N_NODES[self.kind]} nodes, not a table {self.connectivity.shape}")


@dataclass(frozen=True)
class SolidMesh:
    """Solid mesh of one body in the finger frame, mm, of one or several kinds of elements.

    Attributes:
        nodes: n x 3. x = 0 front wall plane, growing away from the object; y width; z from the base to the apex.
        blocks: the elements, at most one block per kind, in the order of `ElementKind`.
        base_nodes: nodes on the clamped plane on top of the rigid base.
        symmetry_nodes: nodes on y = 0 of a half-width mesh; empty for the full width.
        contact_faces: f x 8, f x 6 or f x 3, faces on the front wall and on the tip plane, corners then mid-sides.
    """

    nodes: np.ndarray
    blocks: tuple[ElementBlock, ...]
    base_nodes: np.ndarray
    symmetry_nodes: np.ndarray
    contact_faces: np.ndarray

    def __post_init__(self) -> None:
        """Check the order of the blocks, which the content id depends on."""
        kinds = [block.kind for block in self.blocks]
        if kinds != [kind for kind in N_NODES if kind in kinds]:
            raise ValueError(f"element blocks {kinds} are not one per kind in the order {list(N_NODES)}")

    @property
    def n_elements(self) -> int:
        """Number of elements of all kinds."""
        return sum(len(block.connectivity) for block in self.blocks)

    @property
    def connectivities(self) -> tuple[np.ndarray, ...]:
        """The elements (m, k) of every block."""
        return tuple(block.connectivity for block in self.blocks)

    @property
    def is_half(self) -> bool:
        """True when the mesh is one half of the finger, cut at y = 0."""
        return self.symmetry_nodes.size > 0

    @cached_property
    def mesh_id(self) -> str:
        """Id derived from the content."""
        digest = hashlib.sha256()
        for array in self.to_arrays().values():
            digest.update(str(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return "M" + digest.hexdigest()[:12]

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return plain arrays by name, for caching; the elements go by the name of their kind."""
        elements = {str(block.kind): block.connectivity for block in self.blocks}
        return {"nodes": self.nodes, **elements, **{name: getattr(self, name) for name in _NODE_SETS}}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Self:
        """Invert `to_arrays`."""
        blocks = tuple(ElementBlock(kind, np.asarray(arrays[kind])) for kind in N_NODES if kind in arrays)
        return cls(np.asarray(arrays["nodes"]), blocks, *(np.asarray(arrays[name]) for name in _NODE_SETS))
