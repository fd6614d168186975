"""A deposit of measured data: a hand-off folder that describes itself, for Zenodo or any other archive.

The folder is a Frictionless data package (`datapackage.json`: columns, units, types, checksums) and an RO-Crate
(`ro-crate-metadata.json`: title, authors, licence, files). Both are open formats with libraries of their own.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.format import FILE_NAMES, THETA_COLUMNS
from fast.lake.handoff.import_folder import HandoffCounts
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, GraspRow
from fast.models.errors import MissingDependencyError, UsageError
from fast.models.units import spell_count, spell_name, unit_of

LICENCES = {
    "CC-BY-4.0": ("Creative Commons Attribution 4.0", "https://creativecommons.org/licenses/by/4.0/"),
    "CC0-1.0": ("Creative Commons Zero 1.0", "https://creativecommons.org/publicdomain/zero/1.0/"),
    "ODC-By-1.0": ("Open Data Commons Attribution 1.0", "https://opendatacommons.org/licenses/by/1-0/"),
}
_ABOUT = {
    "designs.csv": "fingers: the parameters of each design",
    "grasps.csv": "grasps, measured (`real`) and simulated (`sim`): tool, object, setup, bench, and how they ended",
    "traces.parquet": "samples of every grasp: time, lift of the gripper, force on it",
    "simulations.csv": "with which material, friction and Poisson ratio simulated grasps were made",
    "tools.csv": "what a person said and measured of printed tools",
    "materials.csv": "what was measured of the lots of printing material",
    "objects.json": "shapes of test objects beyond the 36 of FAST",
}
SHAPES = "shapes"  # folder of STL files
_INTEGERS = {"object_id", "repeat", "order", "attempt", "rib_count", "n"}
_NUMBERS = {"force_n", "value", "sd", *THETA_COLUMNS}
_README = """\
# {title}

{description}

| file | holds |
| --- | --- |
{files}

Numbers are in the units that end their names: `_mm`, `_n` (newton), `_s`, `_deg`, `_mpa`. `grasp_id`, `design_id` and
`tool_id` join the files. Forces are positive where the object pulls the gripper down. `started_at` is UTC.
`grasps.csv` says how each grasp was made where that differs from the usual: jaws 70 mm open and 16 mm closed, tips 5 mm
below the object, closing at 20 mm/s, lift at 5 mm/s.

`shapes/` holds each measured finger and each object on its mount (one without a floor alone) as STL files, in mm.

`datapackage.json` describes every column (Frictionless data package), `ro-crate-metadata.json` the whole (RO-Crate).
With Python, `pandas.read_csv("grasps.csv")` and `pandas.read_parquet("traces.parquet")` read it. FAST reads it back:
`fast lake import FOLDER`.

