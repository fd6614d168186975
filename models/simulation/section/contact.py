"""Penalty contact of a section that is as wide as the finger: points over the width share one in-plane motion.

The law is that of `models.simulation.contact.law`. Each station of the front wall or tip carries a row of points over
the width, at y = const since u_y = 0. Their forces and tangents are summed at the station before they go to the three
nodes of its edge. The y component of pressure and friction does no work, but counts in the friction limit.
"""

from dataclasses import dataclass

import numpy as np

from models.simulation.body.assembly import block_map
from models.simulation.contact.law import ContactLaw, ContactState, Obstacle, PointSpacing, Solid
from models.simulation.mesh.plane import PlaneMesh
from models.simulation.section.body import PlaneBody
from models.simulation.section.contact_kernel import (
    MARGIN_MM,
    Known,
    arrived,
    inside_solid,
    interpolate,
    point_forces,
    remember,
    scatter_force,
    scatter_stiffness,
)

# Where an obstacle is compared across the width: the half of the objects' box that faces the finger, down to the depth
# to which contacts sink.
_PROBE_X_MM, _PROBE_Z_MM, _PROBE_STEP_MM, _PROBE_DEPTH_MM = (0.0, 26.0), (-2.0, 52.0), 1.9, 1.0
_N_PROBES = 4
_SAME_MM = 1e-9


@dataclass(frozen=True)
class PlaneResponse:
    """Outcome of one evaluation.

    Nodal force (n, 2) in N, stiffness (s, 2, 2) of the stations in N/mm; of the points that touch the obstacle (m)
    their numbers, tractions (m, 3) and pressures (m) in MPa, and slips of the step (m) in mm.
    """

    force: np.ndarray
    stiffness: np.ndarray
    points: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip_step: np.ndarray


