"""Make what tests share before their workers start (`python -m tests.kernels`): each worker would make it, too."""

import tempfile
from pathlib import Path

import numpy as np
import trimesh

from fast.flows.server.database import take_empty_database
from fast.flows.server.server import server
from fast.models.objects.distance import distance, distance_and_normal
from fast.models.objects.own import object_of_mesh
from fast.models.records import Trace
from fast.models.simulation.grasp import compile_simulator
from fast.models.traces.batch import features_of

if __name__ == "__main__":
    compile_simulator()
    block = object_of_mesh("b", trimesh.creation.box((9.0, 8.0, 7.0)), "b.stl")
    for measure in (distance, distance_and_normal):
        measure(block.primitives, np.zeros((1, 3)))
    features_of([Trace(np.arange(9.0), np.arange(9.0), np.ones(9))])
    with tempfile.TemporaryDirectory() as folder:
        if take_empty_database(Path(folder)):
            with server(Path(folder) / "lake"):
                pass  # the first server of a computer makes the database that later ones begin with
