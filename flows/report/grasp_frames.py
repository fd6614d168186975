"""What pictures and recordings of a grasp are drawn from: deformed fingers, pressure and forces at every step.

Both draw in the frame of the object (mm, z up, x closing), both fingers whole, forces and pressures at the actual
modulus. `simulate_again` gives the frames of a measured grasp, whose fingers no camera saw.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import SimulationRow, SimulatorVersionRow
from fast.models.errors import FastError
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspSetup, GraspSimulation, Trace
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.output.recording import SIDES, GraspRecording, Snapshot
from fast.models.simulation.output.surface import Skin, section_of, section_outline, skin_of
from fast.models.simulation.placement import Side
from fast.models.simulation.version import SimulatorVersion

_LOG = logging.getLogger(__name__)
SQUARE_MM = 3.0  # contact forces are summed over cells of this size
SIGNS: dict[Side, float] = dict(zip(SIDES, (1.0, -1.0), strict=True))


@dataclass(frozen=True)
class FingerShape:
    """What all frames of a finger share: its surface and middle section as numbers of mesh nodes, and its side.

    `mirror`: factors (3) that bring the simulator's right-hand finger to its side.
    """

    mirror: np.ndarray
    skin: Skin
    section: list[np.ndarray]
    outline: np.ndarray
    base_nodes: np.ndarray

    @classmethod
    def of(cls, snapshot: Snapshot, side: Side) -> "FingerShape":
        """Make the finger's shape in a snapshot, on a side: of a symmetric grasp only the right one is simulated."""
        is_turned = side != snapshot.side and snapshot.is_half_turned
        mirror = np.array([SIGNS[side], -1.0 if is_turned else 1.0, 1.0])
        section = section_of(snapshot.mesh)
        skin = skin_of(snapshot.mesh)
        if mirror.prod() < 0:  # mirrored, so that the triangles still look outward
            skin = Skin(skin.nodes, skin.sign_y, skin.triangles[:, ::-1])
        return cls(mirror, skin, section, section_outline(section), snapshot.mesh.base_nodes)