{authors}. Licence: {licence} ({url}). Written by FAST {version}.
"""


def publish(
    lake: Lake,
    directory: Path,
    *,
    title: str,
    authors: Sequence[str],
    licence: str = "CC-BY-4.0",
    campaign_id: str | None = None,
) -> HandoffCounts:
    """Write a deposit: the hand-off of a lake or of one campaign, with README, data package and RO-Crate.

    Raises:
        UsageError: title or authors are missing, the licence is unknown, the folder holds such files, or there is
            nothing to publish.
        MissingDependencyError: the libraries of the two formats are not installed.
    """
    if not title.strip() or not authors or not all(author.strip() for author in authors):
        raise UsageError("a deposit needs a title and at least one author; give --title and --author.")
    if licence not in LICENCES:
        raise UsageError(f"the licence `{licence}` is unknown; give one of {', '.join(LICENCES)}.")
    try:
        import frictionless  # noqa: F401
        import rocrate  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            f"`fast lake publish` needs {error.name}, which is not installed; pip install 'fast-gripper-lab[publish]'."
        ) from error
    there = [
        name for name in ("README.md", "datapackage.json", "ro-crate-metadata.json") if (directory / name).exists()
    ]
    if there:
        raise UsageError(f"{directory} already holds {', '.join(there)}; nothing was written: give a new folder.")
    counts = export_handoff(lake, directory, campaign_id=campaign_id)
    n = f"{counts.n_real} measured and {spell_count(counts.n_sim, 'simulated grasp')}"
    n += f" of {spell_count(counts.n_designs, 'soft finger')}"
    about = {
        "title": title.strip(),
        "description": f"Pull-off forces of soft gripper fingers: {n}.",
        "authors": [author.strip() for author in authors],
        "licence": licence,
        "version": current_provenance().code_version,
    }
    files = [directory / name for name in FILE_NAMES if (directory / name).exists()]
    files += _write_shapes(lake, directory / SHAPES, campaign_id)
    _write_readme(directory, files, about)
    _write_package(directory, files, about)
    _write_crate(directory, [*files, directory / "README.md", directory / "datapackage.json"], about)
    return counts


def _write_shapes(lake: Lake, folder: Path, campaign_id: str | None) -> list[Path]:
    """Write what was printed and what was grasped as STL files: measured designs by id, objects with mounts."""
    from fast.models.design.finger import finger_bodies  # loads meshing
    from fast.models.objects.catalogue import get_object
    from fast.models.objects.mount import printable_mesh, unmounted_mesh

    where = {"campaign_id": campaign_id} if campaign_id else {}
    measured = lake.rows(GraspRow, **where)
    wanted = sorted({row["design_id"] for row in measured})
    files = []
    folder.mkdir(exist_ok=True)
    for number, row in enumerate(lake.records(DesignRow, design_id=wanted), start=1):
        bodies = finger_bodies(row.design, str(number))  # the mark that a print carries
        for name, body in (("compliant", bodies.compliant), ("rigid", bodies.rigid)):
            files.append(folder / f"{row.design_id}_{name}.stl")
            body.export(files[-1])
    for object_id in sorted({row["object_id"] for row in measured}):
        try:
            name, mesh = f"object_{object_id}.stl", printable_mesh(get_object(object_id))
        except UsageError:  # a tube has no floor that a post could hold
            name, mesh = f"object_{object_id}_alone.stl", unmounted_mesh(get_object(object_id))
        files.append(folder / name)
        mesh.export(files[-1])
    return files


def _describe_file(path: Path) -> str:
    if path.parent.name != SHAPES:
        return _ABOUT[path.name]
    if path.stem.startswith("object_"):
        _, number, *alone = path.stem.split("_")
        return f"object {number} {'alone: it has no floor for a mount' if alone else 'on its mount'}, mm"
    design_id, _, part = path.stem.rpartition("_")
    return f"{part} part of a finger of design {design_id}, mm"


def _write_readme(directory: Path, files: Sequence[Path], about: dict[str, Any]) -> None:
    name, url = LICENCES[about["licence"]]
    text = _README.format(
        **about | {"authors": ", ".join(about["authors"]), "licence": name},
        url=url,
        files="\n".join(f"| `{path.name}` | {_ABOUT[path.name]} |" for path in files if path.name in _ABOUT),
    )
    (directory / "README.md").write_text(text, encoding="utf-8")


def _write_package(directory: Path, files: Sequence[Path], about: dict[str, Any]) -> None:
    """Write the Frictionless descriptor, checked by the library."""
    from frictionless import Package

    name, url = LICENCES[about["licence"]]
    descriptor = {
        "$schema": "https://datapackage.org/profiles/2.0/datapackage.json",
        "name": "fast-grasps",
        "title": about["title"],
        "description": about["description"],
        "contributors": [{"title": author, "roles": ["author"]} for author in about["authors"]],
        "licenses": [{"name": about["licence"], "title": name, "path": url}],
        "resources": [_describe(path) for path in files],
    }
    Package.from_descriptor(descriptor, basepath=str(directory))
    text = json.dumps(descriptor, indent=2, ensure_ascii=False) + "\n"
    (directory / "datapackage.json").write_text(text, encoding="utf-8")


def _describe(path: Path) -> dict[str, Any]:
    """Describe a file as a Frictionless resource: where, how large, and of tables which columns."""
    described: dict[str, Any] = {
        "name": path.name.lower().replace(".", "-").replace("_", "-"),
        "path": _path_in_deposit(path),
        "description": _describe_file(path),
        "format": path.suffix[1:],
        "bytes": path.stat().st_size,
        "hash": f"sha256:{_hash(path)}",
    }
    if path.suffix == ".csv":
        with path.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
        schema = {"fields": [_describe_column(name) for name in names], "missingValues": [""]}
        return described | {"type": "table", "mediatype": "text/csv", "encoding": "utf-8", "schema": schema}
    if path.suffix == ".parquet":
        columns = ", ".join(f"{name} ({unit_of(name) or 'text'})" for name in pq.read_schema(path).names)
        return described | {
            # As `parquet` the library reads it as a table without a schema, and finds types and checksum wrong.
            "format": "apache-parquet",
            "mediatype": "application/vnd.apache.parquet",
            "description": f"{described['description']}; columns: {columns}",
        }
    return described | {"mediatype": "model/stl" if path.suffix == ".stl" else "application/json"}


def _path_in_deposit(path: Path) -> str:
    return f"{SHAPES}/{path.name}" if path.parent.name == SHAPES else path.name


def _describe_column(name: str) -> dict[str, str]:
    """Describe a column: its type, and in words with its unit."""
    kind = "string"
    if name in _INTEGERS:
        kind = "integer"
    elif name in _NUMBERS or unit_of(name):
        kind = "number"
    return {"name": name, "type": kind, "title": spell_name(name, with_unit=True)}


def _write_crate(directory: Path, files: Sequence[Path], about: dict[str, Any]) -> None:
    """Write the RO-Crate's metadata file, by its library."""
    from rocrate.model.person import Person
    from rocrate.rocrate import ROCrate

    crate = ROCrate(version="1.1")  # what notebooks and archives read
    crate.metadata.extra_terms["sha256"] = "https://schema.org/sha256"  # which version 1.1 does not define
    crate.name, crate.description = about["title"], about["description"]
    crate.license = LICENCES[about["licence"]][1]
    crate.creator = [
        crate.add(Person(crate, f"#author-{number}", properties={"name": author}))
        for number, author in enumerate(about["authors"], start=1)
    ]
    for path in files:
        about_file = path.name if path.name in ("README.md", "datapackage.json") else _describe_file(path)
        properties = {"name": about_file, "contentSize": str(path.stat().st_size)}
        crate.add_file(path, dest_path=_path_in_deposit(path), properties=properties | {"sha256": _hash(path)})
    crate.metadata.write(directory)


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
