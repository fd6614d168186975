"""The outer surface and the middle section of a finger, to draw them from deformed nodes.

Half meshes are drawn whole: the other half is the mirror image in y = 0.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from fast.models.simulation.body.shape_functions import HEXAHEDRON_EDGES, TETRAHEDRON_EDGES, WEDGE_EDGES, ElementKind
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from fast.models.validation import check_type

PLANE_TOLERANCE_MM = 1e-6

# Corners of every face, counter-clockwise from outside.
_TETRAHEDRON = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
_FACES: dict[ElementKind, tuple[tuple[int, ...], ...]] = {
    "C3D4": _TETRAHEDRON,
    "C3D10": _TETRAHEDRON,
    "C3D15": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "C3D20R": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
_MIDDLES: dict[ElementKind, dict[frozenset[int], int]] = {
    "C3D4": {},
    "C3D10": {frozenset(pair): 4 + i for i, pair in enumerate(TETRAHEDRON_EDGES)},
    "C3D15": {frozenset(pair): 6 + i for i, pair in enumerate(WEDGE_EDGES)},
    "C3D20R": {frozenset(pair): 8 + i for i, pair in enumerate(HEXAHEDRON_EDGES)},
}
# Triangles over the nodes of a face in the order along its rim.
_TRIANGLES = {
    3: ((0, 1, 2),),
    6: ((5, 0, 1), (1, 2, 3), (3, 4, 5), (1, 3, 5)),
    8: ((7, 0, 1), (1, 2, 3), (3, 4, 5), (5, 6, 7), (1, 3, 5), (1, 5, 7)),
}


@dataclass(frozen=True)
class Skin:
    """Closed surface of a whole finger as triangles over copies of the mesh's nodes.

    `nodes` (v): mesh node of each vertex; `sign_y` (v): -1 for the mirrored half; `triangles` (t, 3), outward. The
    flanks have vertices of their own, so that the edges along them stay sharp when normals are averaged.
    """

    nodes: np.ndarray
    sign_y: np.ndarray
    triangles: np.ndarray

    def vertices(self, positions: np.ndarray) -> np.ndarray:
        """Return the surface points (v, 3) at deformed nodes (n, 3)."""
        vertices = positions[self.nodes]
        vertices[:, 1] *= self.sign_y
        return vertices


def skin_of(mesh: SolidMesh) -> Skin:
    """Return the outer surface of the finger, both halves of it.

    Faces belong to the surface when one element has them; the cut y = 0 of a half mesh does not count.

    Raises:
        UsageError: this is no mesh.
    """
    check_type(mesh, SolidMesh, "the mesh", "the `mesh` of a fast.GraspRecording")
    faces = _faces(mesh)
    times = Counter(_key(face) for face in faces)
    y = mesh.nodes[:, 1]
    outer = [face for face in faces if times[_key(face)] == 1 and not (mesh.is_half and _is_level(y[face], 0.0))]
    flank = float(np.abs(y).max())
    is_flank = np.array([_is_level(np.abs(y[face]), flank) for face in outer])
    triangles = [face[np.array(_TRIANGLES[len(face)])] for face in outer]
    corners = np.vstack(triangles).astype(np.int64)
    layer = np.repeat(is_flank.astype(np.int64), [len(part) for part in triangles])[:, None]
    keys, compact = np.unique(2 * corners + layer, return_inverse=True)
    nodes, indices = keys // 2, compact.reshape(-1, 3)
    if not mesh.is_half:
        return Skin(nodes, np.ones(len(nodes)), indices)
    other = indices[:, ::-1] + len(nodes)
    return Skin(np.tile(nodes, 2), np.repeat([1.0, -1.0], len(nodes)), np.vstack([indices, other]))


def section_of(mesh: SolidMesh) -> list[np.ndarray]:
    """Find the rims (k,) of element faces in the middle plane y = 0, in order; of the lower flank if none lie there."""
    y = mesh.nodes[:, 1]
    faces = {_key(face): face for face in _faces(mesh)}.values()
    for level in (0.0, float(y.min())):
        found = [face for face in faces if _is_level(y[face], level)]
        if found:
            return found
    return []


def section_outline(section: list[np.ndarray]) -> np.ndarray:
    """Return pieces (e, 2) of the section's outline, between consecutive nodes along its rims."""
    edges = [edge for face in section for edge in zip(face, np.roll(face, -1), strict=True)]
    times = Counter(frozenset(edge) for edge in edges)
    return np.array([edge for edge in edges if times[frozenset(edge)] == 1])


def _faces(mesh: SolidMesh) -> list[np.ndarray]:
    """List the rims of all faces of all elements, mid-side nodes between the corners."""
    return [face for block in mesh.blocks for rim in _rims(block) for face in block.connectivity[:, rim]]


def _rims(block: ElementBlock) -> list[np.ndarray]:
    """List the local nodes along the rim of each face of an element kind."""
    middles = _MIDDLES[block.kind]
    rims = []
    for corners in _FACES[block.kind]:
        rim: list[int] = []
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            rim += [a, middles[frozenset((a, b))]] if middles else [a]
        rims.append(np.array(rim))
    return rims


def _key(face: np.ndarray) -> tuple[int, ...]:
    return tuple(sorted(face.tolist()))


def _is_level(values: np.ndarray, level: float) -> bool:
    return bool((np.abs(values - level) < PLANE_TOLERANCE_MM).all())
