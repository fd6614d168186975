import io

import numpy as np
import pytest
import trimesh

from fast.models.design.finger import finger_bodies
from fast.models.design.sheet import batch_sheet_html
from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.design.tray import BED_MM, GAP_MM, PrintItem, tray_files, tray_layout
from fast.models.errors import UsageError


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


def test_a_batch_that_does_not_fit_is_refused(batch):
    with pytest.raises(UsageError, match="10 tools do not fit on a build plate of 200 x 150 mm"):
        tray_layout(batch, (200, 150))


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


def test_the_tray_says_of_what_each_body_is_made_and_an_independent_reader_takes_it_strictly(tmp_path):
    lib3mf = pytest.importorskip("lib3mf")
    files = tray_files([PrintItem("B01T0", BEST_PUBLISHED)])
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
        found[body.GetName()] = group.GetName(place)
    soft, base = "compliant (soft fingers)", "rigid (mounting bases)"
    assert found == {"B01T0a_compliant": soft, "B01T0a_rigid": base, "B01T0b_compliant": soft, "B01T0b_rigid": base}
    assert tray_files([PrintItem("B01T0", BEST_PUBLISHED)])["tray.3mf"] == files["tray.3mf"]


def test_sheet_names_every_tool_and_needs_no_network(batch):
    html = batch_sheet_html("quick/B03", batch, ["fast print confirm quick/B03 --operator NAME"])
    assert all(f"<h3>{item.label}</h3>" in html for item in batch)
    assert "fast print confirm quick/B03 --operator NAME" in html
    assert "http" not in html
    assert "<script" not in html


def test_sheet_escapes_what_people_type(batch):
    assert "<b>lab</b>" not in batch_sheet_html("<b>lab</b>", batch, [])


def test_sheet_gives_mass_and_volume_and_draws_fingers_at_one_scale(batch):
    html = batch_sheet_html("quick/B03", batch, [])
    bodies = finger_bodies(batch[0].design)
    assert f"{bodies.volume_mm3 / 1e3:.1f} cm&sup3;" in html
    assert html.count(' 37 122" role="img" aria-label="profile"') == len(batch)
