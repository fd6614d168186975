"""Penalty contact of a section that is as wide as the finger: points over the width share one in-plane motion.

The law is that of `models.fem.contact`. Each station of the front wall or tip carries a row of points over the
width, at y = const since u_y = 0. Their forces and tangents are summed at the station before they go to the three
nodes of its edge. The y component of pressure and friction does no work, but counts in the friction limit.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np

from models.fem.assembly import block_map
from models.fem.contact import ContactLaw, ContactState, Obstacle, PointSpacing, Solid
from models.fem.contact_kernel import Law, penalty
from models.fem.friction import return_mapping
from models.fem.plane_body import PlaneBody
from models.mesh.plane import PlaneMesh
from models.objects.distance import solid_distance

# Where an obstacle is compared across the width: the half of the objects' box that faces the finger, down to the depth
# to which contacts sink.
_PROBE_X_MM, _PROBE_Z_MM, _PROBE_STEP_MM, _PROBE_DEPTH_MM = (0.0, 26.0), (-2.0, 52.0), 1.9, 1.0
_N_PROBES = 4
_SAME_MM = 1e-9
_MARGIN_MM = 1e-9  # far above rounding: a point left out is outside for certain


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


class _Known(NamedTuple):
    """What is known of distances from the obstacle.

    Where each station was when last measured (s, 2); a lower bound then, in mm, for each of its points (n), and the
    least of them (s).
    """

    position: np.ndarray
    distance: np.ndarray
    least: np.ndarray


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
        self._known = _Known(np.zeros((n, 2)), np.full(n * len(self._y), -np.inf), np.full(n, -np.inf))

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
        return _interpolate(x, self._edges, self._edge_of_station, self._shape)

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
        near = np.flatnonzero(known.distance <= limit + _MARGIN_MM)
        known.distance[near] = self._obstacle.distance(points[near])
        known.least[:] = known.distance.reshape(len(stations), -1).min(axis=1)
        return float(known.distance[near].min())

    def respond(self, x: np.ndarray, state: ContactState, friction: np.ndarray, has_mirror: bool) -> PlaneResponse:
        """Contact at deformed nodes x (n, 2); `friction` and `has_mirror` as in `ContactSurface.respond`."""
        stations = self.positions(x)
        inside, distance, normal = self._gaps(stations)
        n, stiffness = len(inside), np.zeros((len(stations), 2, 2))
        response = PlaneResponse(np.zeros_like(x), stiffness, inside, np.zeros((n, 3)), np.zeros(n), np.zeros(n))
        law = Law(self.law.normal_n_per_mm3, self.law.tangential_n_per_mm3, self.law.smoothing_mm)
        motion = stations - self.positions(state.nodes)
        points = inside, distance, normal, self._lengths, self._widths
        new = response.traction, response.pressure, response.slip_step, stiffness
        force = _point_forces(stations, motion, *points, friction, state.traction, law, has_mirror, *new)
        _scatter_force(force, self._edges, self._edge_of_station, self._shape, response.force)
        return response

    def add_stiffness(self, response: PlaneResponse, blocks: np.ndarray) -> None:
        """Add the tangent of a response to `blocks` (z, 2, 2)."""
        _scatter_stiffness(response.stiffness, self._places, self._edge_of_station, self._shape, blocks)

    def _gaps(self, stations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (m), distances (m) and normals (m, 3) of the points inside the obstacle.

        A distance changes at most as far as its point moves, so points that cannot have arrived are not asked.
        """
        if self._primitives is not None:
            return _inside_solid(self._primitives, stations, self._y, self._known)
        near, points = _arrived(stations, self._y, self._known)
        if not len(near):
            return near, np.zeros(0), np.zeros((0, 3))
        distance = self._obstacle.distance(points)
        _remember(near, distance, len(self._y), self._known)
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(x: np.ndarray, edges: np.ndarray, edge_of_station: np.ndarray, shape: np.ndarray) -> np.ndarray:
    stations = np.zeros((len(edge_of_station), 2))
    for s in range(len(edge_of_station)):
        for a in range(3):
            node = edges[edge_of_station[s], a]
            stations[s, 0] += shape[s, a] * x[node, 0]
            stations[s, 1] += shape[s, a] * x[node, 1]
    return stations


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _arrived(stations: np.ndarray, y: np.ndarray, known: _Known) -> tuple[np.ndarray, np.ndarray]:
    """Points that may be inside (m), station by station, and their positions (m, 3)."""
    n_rows = len(y)
    near, n = np.zeros(len(known.distance), dtype=np.int64), 0
    for s in range(len(stations)):
        moved = np.hypot(stations[s, 0] - known.position[s, 0], stations[s, 1] - known.position[s, 1])
        if known.least[s] > moved + _MARGIN_MM:
            continue
        known.position[s] = stations[s]
        for c in range(s * n_rows, (s + 1) * n_rows):
            known.distance[c] -= moved
            if known.distance[c] <= _MARGIN_MM:
                near[n] = c
                n += 1
    points = np.zeros((n, 3))
    for i in range(n):
        s, r = divmod(near[i], n_rows)
        points[i, 0], points[i, 1], points[i, 2] = stations[s, 0], y[r], stations[s, 1]
    return near[:n], points


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _remember(near: np.ndarray, distance: np.ndarray, n_rows: int, known: _Known) -> None:
    """Keep the distances (m) just measured of the points that `_arrived` has found."""
    for i in range(len(near)):
        known.distance[near[i]] = distance[i]
    last = -1
    for c in near:
        s = c // n_rows
        if s != last:
            known.least[s] = known.distance[s * n_rows : (s + 1) * n_rows].min()
            last = s


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _inside_solid(
    rows: np.ndarray, stations: np.ndarray, y: np.ndarray, known: _Known
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers (m), distances (m) and normals (m, 3) of the points inside a solid of primitives `rows`."""
    near, points = _arrived(stations, y, known)
    distance, normal = np.zeros(len(near)), np.zeros((len(near), 3))
    for i in range(len(near)):
        distance[i], normal[i, 0], normal[i, 1], normal[i, 2] = solid_distance(
            rows, points[i, 0], points[i, 1], points[i, 2]
        )
    _remember(near, distance, len(y), known)
    inside = np.flatnonzero(distance < 0.0)
    return near[inside], distance[inside], normal[inside]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _point_forces(
    stations: np.ndarray,
    motion: np.ndarray,
    inside: np.ndarray,
    distance: np.ndarray,
    normals: np.ndarray,
    lengths: np.ndarray,
    widths: np.ndarray,
    friction: np.ndarray,
    old_traction: np.ndarray,
    law: Law,
    has_mirror: bool,
    traction: np.ndarray,
    pressure: np.ndarray,
    slip_step: np.ndarray,
    stiffness: np.ndarray,
) -> np.ndarray:
    """Force (s, 2) in N at the stations; adds to `stiffness` (s, 2, 2) and fills the state of the points."""
    force = np.zeros_like(stations)
    moved, tangent = np.zeros(3), np.zeros((3, 3))
    if has_mirror:
        for s in range(len(stations)):
            if stations[s, 0] < 0.0:
                p, slope = penalty(-stations[s, 0], law)
                force[s, 0] += lengths[s] * widths.sum() * p
                stiffness[s, 0, 0] += lengths[s] * widths.sum() * slope
    for i in range(len(inside)):
        c, normal = inside[i], normals[i]
        s = c // len(widths)
        w = lengths[s] * widths[c % len(widths)]
        p, slope = penalty(-distance[i], law)
        moved[0], moved[2] = motion[s, 0], motion[s, 1]
        slip_step[i] = return_mapping(old_traction[c], moved, normal, friction[c] * p, law.kt, traction[i], tangent)
        pressure[i] = p
        for k in range(2):
            force[s, k] += w * (p * normal[2 * k] + traction[i, 2 * k])
            for m in range(2):
                stiffness[s, k, m] += w * (tangent[2 * k, 2 * m] + slope * normal[2 * k] * normal[2 * m])
    return force


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _scatter_force(
    station_force: np.ndarray, edges: np.ndarray, edge_of_station: np.ndarray, shape: np.ndarray, force: np.ndarray
) -> None:
    for s in range(len(station_force)):
        f0, f1 = station_force[s, 0], station_force[s, 1]
        if f0 == 0.0 and f1 == 0.0:
            continue
        for a in range(3):
            node = edges[edge_of_station[s], a]
            force[node, 0] += shape[s, a] * f0
            force[node, 1] += shape[s, a] * f1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _scatter_stiffness(
    stiffness: np.ndarray, places: np.ndarray, edge_of_station: np.ndarray, shape: np.ndarray, blocks: np.ndarray
) -> None:
    """Add the symmetric stiffness (s, 2, 2) of the stations to the blocks between the nodes of their edges."""
    for s in range(len(stiffness)):
        if stiffness[s, 0, 0] == 0.0 and stiffness[s, 1, 1] == 0.0:
            continue
        for a in range(3):
            for b in range(a + 1):
                place = places[edge_of_station[s], a, b]
                if place == -1:
                    continue
                if place < 0:
                    place = -2 - place
                factor = shape[s, a] * shape[s, b]
                for i in range(2):
                    for j in range(2):
                        blocks[place, i, j] += factor * stiffness[s, i, j]