def width_rows(obstacle: Obstacle, mesh: PlaneMesh, spacing_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Places y (r) over the width of the mesh and the width (r) in mm that each stands for.

    One row is enough where the obstacle is the same over the whole width.
    """
    n = max(int(np.ceil(mesh.width_mm / spacing_mm)), 1)
    y = mesh.width_mm * ((np.arange(n) + 0.5) / n - (0.0 if mesh.is_half else 0.5))
    if _is_same(obstacle, np.concatenate([y[:: max(n // _N_PROBES, 1)], y[-1:]])):
        return y[:1], np.array([mesh.width_mm])
    return y, np.full(n, mesh.width_mm / n)


def _is_same(obstacle: Obstacle, y: np.ndarray) -> bool:
    """True if the obstacle's surface is the same curve in the sections at all y (r)."""
    x, z = np.meshgrid(np.arange(*_PROBE_X_MM, _PROBE_STEP_MM), np.arange(*_PROBE_Z_MM, _PROBE_STEP_MM))
    points = np.column_stack([x.ravel(), np.full(x.size, y[-1]), z.ravel()])
    last = np.maximum(obstacle.distance(points), -_PROBE_DEPTH_MM)
    for other in y[:-1]:
        points[:, 1] = other
        if np.abs(np.maximum(obstacle.distance(points), -_PROBE_DEPTH_MM) - last).max() > _SAME_MM:
            return False
    return True


class PlaneSurface:
    """Contact points of a section: point i is in row i % r of station i // r."""

    def __init__(
        self, body: PlaneBody, nodes: np.ndarray, law: ContactLaw, spacing: PointSpacing, obstacle: Obstacle
    ) -> None:
        """`nodes` (n, 2): undeformed mesh, in the frame of the calculation."""
        self.law, self._obstacle = law, obstacle
        self._primitives = obstacle.primitives if isinstance(obstacle, Solid) else None
        self._edges = body.mesh.contact_edges
        self._places = block_map(self._edges, body.row_of_node, body.pattern)
        self._y, self._widths = width_rows(obstacle, body.mesh, spacing.across_mm)
        self._edge_of_station, self._shape, self._lengths = _stations(nodes[self._edges], spacing.along_mm)
        n = len(self._lengths)
        self._known = Known(np.zeros((n, 2)), np.full(n * len(self._y), -np.inf), np.full(n, -np.inf))

    @property
    def n_points(self) -> int:
        """Number of contact points."""
        return len(self._known.distance)

    def start(self, x: np.ndarray) -> ContactState:
        """State before any contact, at deformed nodes x (n, 2)."""
        n = self.n_points
        return ContactState(x, np.zeros((n, 3)), np.zeros(n), np.zeros(n))

    def advance(self, state: ContactState, x: np.ndarray, response: PlaneResponse) -> ContactState:
        """State after a converged step from `state` to nodes x (n, 2) with this response."""
        new = self.start(x)
        new.traction[response.points], new.pressure[response.points] = response.traction, response.pressure
        new.slip[:] = state.slip
        new.slip[response.points] += response.slip_step
        return new

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Stations (s, 2) at deformed nodes x (n, 2)."""
        return interpolate(x, self._edges, self._edge_of_station, self._shape)

    @property
    def areas(self) -> np.ndarray:
        """Undeformed area of every point (n) in mm2."""
        return np.outer(self._lengths, self._widths).ravel()

    def points(self, x: np.ndarray) -> np.ndarray:
        """Contact points (n, 3) at deformed nodes x (n, 2)."""
        x_and_z = np.repeat(self.positions(x), len(self._y), axis=0)
        return np.column_stack([x_and_z[:, 0], np.tile(self._y, len(self._lengths)), x_and_z[:, 1]])

    def distance(self, x: np.ndarray) -> float:
        """Least distance in mm of a point from the obstacle at deformed nodes x (n, 2)."""
        stations, known = self.positions(x), self._known
        moved = np.hypot(*(stations - known.position).T)
        known.distance[:] -= np.repeat(moved, len(self._y))
        known.position[:] = stations
        points = self.points(x)
        nearest = int(np.argmin(known.distance))
        limit = self._obstacle.distance(points[nearest : nearest + 1])[0]
        near = np.flatnonzero(known.distance <= limit + MARGIN_MM)
        known.distance[near] = self._obstacle.distance(points[near])
        known.least[:] = known.distance.reshape(len(stations), -1).min(axis=1)
        return float(known.distance[near].min())

    def respond(self, x: np.ndarray, state: ContactState, friction: np.ndarray, stop_mm: float) -> PlaneResponse:
        """Contact at deformed nodes x (n, 2); `friction` and `stop_mm` as in `ContactSurface.respond`."""
        stations = self.positions(x)
        inside, distance, normal = self._gaps(stations)
        n, stiffness = len(inside), np.zeros((len(stations), 2, 2))
        response = PlaneResponse(np.zeros_like(x), stiffness, inside, np.zeros((n, 3)), np.zeros(n), np.zeros(n))
        motion = stations - self.positions(state.nodes)
        points = inside, distance, normal, self._lengths, self._widths
        new = response.traction, response.pressure, response.slip_step, stiffness
        force = point_forces(stations, motion, *points, friction, state.traction, self.law.compiled, stop_mm, *new)
        scatter_force(force, self._edges, self._edge_of_station, self._shape, response.force)
        return response

    def add_stiffness(self, response: PlaneResponse, blocks: np.ndarray) -> None:
        """Add the tangent of a response to `blocks` (z, 2, 2)."""
        scatter_stiffness(response.stiffness, self._places, self._edge_of_station, self._shape, blocks)

    def _gaps(self, stations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (m), distances (m) and normals (m, 3) of the points inside the obstacle.

        A distance changes at most as far as its point moves, so points that cannot have arrived are not asked.
        """
        if self._primitives is not None:
            return inside_solid(self._primitives, stations, self._y, self._known)
        near, points = arrived(stations, self._y, self._known)
        if not len(near):
            return near, np.zeros(0), np.zeros((0, 3))
        distance = self._obstacle.distance(points)
        remember(near, distance, len(self._y), self._known)
        is_inside = distance < 0.0
        normal = self._obstacle.normal(points[is_inside]) if is_inside.any() else np.zeros((0, 3))
        return near[is_inside], distance[is_inside], normal


def _stations(edges: np.ndarray, spacing_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edge of each station (s), shape values (s, 3) and length in mm (s), for straight edges (e, 3, 2)."""
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    counts = np.maximum(np.ceil(length / spacing_mm).astype(int), 1)
    t = np.concatenate([2.0 * (np.arange(n) + 0.5) / n - 1.0 for n in counts])
    shape = np.column_stack([0.5 * t * (t - 1.0), 0.5 * t * (t + 1.0), 1.0 - t**2])
    return np.repeat(np.arange(len(edges), dtype=np.int32), counts), shape, np.repeat(length / counts, counts)
