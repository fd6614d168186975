"""A build plate as a 3MF file, so that a printer's program knows which body is made of what.

Source: 3MF core specification 1.3. Meshes are section 4.1, components that stay together 4.2, base materials 5: they
stand before the objects, and an object names its material by `pid` (the id of the group) and `pindex` (the place in
it). A program that reads the file shows one object per part, made of bodies that it does not move apart.
"""

import io
import zipfile
from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import trimesh

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
_CONTENT_TYPES = (
    f'{_HEAD}<Types xmlns="{_PACKAGE}/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
_RELATIONS = (
    f'{_HEAD}<Relationships xmlns="{_PACKAGE}/relationships"><Relationship Id="rel0" Target="/3D/3dmodel.model" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
_WRITTEN_AT = (1980, 1, 1, 0, 0, 0)  # the same file gives the same bytes
_GROUP_ID = 1


class BaseMaterial(NamedTuple):
    """Name that a printer's program shows, and colour (`#RRGGBB`)."""

    name: str
    colour: str


class Part(NamedTuple):
    """Bodies that belong together, by the key of their material, and where the part lies (4 x 4, mm)."""

    name: str
    bodies: Mapping[str, trimesh.Trimesh]
    transform: np.ndarray


def write_3mf(parts: Sequence[Part], materials: Mapping[str, BaseMaterial]) -> bytes:
    """Write the 3MF file of parts on a build plate; a body names the material of its key, and is called `PART_key`.

    Raises:
        KeyError: a body has a key that is no material.
    """
    places = {key: place for place, key in enumerate(materials)}
    bases = "".join(f"<base name={quoteattr(m.name)} displaycolor={quoteattr(m.colour)}/>" for m in materials.values())
    objects, items = [f'<basematerials id="{_GROUP_ID}">{bases}</basematerials>'], []
    number = _GROUP_ID
    for part in parts:
        components = []
        for key, body in part.bodies.items():
            number += 1
            name = quoteattr(f"{part.name}_{key}")
            objects.append(
                f'<object id="{number}" type="model" name={name} pid="{_GROUP_ID}" pindex="{places[key]}">'
                f"{_mesh(body)}</object>"
            )
            components.append(f'<component objectid="{number}"/>')
        number += 1
        objects.append(
            f'<object id="{number}" type="model" name={quoteattr(part.name)}><components>{"".join(components)}'
            "</components></object>"
        )
        items.append(f'<item objectid="{number}" transform="{_numbers(part.transform[:3].T)}"/>')
    model = (
        f'{_HEAD}<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}"><resources>{"".join(objects)}</resources>'
        f"<build>{''.join(items)}</build></model>"
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        texts = {"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONS, "3D/3dmodel.model": model}
        for name, text in texts.items():
            target.writestr(zipfile.ZipInfo(name, _WRITTEN_AT), text, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _mesh(body: trimesh.Trimesh) -> str:
    corners = "".join(f'<vertex x="{x:.7g}" y="{y:.7g}" z="{z:.7g}"/>' for x, y, z in body.vertices.tolist())
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in body.faces.tolist())
    return f"<mesh><vertices>{corners}</vertices><triangles>{faces}</triangles></mesh>"


def _numbers(values: np.ndarray) -> str:
    """Write the transform's numbers in 3MF's order: columns of the 3 x 4 matrix one after the other."""
    return " ".join(f"{value:.7g}" for value in values.ravel().tolist())