@dataclass(frozen=True)
class Frame:
    """One finger at one instant; `snapshot` is as the simulator left it."""

    shape: FingerShape
    snapshot: Snapshot

    @property
    def mirror(self) -> np.ndarray:
        """See `FingerShape`."""
        return self.shape.mirror

    @property
    def nodes(self) -> np.ndarray:
        """Deformed nodes (n, 3), mm."""
        return self.snapshot.nodes * self.mirror

    @property
    def vertices(self) -> np.ndarray:
        """Points (v, 3) of the deformed surface, mm."""
        return self.shape.skin.vertices(self.snapshot.nodes) * self.mirror

    @property
    def moved_mm(self) -> np.ndarray:
        """Displacement (v) of the points of the surface from the undeformed finger."""
        return self.snapshot.displacement_mm[self.shape.skin.nodes]

    @property
    def pressed_at(self) -> np.ndarray:
        """Points (c, 3) that the object presses on, mm."""
        return self.snapshot.contact_points * self.mirror

    @property
    def pressure_kpa(self) -> np.ndarray:
        """Contact pressure (c) at these points."""
        return 1e3 * self.snapshot.scale * self.snapshot.pressure

    @cached_property
    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Places (k, 3) in mm and forces (k, 3) in N of the object on the whole finger, summed across its width.

        Contact points are gathered by cells of `SQUARE_MM` in x and z.
        """
        snapshot = self.snapshot
        points, force = snapshot.contact_points, snapshot.scale * snapshot.contact_force
        if snapshot.mesh.is_half:
            force = 2.0 * force * np.array([1.0, 0.0, 1.0])
        cells = np.floor(points[:, [0, 2]] / SQUARE_MM)
        _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        places, sums = np.zeros((len(count), 3)), np.zeros((len(count), 3))
        np.add.at(places, cell.ravel(), points)
        np.add.at(sums, cell.ravel(), force)
        return places / count[:, None] * self.mirror, sums * self.mirror


@dataclass(frozen=True)
class Instant:
    """A named instant of a grasp: a frame per finger, and the force on the load cell in N."""

    name: str
    frames: dict[Side, Frame]
    force_n: float

    @property
    def right(self) -> Snapshot:
        """The finger on the +x side."""
        return self.frames["right"].snapshot


@dataclass(frozen=True)
class GraspFrames:
    """All frames of a simulated grasp, by finger, in order of time."""

    frames: dict[Side, list[Frame]]

    @classmethod
    def of(cls, recording: GraspRecording) -> "GraspFrames":
        """Return the frames of a recording that is not empty."""
        return cls({side: _frames(recording.of(side), side) for side in SIDES})

    @property
    def furthest_mm(self) -> float:
        """Largest displacement of a point of the fingers in the grasp."""
        return max(float(f.snapshot.displacement_mm.max()) for frames in self.frames.values() for f in frames)

    @property
    def largest_force_n(self) -> float:
        """Largest force on a cell of a finger in the grasp; 1 N where none was ever touched."""
        return largest_force_n([f for frames in self.frames.values() for f in frames])

    def at(self, name: str, time_s: float, trace: Trace) -> Instant:
        """Return the instant nearest to a time."""
        near = {
            side: min(frames, key=lambda frame: abs(frame.snapshot.time_s - time_s))
            for side, frames in self.frames.items()
        }
        return Instant(name, near, float(np.interp(time_s, trace.time_s, trace.force_n)))


def _frames(snapshots: Sequence[Snapshot], side: Side) -> list[Frame]:
    shape = FingerShape.of(snapshots[0], side)
    return [Frame(shape, snapshot) for snapshot in snapshots]


def largest_force_n(frames: Sequence[Frame]) -> float:
    """Return the largest force on a cell of these fingers; 1 N where none is touched."""
    forces = (f.forces[1] for f in frames if f.snapshot.pressure.size)
    return max((float(np.linalg.norm(force, axis=1).max()) for force in forces), default=1.0)


def five_instants(recording: GraspRecording, trace: Trace) -> list[Instant]:
    """Return touch, half closed, closed, peak, and the last contact of the lift; none of an empty recording."""
    if recording.is_empty:
        return []
    snapshots = recording.of("right")
    closing = [s for s in snapshots if s.phase == "closing"]
    lift = [s for s in snapshots if s.phase == "lift"]
    middle = 0.5 * (closing[0].travel_mm + closing[-1].travel_mm)
    half = min(closing, key=lambda s: abs(s.travel_mm - middle))
    lifting = trace.is_lift
    peak_s = float(trace.time_s[lifting][np.argmax(trace.force_n[lifting])])
    peak = min(lift, key=lambda s: abs(s.time_s - peak_s))
    last = max((s for s in lift if s.pressure.size), key=lambda s: s.time_s, default=lift[-1])
    named = {"touch": closing[0], "half closed": half, "closed": closing[-1], "peak": peak, "last contact": last}
    frames = GraspFrames.of(recording)
    return [frames.at(name, snapshot.time_s, trace) for name, snapshot in named.items()]


class Simulated(NamedTuple):
    """The grasp in the simulator, step by step."""

    version: SimulatorVersion
    result: GraspSimulation
    recording: GraspRecording


def simulate_again(
    lake: Lake, design: Design, design_id: str, object_id: int, setup: GraspSetup, along: str | Sequence[str] = ()
) -> Simulated | None:
    """Simulate the grasp in the newest version of this program that has simulated it; None where it cannot be.

    along: parameters that it gets slopes by.
    """
    recording = GraspRecording()
    try:
        version = find_newest_version(lake, design_id, object_id, setup)
        result = simulate_grasp(design, get_object(object_id), version, setup, recorder=recording.add, along=along)
    except FastError as error:
        _LOG.warning("the grasp of %s on object %d is not drawn: %s", design_id, object_id, error)
        return None
    return None if recording.is_empty else Simulated(version, result, recording)


def find_newest_version(lake: Lake, design_id: str, object_id: int, setup: GraspSetup) -> SimulatorVersion:
    """Find the newest version of which the lake has this grasp, else the default one."""
    keys = {"design_id": design_id, "object_id": object_id, "setup_id": setup.setup_id, "status": "ok"}
    for simulation in reversed(lake.records(SimulationRow, **keys)):
        rows = lake.records(SimulatorVersionRow, version_id=simulation.version_id)
        if rows and rows[-1].tier not in ("imported", "screening"):
            return rows[-1].version
    return SimulatorVersion()
