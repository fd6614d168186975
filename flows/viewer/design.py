"""Rerun recording of a design: its two fingers, the printed parts, the mesh of the simulator, and the print tray."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh

from fast.flows.report.style import BEST, COMPLIANT, FAINT, FIRST, INK, RIGID
from fast.flows.viewer.scene import SIDES, build_fingers, flatten_mesh, marked_bodies, rgb
from fast.flows.viewer.stream import fit_eye, lay_out, open_recording, read_design
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, ToolRow
from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.tray import BED_MM, PrintItem, lying, tray_layout
from fast.models.ids import tool_label
from fast.models.records import Design, GraspSetup
from fast.models.simulation.body.shape_functions import HEXAHEDRON_EDGES, TETRAHEDRON_EDGES, WEDGE_EDGES
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.output.surface import skin_of
from fast.models.simulation.version import MeshSettings
from fast.models.units import spell_name

_SIDE = (-0.3, -1.0, 0.2)  # from which the ribs are seen
APART_MM = 25.0  # between the printed bodies in the view of the parts
_EDGES = {"C3D4": TETRAHEDRON_EDGES, "C3D10": TETRAHEDRON_EDGES, "C3D15": WEDGE_EDGES, "C3D20R": HEXAHEDRON_EDGES}


def write_design_recording(lake: Lake, design_id: str, path: Path) -> Path:
    """Write a design: both fingers at the open gap, the bodies apart, the solid elements, and the print tray.

    The tray is that of the batch in which the design was mounted, or holds the design alone.

    Raises:
        UsageError: there is no such design, or the file cannot be written.
    """
    design = read_design(lake, design_id)
    items, what = _tray_items(lake, design)
    mesh = build_mesh(design, MeshSettings(), full_width=True)
    with open_recording(
        f"design {design_id}", path, _blueprint(design, what, mesh), scenes=("cell", "parts", "mesh", "tray")
    ) as stream:
        stream.log("about", rr.TextDocument(_about(design, what, mesh), media_type="text/markdown"), static=True)
        _send_fingers(stream, design)
        _send_parts(stream, finger_bodies(design))
        _send_mesh(stream, mesh)
        _send_tray(stream, items, design)
    return path


def _send_fingers(stream: rr.RecordingStream, design: Design) -> None:
    """Send both fingers, undeformed, at the open gap of the default setup."""
    setup = GraspSetup()
    for side, sign in SIDES.items():
        place = [sign * setup.open_gap_mm / 2, 0.0, design.height_mm - setup.tip_below_mm]
        stream.log(f"cell/fingers/{side}", rr.Transform3D(translation=place), static=True)
    for name, mesh in build_fingers(design).items():
        stream.log(f"cell/fingers/{name}", mesh, static=True)


def find_edges(mesh: SolidMesh) -> np.ndarray:
    """Find the edges (e, 2) of all elements as pairs of corner nodes, each once."""
    pairs = [block.connectivity[:, np.array(_EDGES[block.kind])].reshape(-1, 2) for block in mesh.blocks]
    return np.unique(np.sort(np.vstack(pairs), axis=1), axis=0)


def _tray_items(lake: Lake, design: Design) -> tuple[list[PrintItem], str]:
    """Return what was printed together with the design, and its name."""
    tools = lake.records(ToolRow, design_id=design.design_id)
    if not tools:
        return [PrintItem("alone", design)], "this design alone"
    tool = tools[-1]
    batch = lake.records(ToolRow, campaign_id=tool.campaign_id, batch=tool.batch)
    designs = {row.design_id: row.design for row in lake.records(DesignRow, design_id=[t.design_id for t in batch])}
    items = [PrintItem(tool_label(t.batch, t.slot), designs[t.design_id]) for t in batch]
    return items, f"batch {tool.campaign_id}/B{tool.batch:02d}"


def _send_parts(stream: rr.RecordingStream, bodies: FingerBodies) -> None:
    """Send the compliant and rigid body of one finger as they stand on a table, the rigid one drawn below."""
    stream.log("parts/compliant", flatten_mesh(bodies.compliant, COMPLIANT), static=True)
    rigid = bodies.rigid.copy()
    rigid.apply_translation([0.0, 0.0, -APART_MM])
    stream.log("parts/rigid", flatten_mesh(rigid, RIGID), static=True)


def _send_mesh(stream: rr.RecordingStream, mesh: SolidMesh) -> None:
    """Send elements as lines over their surface, so that one sees which are in front."""
    skin = skin_of(mesh)
    surface = trimesh.Trimesh(skin.vertices(mesh.nodes), skin.triangles, process=False)
    stream.log("mesh/surface", flatten_mesh(surface, COMPLIANT), static=True)
    lines, width = mesh.nodes[find_edges(mesh)], rr.Radius.ui_points(0.5)
    stream.log("mesh/elements", rr.LineStrips3D(lines, colors=rgb(INK), radii=width), static=True)
    held = mesh.nodes[mesh.base_nodes]
    stream.log("mesh/clamped", rr.Points3D(held, colors=rgb(FIRST), radii=0.7), static=True)


def _send_tray(stream: rr.RecordingStream, items: list[PrintItem], design: Design) -> None:
    """Send everything that was printed together; the fingers of the design itself stand out."""
    plate = np.array([*BED_MM, 2.0])
    sheet = rr.Boxes3D(centers=plate / 2 - [0, 0, 2], sizes=plate, colors=rgb(FAINT), fill_mode="solid")
    stream.log("tray/plate", sheet, static=True)
    bodies = {item.label: marked_bodies(item.design, item.label) for item in items}
    for number, place in enumerate(tray_layout(items)):
        finger = bodies[place.label]
        name = f"tray/{place.label}/{'ab'[number % 2]}"
        colour = BEST if place.design == design else COMPLIANT
        for part, body, shade in (("compliant", finger.compliant, colour), ("rigid", finger.rigid, RIGID)):
            placed = body.copy()
            placed.apply_transform(lying(place))
            placed.apply_translation([place.plate * (BED_MM[0] + 20.0), 0.0, 0.0])  # plates stand side by side
            stream.log(f"{name}_{part}", flatten_mesh(placed, shade), static=True)


def _about(design: Design, tray: str, mesh: SolidMesh) -> str:
    rows = "\n".join(
        f"| {spell_name(name, with_unit=True)} | {_format(getattr(design, name))} |"
        for name in type(design).model_fields
    )
    return (
        f"# {design.design_id}\n\n| parameter | value |\n|---|---|\n{rows}\n\n{mesh.n_elements} solid elements of the "
        f"production tier, clamped at the orange dots. Tray: {tray}; fingers of this design are dark blue."
    )


def _blueprint(design: Design, tray: str, mesh: SolidMesh) -> rrb.Blueprint:
    length, half, height = design.length_mm, design.width_mm / 2, design.height_mm
    gap = GraspSetup().open_gap_mm / 2 + length
    plate = ([0.0, 0.0, 0.0], [*BED_MM, 40.0])
    upright = ([0.0, -half, 0.0], [length, half, height])
    apart = ([0.0, -half, -APART_MM - 6.0], upright[1])
    hanging = ([-gap, -half, -5.0], [gap, half, height])
    views = (
        ("cell", "Fingers, open (mm)", fit_eye(*hanging, (0.25, -1.0, 0.15))),
        ("parts", "Parts: compliant and rigid body (mm)", fit_eye(*apart, (-0.45, -1.0, 0.3))),
        ("mesh", f"Mesh: {mesh.n_elements} elements, clamped nodes as dots (mm)", fit_eye(*upright, _SIDE)),
        ("tray", f"Print tray: {tray} (mm)", fit_eye(*plate, (0.0, -0.7, 1.0))),
    )
    shown = [
        rrb.Spatial3DView(origin=origin, name=name, eye_controls=eye, background=[255, 255, 255], line_grid=False)
        for origin, name, eye in views
    ]
    about = rrb.TextDocumentView(origin="about", name="About")
    return lay_out(
        rrb.Horizontal(rrb.Grid(*shown, grid_columns=2), about, column_shares=[4, 1]),
        rrb.TimePanel(state="hidden"),
    )


def _format(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
