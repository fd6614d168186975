"""`fast objects`: the 36 test objects and own ones: list, check, draw, print, add."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, OBJECT_HELP, AsJson, LakePath, make_app, show, table_text, write_out
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.models.objects.rigid import RigidObject

app = make_app(name="objects", help="List, check, draw and print test objects, and add own ones.")

Files = Annotated[list[Path], Parameter(help="Mesh (.stl, .obj, .3mf, .ply, in mm) or .toml file of an own object.")]
Named = Annotated[list[str], Parameter(help=OBJECT_HELP)]


@app.command(name="list")
def list_objects(*, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """List the 36 objects and the own ones of the lake, with their sizes and planes of symmetry."""
    from fast.models.objects.catalogue import OBJECTS
    from fast.tasks.objects import own_objects

    rows = [_row(obj) for obj in (*OBJECTS, *own_objects(lake))]
    show(rows, table_text(rows), json)


@app.command
def check(files: Files, *, json: AsJson = False) -> None:
    """Say what the program makes of own objects, and whether the fingers can hold them. Nothing is written."""
    from fast.tasks.objects import read_objects, warn_of_shape

    found = read_objects(files)
    for obj in found:
        warn_of_shape(obj)
    rows = [{**_row(obj), "remarks": _remarks(obj)} for obj in found]
    lines = [f"{row['name']}: {remark}" for row in rows for remark in row["remarks"]]
    plain = [{name: value for name, value in row.items() if name != "remarks"} for row in rows]
    show(rows, "\n".join([table_text(plain), *lines]), json)


@app.command
def add(files: Files, *, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Write own objects to the lake, where they are known by name and number from then on."""
    from fast.lake.provenance import current_provenance
    from fast.lake.tables.campaign import ObjectRow
    from fast.tasks.objects import check_names, own_objects, read_objects, warn_of_shape

    found, known = read_objects(files), own_objects(lake)
    check_names(found, known)
    for obj in found:
        warn_of_shape(obj)
    earlier = {obj.object_id: obj.name for obj in known}
    opened = open_lake(lake, create=True)
    opened.append([ObjectRow.of(obj) for obj in found], current_provenance())
    opened.close()
    rows = [_row(obj) for obj in found]
    lines = []
    for obj in found:
        old = earlier.get(obj.object_id, obj.name)
        told = "" if old == obj.name else f", and no longer called {old}"
        lines.append(f"{obj.name} is object {obj.object_id} of {lake}{told}")
    show(rows, "\n".join(lines), json)


@app.command
def draw(
    objects: Named,
    *,
    out: Annotated[Path, Parameter(help="PNG file to write.")],
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Draw objects as they stand on the bench, seen from the front right; the fingers close from left and right."""
    from fast.flows.report.mesh_picture import draw_objects
    from fast.tasks.objects import find_object

    found = [find_object(text, lake) for text in objects]
    _check_suffix(out, ".png")
    picture = BytesIO()
    draw_objects(found).savefig(picture, format="png")
    write_out("--out", out, picture.getvalue())
    show({"written": str(out), "objects": [obj.object_id for obj in found]}, f"wrote {out}", json)


@app.command(name="print")
def print_object(
    object: Annotated[str, Parameter(help=OBJECT_HELP)],
    *,
    out: Annotated[Path, Parameter(help="STL file to write.")],
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Write an object on its mount, as one body to print."""
    from fast.models.objects.mount import printable_mesh
    from fast.tasks.objects import find_object

    found = find_object(object, lake)
    _check_suffix(out, ".stl")
    mesh = printable_mesh(found)
    write_out("--out", out, cast(bytes, mesh.export(file_type="stl")))
    size = " x ".join(f"{mm:.1f}" for mm in mesh.extents)
    data = {"written": str(out), "size_mm": [float(mm) for mm in mesh.extents], "volume_mm3": float(mesh.volume)}
    show(data, f"wrote {out}: {found.name} on its mount, {size} mm, {mesh.volume / 1000:.1f} cm3", json)


def _row(obj: "RigidObject") -> dict[str, Any]:
    size_x_mm, size_y_mm, height_mm = (round(mm, 2) for mm in obj.size_mm)
    mirrors = "".join(axis for axis, has in (("x", obj.mirror_x), ("y", obj.mirror_y)) if has)
    return {
        "object_id": obj.object_id,
        "name": obj.name,
        "class": obj.object_class,
        "size_x_mm": size_x_mm,
        "size_y_mm": size_y_mm,
        "height_mm": height_mm,
        "mirrors": mirrors,
        "round": obj.is_round,
    }


def _remarks(obj: "RigidObject") -> list[str]:
    """List what a person should know before it is grasped with the default setup."""
    from fast.models.records import GraspSetup

    setup, size_x_mm = GraspSetup(), obj.size_mm[0]
    remarks = []
    if size_x_mm <= setup.closed_gap_mm:
        remarks.append(
            f"it is {size_x_mm:.1f} mm wide in x, the jaws stop {setup.closed_gap_mm:g} mm apart: only fingers that "
            "bend inwards touch it; set grasp.closed_gap_mm lower"
        )
    if not obj.mirror_y:
        remarks.append(
            "it is not its own mirror image in y = 0: a simulated grasp takes several times as long as a symmetric one"
        )
    return remarks or ["the fingers reach it"]


def _check_suffix(out: Path, suffix: str) -> None:

    if out.suffix.lower() != suffix:
        raise UsageError(f"--out `{out}` must end in {suffix}; change it.")
