"""Base materials of a 3MF file, so that a printer's program knows which body is made of what.

Source: 3MF core specification 1.3, section 5 ("Material resources"): `basematerials` stand before the objects, and an
object names its material by `pid` (the id of the group) and `pindex` (the place in it).
"""

import io
import zipfile
from collections.abc import Mapping
from typing import NamedTuple

from lxml import etree

_MODEL = "3D/3dmodel.model"
_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


class BaseMaterial(NamedTuple):
    """Name that a printer's program shows, and colour (`#RRGGBBAA`)."""

    name: str
    colour: str


def add_materials(package: bytes, materials: Mapping[str, BaseMaterial]) -> bytes:
    """The 3MF file with each object given the material whose key its name ends with.

    Raises:
        KeyError: an object's name ends with none of the keys.
    """
    with zipfile.ZipFile(io.BytesIO(package)) as source:
        parts = {name: source.read(name) for name in source.namelist()}
    root = etree.fromstring(parts[_MODEL])
    resources = root.find(f"{_CORE}resources")
    objects = resources.findall(f"{_CORE}object")
    group_id = str(1 + max(int(found.get("id")) for found in objects))
    group = etree.Element(f"{_CORE}basematerials", id=group_id)
    for material in materials.values():
        etree.SubElement(group, f"{_CORE}base", name=material.name, displaycolor=material.colour)
    resources.insert(0, group)
    places = {key: str(place) for place, key in enumerate(materials)}
    for found in objects:
        if found.find(f"{_CORE}mesh") is not None:
            key = next((key for key in places if found.get("name", "").endswith(key)), None)
            if key is None:
                raise KeyError(found.get("name"))
            found.set("pid", group_id)
            found.set("pindex", places[key])
    for node in root.iter():
        # Random ids of an extension that the file does not declare: strict readers refuse them.
        for name in [name for name in node.attrib if name.startswith("{")]:
            del node.attrib[name]
    etree.cleanup_namespaces(root)
    text = etree.tostring(root, xml_declaration=True, encoding="UTF-8")
    # The same name space declared again on each item is one warning each in lib3mf.
    parts[_MODEL] = text.replace(f'<item xmlns="{_CORE[1:-1]}"'.encode(), b"<item")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in parts.items():
            target.writestr(name, content)
    return packed.getvalue()
