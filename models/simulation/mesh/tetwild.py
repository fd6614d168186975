"""Quadratic tetrahedra of the extruded profile by fTetWild: an independent mesh of the same body.

pytetwild can run very long or crash on a bad surface, and it is not deterministic, so it works in a process of its
own with a time limit, and a mesh that matters should be kept (`SolidMesh.to_arrays`). At equal unknowns it is less
accurate than hexahedra: use it as a reference or for bodies that are not extrusions.
"""

import contextlib
import multiprocessing
import tempfile
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

import numpy as np
import trimesh
from shapely.geometry import Polygon

from fast.models.errors import MeshingFailed
from fast.models.simulation.body.shape_functions import TETRAHEDRON_EDGES
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh

ENVELOPE_MM = 0.02  # fTetWild keeps the surface within this distance
SNAP_MM = 0.1  # nodes this near to a plane of the body belong to it


def tetwild_mesh(
    profile: Polygon, width_mm: float, edge_mm: float, *, full_width: bool = False, time_limit_s: float = 60.0
) -> SolidMesh:
    """Mesh a planar profile (x, z in mm) extruded over 0..W/2, or -W/2..W/2 when `full_width`, with C3D10.

    Raises:
        MeshingFailed: `time_out`, `crash`, or `empty`.
    """
    surface = extruded_surface(profile, width_mm, full_width=full_width)
    vertices, tetrahedra = tetrahedralise(surface.vertices, surface.faces, edge_mm, time_limit_s)
    base_z, apex_z = profile.bounds[1], profile.bounds[3]
    planes = ((0, 0.0), (2, base_z), (2, apex_z), (1, 0.5 * width_mm), (1, -0.5 * width_mm if full_width else 0.0))
    for axis, value in planes:
        vertices[np.abs(vertices[:, axis] - value) < SNAP_MM, axis] = value
    return quadratic_mesh(vertices, tetrahedra, base_z, apex_z, is_half=not full_width)


def extruded_surface(profile: Polygon, width_mm: float, *, full_width: bool) -> trimesh.Trimesh:
    """Return the watertight surface of the extruded profile in the finger frame."""
    depth = width_mm if full_width else 0.5 * width_mm
    body = trimesh.creation.extrude_polygon(profile, depth)
    x, z, y = body.vertices.T
    start = 0.5 * width_mm if full_width else 0.0
    # Swapping two axes mirrors the body, so the faces are turned round.
    return trimesh.Trimesh(np.column_stack([x, y - start, z]), body.faces[:, ::-1], process=False)


def tetrahedralise(
    vertices: np.ndarray, faces: np.ndarray, edge_mm: float, time_limit_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Make linear tetrahedra: vertices (v, 3) and corners (t, 4), from a closed surface, in a process of its own.

    Raises:
        MeshingFailed: `time_out`, `crash` (the process died or raised), or `empty`.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    # fTetWild leaves files in its working directory.
    with tempfile.TemporaryDirectory(prefix="tetwild-") as folder:
        worker = context.Process(target=_work, args=(sender, folder, vertices, faces, edge_mm), daemon=True)
        worker.start()
        sender.close()
        try:
            return _collect(worker, receiver, time_limit_s)
        finally:
            receiver.close()
            if worker.is_alive():
                worker.kill()
            worker.join()


def _collect(worker: SpawnProcess, receiver: Connection, time_limit_s: float) -> tuple[np.ndarray, np.ndarray]:
    if not receiver.poll(time_limit_s):
        raise MeshingFailed(
            f"fTetWild gave no mesh within {time_limit_s:g} s; use a larger `edge_mm` or the extruded mesher.",
            "time_out",
        )
    try:
        answer = receiver.recv()
    except EOFError as error:
        worker.join()
        raise MeshingFailed(
            f"fTetWild died (exit status {worker.exitcode}); use the extruded mesher for this design.", "crash"
        ) from error
    if isinstance(answer, str):
        raise MeshingFailed(f"fTetWild failed ({answer}); use the extruded mesher for this design.", "crash")
    vertices, tetrahedra = answer
    if not len(tetrahedra):
        raise MeshingFailed("fTetWild returned no tetrahedra; use the extruded mesher for this design.", "empty")
    return np.array(vertices), np.array(tetrahedra)


def _work(sender: Connection, folder: str, vertices: np.ndarray, faces: np.ndarray, edge_mm: float) -> None:
    """Do the work of the worker process."""
    try:
        from pytetwild import tetrahedralize

        diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        with contextlib.chdir(folder):
            mesh = tetrahedralize(
                np.ascontiguousarray(vertices, dtype=np.float64),
                np.ascontiguousarray(faces, dtype=np.int32),
                optimize=True,
                edge_length_abs=edge_mm,
                epsilon=ENVELOPE_MM / diagonal,
                num_threads=1,
                quiet=True,
            )
        sender.send(mesh)
    except (RuntimeError, ValueError, ImportError, OSError) as error:
        sender.send(f"{type(error).__name__}: {error}")


def quadratic_mesh(
    vertices: np.ndarray, tetrahedra: np.ndarray, base_z: float, apex_z: float, *, is_half: bool
) -> SolidMesh:
    """Make ten-node tetrahedra from linear ones, with the sets of the finger frame."""
    a, b, c, d = vertices[tetrahedra].transpose(1, 0, 2)
    volume = np.einsum("ti,ti->t", np.cross(b - a, c - a), d - a)
    corners = np.where((volume > 0)[:, None], tetrahedra, tetrahedra[:, [0, 2, 1, 3]])
    # Snapping can flatten a sliver on the surface; it carries nothing.
    corners = corners[np.abs(volume) > 1e-9]
    used, compact = np.unique(corners, return_inverse=True)
    corners = compact.reshape(-1, 4)
    pairs = np.sort(corners[:, np.array(TETRAHEDRON_EDGES)].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(pairs, axis=0, return_inverse=True)
    points = vertices[used]
    nodes = np.vstack([points, points[edges].mean(axis=1)])
    elements = np.hstack([corners, len(points) + inverse.reshape(-1, 6)]).astype(np.int32)
    return SolidMesh(
        nodes=nodes,
        blocks=(ElementBlock("C3D10", elements),),
        base_nodes=np.flatnonzero(nodes[:, 2] == base_z).astype(np.int32),
        symmetry_nodes=np.flatnonzero(nodes[:, 1] == 0.0).astype(np.int32) if is_half else np.zeros(0, np.int32),
        contact_faces=_contact_faces(nodes, elements, apex_z),
    )


def _contact_faces(nodes: np.ndarray, elements: np.ndarray, apex_z: float) -> np.ndarray:
    """Find the six-node element faces (f, 6) on the front wall x = 0 and on the tip plane."""
    sides = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [2, 0, 3, 6, 7, 9]])
    faces = elements[:, sides].reshape(-1, 6)
    on_front = (nodes[faces, 0] == 0.0).all(axis=1)
    on_tip = (nodes[faces, 2] == apex_z).all(axis=1)
    return faces[on_front | on_tip]
