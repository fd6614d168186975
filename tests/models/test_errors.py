import pickle

import pytest

from fast.models.errors import MeshingFailed, SimulationFailed


@pytest.mark.parametrize("error_type", [MeshingFailed, SimulationFailed])
def test_failures_survive_the_way_out_of_a_worker_process(error_type):
    error = pickle.loads(pickle.dumps(error_type("The mesh is empty.", "empty")))
    assert (type(error), str(error), error.reason) == (error_type, "The mesh is empty.", "empty")
