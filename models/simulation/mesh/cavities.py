"""Faces of the voids between ribs and walls, found in an extruded mesh by what its elements leave open."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from fast.models.simulation.body.shape_functions import ElementKind
from fast.models.simulation.mesh.solid import SolidMesh

# Local nodes of the sides along the width: corners a, b, b', a', then the middles of ab, bb', a'b', aa'.
_SIDES: dict[ElementKind, list[list[int]]] = {
    "C3D15": [[0, 1, 4, 3, 6, 13, 9, 12], [1, 2, 5, 4, 7, 14, 10, 13], [2, 0, 3, 5, 8, 12, 11, 14]],
    "C3D20R": [
        [0, 1, 5, 4, 8, 17, 12, 16],
        [1, 2, 6, 5, 9, 18, 13, 17],
        [2, 3, 7, 6, 10, 19, 14, 18],
        [3, 0, 4, 7, 11, 16, 15, 19],
    ],
}
_UPRIGHT = [5, 7]  # middles of the two edges across the section: each belongs to one layer and two faces in a row


def cavity_faces(mesh: SolidMesh) -> tuple[np.ndarray, np.ndarray]:
    """Find the faces (f, 8) that look into a cavity, and the number (f) of the cavity and layer that each belongs to.

    Seen from inside the cavity the corners of a face turn as those of its element do: a, b, b', a'. A mesh of
    tetrahedra has no layers; its faces are left out.
    """
    sides = [
        block.connectivity[:, np.array(_SIDES[block.kind])].reshape(-1, 8)
        for block in mesh.blocks
        if block.kind in _SIDES
    ]
    faces = _open_faces(np.vstack([np.zeros((0, 8), dtype=np.int32), *sides]))
    faces = faces[~np.isin(faces, mesh.base_nodes).all(axis=1)]
    if not len(faces):
        return faces, np.zeros(0, dtype=int)
    row = _rows_of_faces(faces, len(mesh.nodes))
    outside = row[np.isin(faces[:, _UPRIGHT], mesh.contact_faces).all(axis=1)]
    inner = ~np.isin(row, outside)
    return faces[inner], np.unique(row[inner], return_inverse=True)[1]


def _open_faces(faces: np.ndarray) -> np.ndarray:
    """Return the faces that belong to one element only."""
    _, first, count = np.unique(np.sort(faces[:, :4], axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


def _rows_of_faces(faces: np.ndarray, n_nodes: int) -> np.ndarray:
    """Number (f) of the row of faces, edge to edge within a layer, that each face belongs to."""
    a, b = faces[:, _UPRIGHT].T
    links = sp.coo_matrix((np.ones(len(faces)), (a, b)), shape=(n_nodes, n_nodes))
    return np.asarray(connected_components(links, directed=False)[1])[a]
