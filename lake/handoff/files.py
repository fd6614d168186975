"""Reading and checking the hand-off format: every fault with file, row, column, value and limit.

`read_handoff` only looks at the files; what must agree with rows already in a lake is checked in
`lake.handoff.import_folder`. Rows are counted as a spreadsheet shows them: the header is row 1.
"""

import json
from collections.abc import Callable, Set
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from fast.lake.handoff.fields import (
    NAME,
    fidelity,
    finite_number,
    integer,
    lab_name,
    number_of,
    number_or_nan,
    one_of,
    one_of_designs,
    optional,
    peak_force,
    time,
    word,
)
from fast.lake.handoff.format import (
    DESIGN_COLUMNS,
    END_COLUMNS,
    FAMILY_COLUMNS,
    GRASP_COLUMNS,
    HOW_COLUMNS,
    MATERIAL_COLUMNS,
    OBJECTS_FILE,
    RECIPE_COLUMNS,
    SETTING_COLUMNS,
    SIMULATION_COLUMNS,
    THETA_COLUMNS,
    TOOL_COLUMNS,
)
from fast.lake.handoff.samples import check_samples, needs_samples, read_traces
from fast.lake.handoff.tables import HandoffError, Reader, Table, new_id, read_csv
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.requests import PLACEMENT
from fast.models.design.families import read_design
from fast.models.design.fin_ray import FinRay
from fast.models.design.recipe import Recipe
from fast.models.design.space import PARAMETERS
from fast.models.errors import FastError, UsageError
from fast.models.material import MaterialMeasurement
from fast.models.objects.catalogue import OBJECTS, find_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspSetup, Placement, Theta, Trace

_MOST_SHAPES_BYTES = 400_000_000


@dataclass(frozen=True)
class HandoffGrasp:
    """One row of grasps.csv with its samples, and its row of simulations.csv if any."""

    grasp_id: str
    """As the file has it, after the lab's name."""
    design_id: str
    """Of designs.csv, or of the lake."""
    object_id: int
    """What was grasped."""
    repeat: int
    """Counts the grasps of a tool on the object."""
    fidelity: str
    """`real` or `sim`."""
    tool_id: str
    """Which print it was; empty of a simulation."""
    started_at: datetime | None
    """When, if it is said."""
    order: int | None
    """Place in its campaign, if it is said."""
    settings: dict[str, float]
    """How it was made, as the file gives it."""
    request_id: str
    """Of the search that asked for it; empty: none did."""
    trace: Trace | None
    """The samples, if there are any."""
    simulation: dict[str, float | None] | None
    """Columns of simulations.csv; None of a measured grasp."""
    lab: str | None = None
    """Who measured it, if it is said."""
    bench: str = "real"
    """Which bench made it."""
    world_hash: str | None = None
    """Of a virtual bench."""
    attempt: int = 0
    """Counts the tries at this grasp."""
    status: Literal["ok", "failed"] = "ok"
    """Whether it counts."""
    reason: str = ""
    """Why it failed."""
    peak_force_n: float | None = None
    """Of a grasp without samples."""
    tare_force_n: float | None = None
    """Gross force of the free gripper that was taken as zero; None: nobody said."""
    software: str = ""
    """Program that recorded it; empty: nobody said."""


@dataclass(frozen=True)
class Handoff:
    """Everything in a hand-off folder, checked."""

    designs: dict[str, Design]
    grasps: list[HandoffGrasp]
    objects: list[RigidObject]
    tools: list[dict[str, Any]]
    materials: list[MaterialRow]


def read_handoff(directory: Path, known_designs: Set[str]) -> Handoff:
    """Read a hand-off folder.

    `known_designs` are ids that grasps may name without a row in designs.csv.

    Raises:
        HandoffError: something is wrong; all faults are in it.
    """
    if not directory.is_dir():
        raise UsageError(f"{directory} is not a folder; give the folder that holds designs.csv and grasps.csv.")
    reader = Reader(directory)
    designs = _read_designs(reader)
    objects = _read_objects(reader)
    if reader.faults and not designs:
        raise HandoffError(directory, reader.faults)  # what names designs would be wrong in every row
    grasps = _read_grasps(reader, set(designs) | known_designs, {obj.object_id for obj in objects})
    if reader.faults and not grasps:
        raise HandoffError(directory, reader.faults)
    are_traced = any(needs_samples(values) for _, values in grasps.values()) or not grasps
    traces = read_traces(reader, set(grasps), is_needed=are_traced)
    simulations = _read_simulations(reader, grasps)
    tools, materials = _read_tools(reader), _read_materials(reader)
    check_samples(reader, grasps, traces)
    _find_repeated(reader, grasps)
    if reader.faults:
        raise HandoffError(directory, reader.faults)
    complete = [
        HandoffGrasp(
            **values,
            trace=traces[grasp_id][1] if grasp_id in traces else None,
            simulation=simulations.get(grasp_id),
        )
        for grasp_id, (_, values) in grasps.items()
    ]
    return Handoff(
        {design_id: design for design_id, design in designs.items() if design}, complete, objects, tools, materials
    )


