import io
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fast.models.design.recipe import Recipe
from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.design.tray import BED_MM, GAP_MM, PrintItem, name_trays, tray_files, tray_layout
from fast.models.errors import UsageError

RECIPES = Path(__file__).parents[3] / "recipes"
TPU = Recipe(name="fdm-tpu", **tomllib.loads((RECIPES / "fdm-tpu.toml").read_text()))


@pytest.fixture
def batch():
    designs = random_designs(10, np.random.default_rng(5))
    return [PrintItem(f"B03T{slot}", design) for slot, design in enumerate(designs)]


def test_ten_tools_fit_without_overlap(batch):
    layout = tray_layout(batch)
    assert len(layout) == 20
    boxes = [(p.x_mm, p.y_mm, p.x_mm + p.length_mm, p.y_mm + p.height_mm) for p in layout]
    assert all(x1 <= BED_MM[0] - GAP_MM and y1 <= BED_MM[1] - GAP_MM for _, _, x1, y1 in boxes)
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert a[0] >= b[2] + GAP_MM or b[0] >= a[2] + GAP_MM or a[1] >= b[3] + GAP_MM or b[1] >= a[3] + GAP_MM


def test_a_batch_takes_as_many_plates_as_it_needs(batch):
    layout = tray_layout(batch, (250, 210))
    assert name_trays(layout) == [f"tray-{number}.3mf" for number in range(1, 2 + layout[-1].plate)]
    assert len(layout) == 20
    assert all(first.plate == second.plate for first, second in zip(layout[::2], layout[1::2], strict=True))
    for plate in range(1 + layout[-1].plate):
        spans = sorted((p.x_mm, p.x_mm + p.length_mm) for p in layout if p.plate == plate)  # one row of fingers a plate
        assert spans
        assert spans[-1][1] <= 250 - GAP_MM
        assert all(right[0] - left[1] == pytest.approx(GAP_MM) for left, right in pairwise(spans))


def test_a_finger_larger_than_the_plate_is_refused(batch):
    with pytest.raises(UsageError, match="a finger of B03T0 needs .* the plate has 100 x 100 mm: give a larger one"):
        tray_layout(batch, (100, 100))


def test_files_hold_every_body_and_the_tray_lies_on_the_plate():
    files = tray_files([PrintItem("B01T0", BEST_PUBLISHED), PrintItem("B01T1", BEST_PUBLISHED)])
    assert set(files) == {
        "B01T0_compliant.stl", "B01T0_rigid.stl", "B01T1_compliant.stl", "B01T1_rigid.stl", "tray.3mf",
    }  # fmt: skip
    body = trimesh.load(io.BytesIO(files["B01T0_compliant.stl"]), file_type="stl")
    assert body.is_volume
    scene = trimesh.load(io.BytesIO(files["tray.3mf"]), file_type="3mf")
    assert len(scene.geometry) == 8
    low, high = scene.bounds
    assert low == pytest.approx([GAP_MM, GAP_MM, 0], abs=1e-3)
    assert high[2] == pytest.approx(BEST_PUBLISHED.width_mm, abs=1e-3)


@pytest.mark.parametrize("recipe", [None, TPU], ids=["no recipe", "fdm-tpu"])
def test_the_tray_says_of_what_each_body_is_made_and_an_independent_reader_takes_it_strictly(tmp_path, recipe):
    lib3mf = pytest.importorskip("lib3mf")
    files = tray_files([PrintItem("B01T0", BEST_PUBLISHED)], recipe)
    (tmp_path / "tray.3mf").write_bytes(files["tray.3mf"])
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tmp_path / "tray.3mf"))
    assert reader.GetWarningCount() == 0
    groups = model.GetBaseMaterialGroups()
    assert groups.MoveNext()
    group = groups.GetCurrentBaseMaterialGroup()
    found, bodies = {}, model.GetMeshObjects()
    while bodies.MoveNext():
        body = bodies.GetCurrentMeshObject()
        _, place, has_material = body.GetObjectLevelProperty()
        assert has_material
        assert body.IsManifoldAndOriented()
        colour = group.GetDisplayColor(place)
        found[body.GetName()] = group.GetName(place), f"#{colour.Red:02X}{colour.Green:02X}{colour.Blue:02X}"
    soft, base = ("compliant (soft fingers)", "#303030"), ("rigid (mounting bases)", "#F0F0F0")
    if recipe is not None:
        soft, base = ("TPU, Shore A 85 (compliant)", "#1F4E79"), ("PETG (rigid)", "#F0F0F0")
    assert found == {"B01T0a_compliant": soft, "B01T0a_rigid": base, "B01T0b_compliant": soft, "B01T0b_rigid": base}
    # Bodies of a finger are one part, which a printer's program does not take apart; each part lies on the plate once.
    parts, n_parts = model.GetComponentsObjects(), 0
    while parts.MoveNext():
        part, n_parts = parts.GetCurrentComponentsObject(), n_parts + 1
        assert part.GetComponentCount() == 2
    assert n_parts == 2
    placed, n_placed = model.GetBuildItems(), 0
    while placed.MoveNext():
        n_placed += 1
    assert n_placed == 2
    assert tray_files([PrintItem("B01T0", BEST_PUBLISHED)], recipe)["tray.3mf"] == files["tray.3mf"]
