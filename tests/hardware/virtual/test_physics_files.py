"""Solved grasps in files: found by a restarted bench, never for another question, and never torn."""

import os
from pathlib import Path

import numpy as np
import pytest

from fast.hardware.virtual.world import physics_cache as physics_files
from fast.hardware.virtual.world.file import Scatter, World, WorldMesh
from fast.hardware.virtual.world.physics import PhysicsCache, PhysicsRequest, build_request
from fast.hardware.virtual.world.physics_cache import PhysicsFiles
from fast.models.design.fin_ray import FinRay, GradedFinRay
from fast.models.errors import SimulationFailed
from fast.models.records import Design, EffectValue, GraspSetup, GraspSimulation, Theta, Trace

DESIGN = FinRay(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip
PLAIN = World()
HIDDEN = EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.7, "slip_scale_mm": 1.0})


class Solver:
    """Counts how often it is asked; the force is irrational, so that a rounded copy would show."""

    def __init__(self) -> None:
        self.n_asked = 0

    def __call__(self, request: PhysicsRequest) -> GraspSimulation:
        self.n_asked += 1
        if request.object_id == 35:
            raise SimulationFailed("no solution", "diverged")
        lift_mm = np.linspace(0, 10, 7)
        force_n = np.sqrt(2 + request.object_id) * lift_mm
        trace = Trace(lift_mm / 3, lift_mm, force_n)
        return GraspSimulation(trace, float(force_n.max()), 5.0, 0.1, 7, 20, 900, 1.5, mesh_id="M1")


def asked(world: World = PLAIN, tool: str = "a/B01T0", design: Design = DESIGN, object_id: int = 4, **setup: float):
    return build_request(world, tool, design, object_id, GraspSetup(**setup))


@pytest.fixture
def solver() -> Solver:
    return Solver()


def test_a_restarted_bench_finds_what_was_solved(tmp_path, solver):
    first = PhysicsCache(solver, PhysicsFiles(tmp_path))(asked())
    again = PhysicsCache(solver, PhysicsFiles(tmp_path))(asked())
    assert solver.n_asked == 1
    for name in ("time_s", "lift_mm", "force_n"):
        assert np.array_equal(getattr(again.trace, name), getattr(first.trace, name))
    assert (again.peak_force_n, again.n_dof, again.mesh_id) == (first.peak_force_n, first.n_dof, "M1")


@pytest.mark.parametrize(
    "other",
    [
        asked(World(theta=Theta(friction=0.5))),
        asked(World(mesh=WorldMesh(edge_mm=6.0))),
        asked(World(mesh=WorldMesh(layers=1))),
        asked(World(scatter=Scatter(thickness_sd_mm=0.1))),
        asked(World(scatter=Scatter(roll_sd_deg=9.0))),
        asked(World(hidden=(HIDDEN,))),
        asked(World(scatter=Scatter(placement_sd_mm=0.2))),
        asked(World(scatter=Scatter(tool_modulus_sd=0.1))),
        asked(design=DESIGN.model_copy(update={"rib_count": 6})),
        asked(design=GradedFinRay(**DESIGN.model_dump())),
        asked(object_id=5),
        asked(closed_gap_mm=15.0),
        asked(tip_below_mm=6.0),
    ],
)
def test_whatever_decides_the_force_is_part_of_the_question(tmp_path, solver, other):
    PhysicsFiles(tmp_path).put(asked(), solver(asked()))
    assert PhysicsFiles(tmp_path).get(other) is None


def test_names_decide_nothing_where_nothing_differs_from_tool_to_tool(tmp_path, solver):
    files = PhysicsFiles(tmp_path)
    files.put(asked(World(seed=1)), solver(asked()))
    assert files.get(asked(World(seed=2), tool="b/B09T3")) is not None
    files.put(asked(World(hidden=(HIDDEN,))), solver(asked()))
    assert files.get(asked(World(hidden=(HIDDEN,)), tool="b/B09T3")) is None, (
        "a hidden law may differ from tool to tool"
    )


def test_other_code_finds_nothing(tmp_path, solver, monkeypatch):
    PhysicsFiles(tmp_path).put(asked(), solver(asked()))
    monkeypatch.setattr(physics_files, "physics_id", lambda: "other")
    assert PhysicsFiles(tmp_path).get(asked()) is None


def test_a_name_that_two_questions_share_gives_no_wrong_answer(tmp_path, solver, monkeypatch):
    monkeypatch.setattr(physics_files, "content_id", lambda prefix, content: f"{prefix}same")
    files = PhysicsFiles(tmp_path)
    files.put(asked(), solver(asked()))
    assert files.get(asked(object_id=5)) is None
    assert files.get(asked()) is not None


@pytest.mark.parametrize("content", [b"", b'{"content": ', b"[]", b"\xff", b'{"content": {}}'])
def test_a_torn_file_is_solved_again(tmp_path, solver, content):
    PhysicsCache(solver, PhysicsFiles(tmp_path))(asked())
    (path,) = tmp_path.iterdir()
    path.write_bytes(content)
    PhysicsCache(solver, PhysicsFiles(tmp_path))(asked())
    PhysicsCache(solver, PhysicsFiles(tmp_path))(asked())
    assert solver.n_asked == 2


def test_a_death_while_writing_leaves_nothing_that_counts(tmp_path, solver, monkeypatch):
    def die(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", die)
        with pytest.raises(KeyboardInterrupt):
            PhysicsCache(solver, PhysicsFiles(tmp_path))(asked())
    assert list(tmp_path.iterdir()) == []
    assert PhysicsFiles(tmp_path).get(asked()) is None


def test_a_failure_is_remembered_by_the_process_only(tmp_path, solver):
    """It may have run out of time on a busy machine."""
    for _ in range(2):
        cache = PhysicsCache(solver, PhysicsFiles(tmp_path))
        for _ in range(2):
            with pytest.raises(SimulationFailed, match="no solution"):
                cache(asked(object_id=35))
    assert solver.n_asked == 2


def test_the_folder_is_bounded(tmp_path, solver):
    files = PhysicsFiles(tmp_path, max_files=3)
    for object_id in range(5):
        files.put(asked(object_id=object_id), solver(asked(object_id=object_id)))
        for age, path in enumerate(sorted(tmp_path.iterdir(), key=lambda p: p.stat().st_mtime_ns, reverse=True)):
            os.utime(path, (1e9 - 10 * age, 1e9 - 10 * age))
    assert [files.get(asked(object_id=o)) is not None for o in range(5)] == [False, False, True, True, True]


def test_without_a_place_to_write_the_bench_goes_on(tmp_path: Path, solver, caplog):
    (tmp_path / "physics").write_text("a file where the folder should be")
    cache = PhysicsCache(solver, PhysicsFiles(tmp_path / "physics"))
    assert cache(asked()).mesh_id == "M1"
    assert "is not kept" in caplog.text
