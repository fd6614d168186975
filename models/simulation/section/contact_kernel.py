"""Compiled loops of a section's contact: find its points inside an obstacle, add their forces and tangents.

Stations are numbered along the section, points along the width within each: point i is at station i // r.
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from models.objects.distance import solid_distance
from models.simulation.contact.friction import return_mapping
from models.simulation.contact.kernel import Law, friction_limit, penalty

MARGIN_MM = 1e-9  # far above rounding: a point left out is outside for certain


class Known(NamedTuple):
    """What is known of distances from the obstacle.

    Where each station was when last measured (s, 2); a lower bound then, in mm, for each of its points (n), and the
    least of them (s).
    """

    position: np.ndarray
    distance: np.ndarray
    least: np.ndarray


@nb.njit(cache=True, nogil=True, error_model="numpy")
def interpolate(x: np.ndarray, edges: np.ndarray, edge_of_station: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Stations (s, 2) at deformed nodes x (n, 2)."""
    stations = np.zeros((len(edge_of_station), 2))
    for s in range(len(edge_of_station)):
        for a in range(3):
            node = edges[edge_of_station[s], a]
            stations[s, 0] += shape[s, a] * x[node, 0]
            stations[s, 1] += shape[s, a] * x[node, 1]
    return stations


@nb.njit(cache=True, nogil=True, error_model="numpy")
def arrived(stations: np.ndarray, y: np.ndarray, known: Known) -> tuple[np.ndarray, np.ndarray]:
    """Points that may be inside (m), station by station, and their positions (m, 3)."""
    n_rows = len(y)
    near, n = np.zeros(len(known.distance), dtype=np.int64), 0
    for s in range(len(stations)):
        moved = np.hypot(stations[s, 0] - known.position[s, 0], stations[s, 1] - known.position[s, 1])
        if known.least[s] > moved + MARGIN_MM:
            continue
        known.position[s] = stations[s]
        for c in range(s * n_rows, (s + 1) * n_rows):
            known.distance[c] -= moved
            if known.distance[c] <= MARGIN_MM:
                near[n] = c
                n += 1
    points = np.zeros((n, 3))
    for i in range(n):
        s, r = divmod(near[i], n_rows)
        points[i, 0], points[i, 1], points[i, 2] = stations[s, 0], y[r], stations[s, 1]
    return near[:n], points


@nb.njit(cache=True, nogil=True, error_model="numpy")
def remember(near: np.ndarray, distance: np.ndarray, n_rows: int, known: Known) -> None:
    """Keep the distances (m) just measured of the points that `arrived` has found."""
    for i in range(len(near)):
        known.distance[near[i]] = distance[i]
    last = -1
    for c in near:
        s = c // n_rows
        if s != last:
            known.least[s] = known.distance[s * n_rows : (s + 1) * n_rows].min()
            last = s


@nb.njit(cache=True, nogil=True, error_model="numpy")
def inside_solid(
    rows: np.ndarray, stations: np.ndarray, y: np.ndarray, known: Known
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers (m), distances (m) and normals (m, 3) of the points inside a solid of primitives `rows`."""
    near, points = arrived(stations, y, known)
    distance, normal = np.zeros(len(near)), np.zeros((len(near), 3))
    for i in range(len(near)):
        distance[i], normal[i, 0], normal[i, 1], normal[i, 2] = solid_distance(
            rows, points[i, 0], points[i, 1], points[i, 2]
        )
    remember(near, distance, len(y), known)
    inside = np.flatnonzero(distance < 0.0)
    return near[inside], distance[inside], normal[inside]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def point_forces(
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
    stop_mm: float,
    traction: np.ndarray,
    pressure: np.ndarray,
    slip_step: np.ndarray,
    stiffness: np.ndarray,
) -> np.ndarray:
    """Force (s, 2) in N at the stations; adds to `stiffness` (s, 2, 2) and fills the state of the points."""
    force = np.zeros_like(stations)
    moved, tangent = np.zeros(3), np.zeros((3, 3))
    for s in range(len(stations)):
        if stations[s, 0] < stop_mm:
            p, slope = penalty(stop_mm - stations[s, 0], law)
            force[s, 0] += lengths[s] * widths.sum() * p
            stiffness[s, 0, 0] += lengths[s] * widths.sum() * slope
    for i in range(len(inside)):
        c, normal = inside[i], normals[i]
        s = c // len(widths)
        w = lengths[s] * widths[c % len(widths)]
        p, slope = penalty(-distance[i], law)
        moved[0], moved[2] = motion[s, 0], motion[s, 1]
        limit = friction_limit(friction[c], p, -distance[i], law)
        slip_step[i] = return_mapping(old_traction[c], moved, normal, limit, law.kt, traction[i], tangent)
        pressure[i] = p
        for k in range(2):
            force[s, k] += w * (p * normal[2 * k] + traction[i, 2 * k])
            for m in range(2):
                stiffness[s, k, m] += w * (tangent[2 * k, 2 * m] + slope * normal[2 * k] * normal[2 * m])
    return force


@nb.njit(cache=True, nogil=True, error_model="numpy")
def scatter_force(
    station_force: np.ndarray, edges: np.ndarray, edge_of_station: np.ndarray, shape: np.ndarray, force: np.ndarray
) -> None:
    """Add the forces (s, 2) of the stations to the nodes (n, 2) of their edges."""
    for s in range(len(station_force)):
        f0, f1 = station_force[s, 0], station_force[s, 1]
        if f0 == 0.0 and f1 == 0.0:
            continue
        for a in range(3):
            node = edges[edge_of_station[s], a]
            force[node, 0] += shape[s, a] * f0
            force[node, 1] += shape[s, a] * f1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def scatter_stiffness(
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
