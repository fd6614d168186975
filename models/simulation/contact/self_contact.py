"""Self-contact of a finger: the faces of a cavity, ribs and walls, touch each other and do not pass through.

Between the ribs and walls around a cavity nothing else can touch, so only faces of the same cavity are compared. The
section is swept over the width, so faces meet in slices at constant place across it: there a face is a line, and the
contact acts in the plane of the section. A cavity is convex as printed and its corners are round: two faces that meet
in a corner are apart everywhere else. Only the short face of a fillet and its neighbours are no pair. The law is the
penalty of contact with the object, without friction.
"""

import copy
from typing import Self

import numpy as np

from fast.models.simulation.body.assembly import ElasticBody, block_map
from fast.models.simulation.body.shape_functions import face_shape
from fast.models.simulation.contact import self_kernel
from fast.models.simulation.contact.law import ContactLaw
from fast.models.simulation.contact.self_kernel import Cavities, Lines, Strips

SEGMENT_MM = 1.0  # an edge of 8 mm bent to a radius of 20 mm is at most 0.006 mm from its segments
COUPLED_MM = 2.0  # faces nearer than this may come to press on each other within a few steps
_ACROSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)  # slices of a layer: Gauss points, each for half of its width


class SelfContact:
    """The faces of a finger's cavities: how deep they are in each other, and with which force they press.

    The force acts between any two faces; the tangent only between faces that `coupled` has made a pair.
    """

    def __init__(self, faces: np.ndarray, row: np.ndarray, nodes: np.ndarray, law: ContactLaw) -> None:
        """Take `faces` (f, 8) and their numbers `row` (f): see `models.simulation.mesh.cavities.cavity_faces`.

        `nodes` (n, 3): undeformed mesh, in the frame of the calculation.
        """
        self._law = law.compiled
        self._strips = _strips(_turned(faces, nodes), row, nodes)
        self._pair = np.full((len(faces), len(faces)), -1, dtype=np.int32)
        self._places = np.zeros((0, 16, 16), dtype=np.int32)
        self._lines = _lines(len(self._strips.areas), len(self._strips.face))

    @classmethod
    def of_nothing(cls, nodes: np.ndarray, law: ContactLaw) -> Self:
        """Make one without faces: a body that cannot touch itself."""
        return cls(np.zeros((0, 8), dtype=np.int32), np.zeros(0, dtype=int), nodes, law)

    @property
    def compiled(self) -> Cavities:
        """What compiled code reads."""
        return Cavities(self._strips, self._law, self._lines, self._pair, self._places)

    def depth_mm(self, x: np.ndarray) -> float:
        """Return how deep the faces are in each other at most at deformed nodes x (n, 3); 0 where none touch."""
        return float(self_kernel.measure(self._strips, x, self._lines))

    def presses_uncoupled(self, x: np.ndarray) -> bool:
        """Return whether at deformed nodes x (n, 3) faces are in each other that are no pair."""
        return self.depth_mm(x) > 0.0 and bool(self_kernel.presses_uncoupled(self._strips, self._lines, self._pair))

    def pairs_near(self, x: np.ndarray) -> np.ndarray:
        """List the pairs so far and all others near at deformed nodes x: faces (p, 2), the lower one first."""
        pair = self._pair.copy()
        self.depth_mm(x)
        self_kernel.mark_pairs(self._strips, self._lines, COUPLED_MM, pair)
        return np.argwhere(pair >= 0)

    def nodes_of(self, pairs: np.ndarray) -> np.ndarray:
        """Return the nodes (p, 16) of pairs of faces (p, 2)."""
        return self._strips.faces[pairs].reshape(-1, 16)

    def coupled(self, pairs: np.ndarray, body: ElasticBody) -> Self:
        """Return the same faces with these pairs (p, 2), for which the pattern of the body has room."""
        other = copy.copy(self)
        pair = np.full_like(self._pair, -1)
        pair[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
        places = block_map(self.nodes_of(pairs), body.row_of_node, body.pattern)
        other._pair, other._places = pair, places  # noqa: SLF001 - a copy of this object
        return other

    def add_force(self, x: np.ndarray, force: np.ndarray) -> None:
        """Add the contact force at deformed nodes x to `force` (n, 3) in N."""
        self_kernel.add_forces(self.compiled, x, force)

    def add_tangent(self, x: np.ndarray, blocks: np.ndarray) -> None:
        """Add minus the derivative of the force between pairs at x to `blocks` (z, 3, 3)."""
        self_kernel.add_tangent(self.compiled, x, blocks)


def _turned(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Turn the corners of faces (f, 8) the other way round where they grow towards -y."""
    falls = nodes[faces[:, 3], 1] < nodes[faces[:, 0], 1]
    return np.where(falls[:, None], faces[:, [1, 0, 3, 2, 4, 7, 6, 5]], faces)


def _strips(faces: np.ndarray, row: np.ndarray, nodes: np.ndarray) -> Strips:
    """Make the strips of faces (f, 8), which are in rows (f)."""
    a, b, _, d = nodes[faces[:, :4]].transpose(1, 0, 2)
    length, width = np.linalg.norm(b - a, axis=1), np.linalg.norm(d - a, axis=1)
    n_segments = np.maximum(np.ceil(length / SEGMENT_MM - 1e-6).astype(int), 1)
    of_row = [np.flatnonzero(row == r) for r in range(row.max() + 1)] if len(row) else []
    face = np.concatenate([np.zeros(0, dtype=int), *(np.tile(members, len(_ACROSS)) for members in of_row)])
    slices = np.concatenate([np.zeros(0, dtype=int), *(np.repeat([0, 1], len(members)) for members in of_row)])
    shape = {(n, k): _line_shape(n, _ACROSS[k]) for n in np.unique(n_segments).tolist() for k in (0, 1)}
    n_vertices = n_segments[face] + 1
    areas = np.repeat(0.5 * length[face] * width[face] / n_segments[face], n_vertices)
    first_vertex = np.concatenate([[0], np.cumsum(n_vertices)])
    areas[first_vertex[1:] - 1] = 0.0
    return Strips(
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        face=face.astype(np.int32),
        first_vertex=first_vertex.astype(np.int32),
        first_strip=np.cumsum([0, *(len(members) for members in of_row for _ in _ACROSS)]).astype(np.int32),
        strip=np.repeat(np.arange(len(face)), n_vertices).astype(np.int32),
        shape=np.vstack([np.zeros((0, 8)), *(shape[n, k] for n, k in zip(n_segments[face], slices, strict=True))]),
        areas=areas,
    )


def _line_shape(n: int, across: float) -> np.ndarray:
    """Return shape values (n + 1, 8) on a face along a line at constant place across it."""
    along = np.linspace(-1.0, 1.0, n + 1)
    return face_shape(8, np.column_stack([along, np.full(n + 1, across)]))[0]


def _lines(n_vertices: int, n_strips: int) -> Lines:
    return Lines(
        vertex=np.zeros((n_vertices, 2)),
        force=np.zeros((n_vertices, 2)),
        normal=np.zeros((n_vertices, 2)),
        square=np.zeros(n_vertices),
        nearest=np.zeros(n_vertices, dtype=np.int32),
        share=np.zeros(n_vertices),
        box=np.zeros((n_strips, 4)),
        outward=np.zeros((n_strips, 2)),
    )