def _read_designs(reader: Reader) -> dict[str, Design | None]:
    table = read_csv(reader, "designs.csv", (*DESIGN_COLUMNS, *FAMILY_COLUMNS), optional=FAMILY_COLUMNS)
    designs: dict[str, Design | None] = {}
    for place in range(len(table.rows)):
        design_id = new_id(reader, table, "design_id", place, designs)
        if "family" in table.columns and table.columns["family"][place]:
            if design_id:
                designs[design_id] = _design_of_family(reader, table, place)
            continue
        values = {name: reader.read_field(table, name, place, number_of(FinRay, name)) for name in PARAMETERS}
        if design_id:
            designs[design_id] = None if None in values.values() else FinRay.model_validate(values)
    return designs


def _design_of_family(reader: Reader, table: Table, place: int) -> Design | None:
    """Return a design whose row names its family."""
    cells = {name: table.columns.get(name, [""] * len(table.rows))[place] for name in FAMILY_COLUMNS}
    try:
        values = json.loads(cells["parameters_json"])
        if not isinstance(values, dict):
            raise ValueError("not an object")
        return read_design(cells["family"], values)
    except FastError as error:
        reader.fault(table.name, table.rows[place], "family", cells["family"], str(error))
    except (ValueError, RecursionError):
        limit = "must be a JSON object with the parameters of the family."
        reader.fault(table.name, table.rows[place], "parameters_json", cells["parameters_json"][:80], limit)
    return None


def _read_objects(reader: Reader) -> list[RigidObject]:
    """Read own objects of the folder, their numbers worked out again; none where there is no file of them."""
    path = reader.directory / OBJECTS_FILE
    if not path.exists():
        return []
    try:
        if path.stat().st_size > _MOST_SHAPES_BYTES:
            raise ValueError("too large")
        entries = [
            (int(one["object_id"]), str(one["name"]), str(one["shape"])) for one in json.loads(path.read_bytes())
        ]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        limit = "must be a JSON list of objects, each with object_id, name and shape."
        reader.fault(OBJECTS_FILE, None, None, None, limit)
        return []
    from fast.models.objects.own import object_of_shape  # compiles

    found = []
    for number, (object_id, name, shape) in enumerate(entries, start=1):
        try:
            made = object_of_shape(name, shape, OBJECTS_FILE)
        except FastError as error:
            reader.fault(OBJECTS_FILE, None, f"entry {number}", name, str(error))
            continue
        if made.object_id != object_id:
            limit = f"is not the number of this shape, {made.object_id}; export the object again."
            reader.fault(OBJECTS_FILE, None, "object_id", object_id, limit)
        found.append(made)
    return found


def _read_object_id(own: set[int]) -> Callable[[str], int]:
    """Make a reader of an object's number: one of the 36, of the folder, or one that is known here."""
    number = integer(0, None)

    def read(text: str) -> int:
        object_id = int(number(text))
        if object_id in own or find_object(object_id) is not None:
            return object_id
        raise ValueError(
            f"must be 0 to {len(OBJECTS) - 1}, or an own object of {OBJECTS_FILE} or of this lake; add it with "
            "`fast objects add`."
        )

    return read


def _read_grasps(reader: Reader, design_ids: set[str], own_objects: set[int]) -> dict[str, tuple[int, dict[str, Any]]]:
    """Read row number and cells of each grasp, by id."""
    table = read_csv(reader, "grasps.csv", (*GRASP_COLUMNS, *HOW_COLUMNS, *END_COLUMNS), (*HOW_COLUMNS, *END_COLUMNS))
    grasps: dict[str, tuple[int, dict[str, Any]]] = {}
    readers: dict[str, Callable[[str], Any]] = {
        "design_id": one_of_designs(design_ids),
        "object_id": _read_object_id(own_objects),
        "repeat": integer(0, None),
        "fidelity": fidelity,
        "tool_id": str,
        "started_at": time,
        "order": optional(integer(None, None)),
    }
    for place in range(len(table.rows)):
        grasp_id = new_id(reader, table, "grasp_id", place, grasps)
        values = {name: reader.read_field(table, name, place, read) for name, read in readers.items()}
        given = [name for name in SETTING_COLUMNS if name in table.columns]
        found = {name: reader.read_field(table, name, place, SETTING_FIELDS[name]) for name in given}
        values["settings"] = {name: value for name, value in found.items() if value is not None}
        values["request_id"] = table.columns["request_id"][place] if "request_id" in table.columns else ""
        for name, read in END_FIELDS.items():
            if name in table.columns:
                values[name] = reader.read_field(table, name, place, read)
        if values["fidelity"] == "real" and not values["tool_id"]:
            reader.fault(table.name, table.rows[place], "tool_id", "", "must name the tool of a measured grasp.")
        if grasp_id:
            grasps[grasp_id] = table.rows[place], {"grasp_id": grasp_id, **values}
    return grasps


