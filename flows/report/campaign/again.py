"""A measured grasp again, in the simulator: to draw fingers that no camera saw."""

import logging
from typing import NamedTuple

from lake.store import Lake
from lake.tables.campaign import SimulationRow, SimulatorVersionRow
from models.errors import FastError
from models.objects.catalogue import get_object
from models.records import Design, GraspSetup, GraspSimulation, SimulatorVersion
from models.simulation.grasp import simulate_grasp
from models.simulation.output.recording import GraspRecording

_LOG = logging.getLogger(__name__)


class Simulated(NamedTuple):
    """The grasp in the simulator, step by step."""

    version_id: str
    result: GraspSimulation
    recording: GraspRecording


def simulate_again(lake: Lake, design: Design, design_id: str, object_id: int, setup: GraspSetup) -> Simulated | None:
    """The grasp in the newest version of this program that has simulated it; None where it cannot be simulated."""
    recording = GraspRecording()
    try:
        version = newest_version(lake, design_id, object_id, setup)
        result = simulate_grasp(design, get_object(object_id), version, setup, recorder=recording.add)
    except FastError as error:
        _LOG.warning("the grasp of %s on object %d is not drawn: %s", design_id, object_id, error)
        return None
    return None if recording.is_empty else Simulated(version.version_id, result, recording)


def newest_version(lake: Lake, design_id: str, object_id: int, setup: GraspSetup) -> SimulatorVersion:
    """The newest version of which the lake has this grasp, else the default one."""
    keys = {"design_id": design_id, "object_id": object_id, "setup_id": setup.setup_id, "status": "ok"}
    for simulation in reversed(lake.records(SimulationRow, **keys)):
        rows = lake.records(SimulatorVersionRow, version_id=simulation.version_id)
        if rows and rows[-1].tier not in ("imported", "screening"):
            return rows[-1].version
    return SimulatorVersion()
