"""A volume mesh of one finger's compliant body, with the node and face sets that the solver needs."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np

from models.fem.shape import ElementKind

_KIND_OF_NODES: dict[int, ElementKind] = {10: "C3D10", 15: "C3D15"}


@dataclass(frozen=True)
class SolidMesh:
    """Quadratic solid mesh in the finger frame, mm.

    Attributes:
        nodes: n x 3. x = 0 front wall plane, growing away from the object; y width; z from the base to the apex.
        elements: m x 10 or m x 15, in Abaqus and CalculiX order (C3D10, C3D15).
        base_nodes: nodes on the clamped plane on top of the rigid base.
        symmetry_nodes: nodes on y = 0 of a half-width mesh; empty for the full width.
        contact_faces: f x 8 or f x 6, faces on the front wall and on the tip plane, corners then mid-sides.
    """

    nodes: np.ndarray
    elements: np.ndarray
    base_nodes: np.ndarray
    symmetry_nodes: np.ndarray
    contact_faces: np.ndarray

    @property
    def kind(self) -> ElementKind:
        """Abaqus name of the element type."""
        return _KIND_OF_NODES[self.elements.shape[1]]

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
        """Plain arrays by name, for caching."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Self:
        """Inverse of `to_arrays`."""
        return cls(**{field.name: np.asarray(arrays[field.name]) for field in fields(cls)})