END_FIELDS: dict[str, Callable[[str], Any]] = {
    "lab": lab_name,
    "bench": optional(word(NAME, "must be virtual, real, or a name of at most 41 of a-z, 0-9 and -."), "real"),
    "world_hash": optional(word("[0-9A-Za-z]{1,64}", "must be a hash of letters and digits, or empty.")),
    "attempt": optional(integer(0, 1000), 0),
    "status": one_of("ok", "failed"),
    "reason": str,
    "peak_force_n": optional(peak_force),
    "tare_force_n": optional(finite_number),
    "software": str,
}
SETTING_FIELDS = {
    name: optional(number_of(Placement if name in PLACEMENT else GraspSetup, name)) for name in SETTING_COLUMNS
}
SIMULATION_FIELDS = {name: optional(number_of(Theta, name)) for name in THETA_COLUMNS}
SIMULATION_FIELDS["contact_force_n"] = optional(finite_number)


def _read_tools(reader: Reader) -> list[dict[str, Any]]:
    """Read what the folder says of tools, by column; checked as the lake checks them."""
    if not (reader.directory / "tools.csv").exists():
        return []
    known = (*TOOL_COLUMNS, *RECIPE_COLUMNS)
    table = read_csv(reader, "tools.csv", known, optional=known[2:])
    found: dict[str, dict[str, Any]] = {}
    numbers = [name for name in TOOL_COLUMNS if name.startswith("measured_") or name == "hardness_shore_a"]
    for place in range(len(table.rows)):
        tool_id = new_id(reader, table, "tool_id", place, found)
        values: dict[str, Any] = {name: cells[place] for name, cells in table.columns.items()}
        values |= {name: reader.read_field(table, name, place, optional(_size)) for name in numbers if name in values}
        if "status" in values:
            values["status"] = reader.read_field(table, "status", place, one_of("printed", "rejected"))
        if "recipe_json" in values:
            values["recipe_json"] = reader.read_field(table, "recipe_json", place, optional(_recipe, ""))
        if tool_id:
            found[tool_id] = values
    return list(found.values())


def _recipe(text: str) -> str:
    try:
        return Recipe.model_validate_json(text).content_json
    except ValidationError as error:
        raise ValueError("must be a recipe as JSON, as `fast lake export` writes it, or empty.") from error


def _size(text: str) -> float:
    value = number_or_nan(text)
    if not 0 < value <= 1000:
        raise ValueError("must be a number above 0 and at most 1000, or empty.")
    return value


def _read_materials(reader: Reader) -> list[MaterialRow]:
    """Read what was measured of lots of material."""
    if not (reader.directory / "materials.csv").exists():
        return []
    table = read_csv(reader, "materials.csv", MATERIAL_COLUMNS, optional=("sd", "n"))
    found = []
    for place, row in enumerate(table.rows):
        cells = {name: column[place] for name, column in table.columns.items() if column[place]}
        lot, quantity = cells.pop("lot", ""), cells.pop("quantity", "")
        try:
            found.append(MaterialRow.of(lot, quantity, MaterialMeasurement.model_validate(cells)))
        except ValidationError as error:
            wrong = error.errors()[0]
            name = str(wrong["loc"][0])
            reader.fault("materials.csv", row, name, cells.get(name, ""), f"{wrong['msg']}.")
    return found


def _read_simulations(
    reader: Reader, grasps: dict[str, tuple[int, dict[str, Any]]]
) -> dict[str, dict[str, float | None]]:
    if not (reader.directory / "simulations.csv").exists():
        return {}
    table = read_csv(reader, "simulations.csv", SIMULATION_COLUMNS, optional=SIMULATION_COLUMNS[1:])
    found: dict[str, dict[str, float | None]] = {}
    for place, row in enumerate(table.rows):
        grasp_id = new_id(reader, table, "grasp_id", place, found)
        if grasp_id and grasps.get(grasp_id, (0, {}))[1].get("fidelity") != "sim":
            reader.fault(table.name, row, "grasp_id", grasp_id, "must be a grasp of grasps.csv with fidelity sim.")
        present = [name for name in SIMULATION_COLUMNS[1:] if name in table.columns]
        values = {name: reader.read_field(table, name, place, SIMULATION_FIELDS[name]) for name in present}
        found[grasp_id or f"row {row}"] = values
    return found


def _find_repeated(reader: Reader, grasps: dict[str, tuple[int, dict[str, Any]]]) -> None:
    """Name measured grasps that are there twice: one tool, object and repeat, made the same way."""
    first: dict[tuple[object, ...], int] = {}
    for row, values in grasps.values():
        if values["fidelity"] != "real":
            continue
        how = tuple(sorted(values["settings"].items()))
        key = (*(values[name] for name in ("tool_id", "design_id", "object_id", "repeat", "request_id")), how)
        key = (*key, values.get("attempt", 0))
        other = first.setdefault(key, row)
        if other != row:
            limit = f"is there twice for this tool and object, first in row {other}; number the repeats."
            reader.fault("grasps.csv", row, "repeat", values["repeat"], limit)
