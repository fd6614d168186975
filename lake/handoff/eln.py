"""A deposit as one file for electronic lab notebooks: the ELN Consortium's `.eln`, a zipped RO-Crate.

Source: the consortium's specification (github.com/TheELNConsortium/TheELNFileFormat, of August 2026): one folder at the
root, named like the file; in it `ro-crate-metadata.json` and one folder for each data set. A notebook imports the
data sets that the root lists, so the files of a deposit are in one of their own.
"""

import json
import os
import zipfile
from pathlib import Path
from typing import Any

from fast.models.errors import UsageError

METADATA = "ro-crate-metadata.json"
_DATA = "./grasps/"
_NOTEBOOK = {"@id": "#fast", "@type": "Organization", "name": "FAST, an open lab platform for soft gripper design"}
_ENCODINGS = {
    ".csv": "text/csv",
    ".json": "application/json",
    ".md": "text/markdown",
    ".parquet": "application/vnd.apache.parquet",
    ".stl": "model/stl",
}


def check_eln_path(path: Path) -> None:
    """Refuse a name that notebooks do not know, a file that is there, and a folder that cannot take it.

    Raises:
        UsageError: says which.
    """
    if path.suffix != ".eln":
        raise UsageError(f"{path} is no name of a notebook's file, which ends with .eln; give another.")
    if path.exists():
        raise UsageError(f"{path} is there already; nothing was written: give another name.")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"{path.parent} is no folder that can be written; nothing was written: give another --eln.")


def write_eln(deposit: Path, path: Path) -> None:
    """Pack a deposit that `publish` wrote into `path`, visible whole or not at all.

    Raises:
        UsageError: the file cannot be written.
    """
    crate = json.loads((deposit / METADATA).read_text(encoding="utf-8"))
    crate["@graph"] = _rearrange(crate["@graph"])
    temporary = path.with_name(f".{path.name}.part")
    try:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{path.stem}/{METADATA}", json.dumps(crate, indent=1, ensure_ascii=False))
            for file in sorted(file for file in deposit.rglob("*") if file.is_file() and file.name != METADATA):
                archive.write(file, f"{path.stem}/{_DATA[2:]}{file.relative_to(deposit).as_posix()}")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise UsageError(f"{path} cannot be written ({error.strerror}); give another --eln.") from error


def _rearrange(graph: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Turn the graph of a deposit (files at its root) into that of a notebook's file (files in the root's data set)."""
    by_id = {node["@id"]: node for node in graph}
    root = by_id.pop("./")
    descriptor = by_id.pop(METADATA)
    files = [_describe(node) for node in by_id.values() if node["@type"] == "File"]
    others = [node for node in by_id.values() if node["@type"] != "File"]
    authors = root["creator"] if isinstance(root["creator"], list) else [root["creator"]]
    moment = root["datePublished"]
    data = {
        "@id": _DATA,
        "@type": "Dataset",
        "name": root["name"],
        "text": f"<p>{root['description']}</p>",
        "author": authors[0],
        "creator": authors,
        "dateCreated": moment,
        "dateModified": moment,
        "genre": "experiment",
        "keywords": "soft robotics, gripper, pull-off force",
        "identifier": root["name"],
        "license": root["license"],
        "hasPart": [{"@id": file["@id"]} for file in files],
    }
    version = descriptor.get("version", "1")
    descriptor |= {"sdPublisher": {"@id": _NOTEBOOK["@id"]}, "dateCreated": moment, "version": version}
    return [descriptor, root | {"hasPart": [{"@id": _DATA}]}, _NOTEBOOK, data, *files, *others]


def _describe(node: dict[str, Any]) -> dict[str, Any]:
    name = Path(node["@id"]).name
    return node | {
        "@id": f"{_DATA}{node['@id']}",
        "name": name,
        "description": node["name"],
        "encodingFormat": _ENCODINGS[Path(name).suffix],
    }
