"""Runs the code of docs/how-to/use-python.md that simulates a grasp, as it is printed there."""

import re
from pathlib import Path
from typing import Any

import pytest
import trimesh

from tests.docs.pages import DOCS, blocks_of

BLOCKS = [block.text for block in blocks_of(DOCS / "how-to" / "use-python.md", "python") if "lake" not in block.text]
TABLE = (DOCS / "how-to" / "use-python.md").read_text(encoding="utf-8").split("## Simulate a grasp")[1]


def run_blocks() -> dict[str, Any]:
    """Names after the blocks that simulate, in order."""
    names: dict[str, Any] = {}
    for block in BLOCKS:
        if "simulate_grasp" in block:
            exec(compile(block, "use-python.md", "exec"), names)
    return names


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    return run_blocks()


def test_the_first_block_has_at_most_ten_lines() -> None:
    (first,) = [block for block in BLOCKS if "recording.add" in block]
    assert len([line for line in first.splitlines() if line]) <= 10


def test_arrays_have_the_shapes_of_the_table(names: dict[str, Any]) -> None:
    closed, result = names["closed"], names["result"]
    rows = [line for line in TABLE.splitlines() if re.match(r"\| `(closed|result)", line)]
    assert len(rows) == 9
    sizes = {"n": len(result.trace.time_s), "nodes": len(closed.mesh.nodes), "c": len(closed.pressure)}
    for row in rows:
        arrays, shape = (cell.strip() for cell in row.split("|")[1:3])
        wanted = tuple(sizes.get(word) or int(word) for word in shape.split(" x ")) if shape else None
        stem = ""
        for code in re.findall(r"`([^`]+)`", arrays):
            stem = code.rpartition(".")[0] or stem
            value = eval(stem + code if code.startswith(".") else code, {"closed": closed, "result": result})
            assert wanted is None or value.shape == wanted, code
    assert sum(len(block.connectivity) for block in closed.mesh.blocks) == closed.mesh.n_elements


def test_pressure_times_area_is_the_contact_force(names: dict[str, Any]) -> None:
    """In the object frame; contact forces of a half finger are half of those of the clamp."""
    closed, result = names["closed"], names["result"]
    share = 2.0 if closed.mesh.is_half else 1.0
    normal_n = closed.contact_areas[:, None] * closed.scale * closed.pressure[:, None] * closed.contact_normals
    friction_n = closed.contact_areas[:, None] * closed.scale * closed.traction
    assert closed.nodes[:, 1].max() <= 1e-9
    assert share * (normal_n + friction_n).sum(axis=0)[0] == pytest.approx(result.contact_force_n, abs=0.02)
    assert result.trace.force_n.max() == result.peak_force_n


def test_an_object_of_ones_own_is_grasped_where_it_was_placed(names: dict[str, Any]) -> None:
    shifted, version = names["shifted"], names["version"]
    central = names["simulate_grasp"](names["BEST_PUBLISHED"], names["egg"], version)
    assert names["egg"].height_mm == pytest.approx(48.0)
    assert shifted.peak_force_n > 1.0
    assert shifted.peak_force_n != central.peak_force_n


def test_the_deformed_surface_is_a_file(names: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (block,) = [block for block in BLOCKS if "finger.ply" in block]
    exec(compile(block, "use-python.md", "exec"), dict(names))
    surface = trimesh.load_mesh(tmp_path / "finger.ply")
    assert surface.is_watertight
    assert surface.volume > 10_000.0  # mm3, of a whole finger
