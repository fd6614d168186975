"""The benchmarks of identification and anomalies on made-up grasps of a results file: nothing is solved here."""

import numpy as np
import pytest

from fast.hardware.virtual.world.physics_cache import physics_id
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.flags import KINDS
from tests.studies.benchmarks.base import Options
from tests.studies.traces.anomalies import FIRST_TOOL, WORLDS, measure_anomalies
from tests.studies.traces.identification import measure_identification
from tests.studies.traces.world_grasps import SIMULATED, WorldGrasp, bench_world, measure_world

N_TOOLS, OBJECTS = 5, (1, 18, 24, 30, 32, 33)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    path = tmp_path_factory.mktemp("results") / "grasps.jsonl"
    grasps = [grasp(tool, object_id) for tool in range(N_TOOLS) for object_id in OBJECTS]
    path.write_text("".join(made.model_dump_json() + "\n" for made in grasps), encoding="utf-8")
    return path


def grasp(tool: int, object_id: int) -> WorldGrasp:
    """A rise to a level that is the tool's, held over a lift that is the object's."""
    lift = np.linspace(0.0, 60.0, 80)
    force = (6.0 + 2.0 * tool) * (1.0 - np.exp(-lift / 2.0)) / (1.0 + np.exp((lift - 8.0 - object_id) / 0.7))
    time_s, closing_n = np.linspace(0.0, 1.35, 10), np.linspace(0.0, -2.0, 10)
    return WorldGrasp(
        tool=tool,
        object_id=object_id,
        world_hash=bench_world().world_hash,
        code=physics_id(),
        time_s=(*time_s.tolist(), *(1.5 + lift / 5.0).tolist()),
        lift_mm=(*np.zeros(10).tolist(), *lift.tolist()),
        force_n=(*closing_n.tolist(), *force.tolist()),
    )


def test_a_measured_grasp_is_the_solved_one_with_noise_and_scatter() -> None:
    world = bench_world()
    measured = measure_world(world, [grasp(2, 30)])
    assert measured.repeat.tolist() == [0, 1, 2]
    peaks = measured.features.column("peak_force_n")
    assert peaks == pytest.approx(np.full(3, 10.0), abs=0.8)
    assert len(set(peaks.tolist())) == 3
    free = measured.traces[0].force_n[-30:]
    assert abs(free).max() < 5 * world.sensor.noise_sd_n


def test_identification_by_tools_that_were_not_learnt_from(results, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("fast.models.traces.identification.classifier.N_TREES", 30)
    monkeypatch.setattr("tests.studies.traces.recognition.N_DRAWS", 5)
    figure = tmp_path / "confusion.png"
    tables = measure_identification(Options(designs=N_TOOLS, objects=OBJECTS, results=results, figure=figure))
    assert tables["data"][0]["traces"] == N_TOOLS * len(OBJECTS) * 3
    accuracy = {row["of"]: row for row in tables["accuracy"]}
    assert accuracy["objects"]["top_1"] > 0.7 > 2 * accuracy["objects"]["chance"]
    assert {row["n_tools"] for row in tables["grasps seen"]} == {1, 2, 3, 5}
    assert [row["n_tools"] for row in tables["tools learnt from"]] == [2, 4]
    assert len(tables["tools"]) == N_TOOLS
    assert all(0 < row["p_value"] <= 1 for row in tables["parameters"])
    assert figure.stat().st_size > 10_000


def test_anomalies_by_kind(tmp_path) -> None:
    results = tmp_path / "grasps.jsonl"
    made = [grasp(FIRST_TOOL + tool, object_id) for tool in range(N_TOOLS) for object_id in OBJECTS]
    owners = [{"world_hash": bench_world(name).world_hash} for name in WORLDS]
    owners.append({"world_hash": SIMULATED, "code": SimulatorVersion().version_id})
    lines = [one.model_copy(update=owner).model_dump_json() for owner in owners for one in made]
    results.write_text("\n".join(lines) + "\n", encoding="utf-8")
    tables = measure_anomalies(Options(designs=N_TOOLS, objects=OBJECTS, results=results, worlds=2))
    assert {row["kind"] for row in tables["kinds"]} == set(KINDS)
    assert all(0 <= row["recall"] <= 1 and row["planted"] > 0 for row in tables["kinds"])
    assert {row["measure"] for row in tables["nothing wrong"]} == {"grip", "lift", "work", "preload", "zero"}
    assert tables["nothing wrong"][0]["flagged_per_1000"] < 30
