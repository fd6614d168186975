"""Meshes cached by content, beside the lake's tables: a mesher that is not repeatable runs once per body."""

import logging
import os
import tempfile
from pathlib import Path

import numpy as np

from models.ids import content_id
from models.records import Design, SimulatorVersion
from models.simulation.effects.catalogue import build_effects
from models.simulation.mesh.build import build_mesh
from models.simulation.mesh.solid import SolidMesh

logger = logging.getLogger(__name__)

MESH_CACHE_FORMAT = 2


def cached_mesh(lake_root: Path, design: Design, version: SimulatorVersion, *, full_width: bool) -> SolidMesh:
    """The mesh of a design for a simulator version: from the cache, else made and cached.

    Raises:
        MeshingFailed: the mesher gave no usable mesh.
    """
    content = {
        "format": MESH_CACHE_FORMAT,
        "fem_version": version.fem_version,
        "design": design.model_dump(),
        "mesh": version.mesh.model_dump(),
        "effects": [e.model_dump() for e in version.effects],
        "full_width": full_width,
    }
    path = lake_root / ".state" / "meshes" / f"{content_id('M', content)}.npz"
    try:
        with np.load(path) as arrays:
            return SolidMesh.from_arrays(dict(arrays))
    except FileNotFoundError:
        pass
    except (OSError, ValueError, KeyError) as error:
        logger.warning("cached mesh %s is unreadable (%s); meshing again", path.name, error)
    effects = build_effects(version.effects)
    mesh = build_mesh(design, version.mesh, full_width=full_width, effects=effects)
    _store(path, mesh)
    return mesh


def _store(path: Path, mesh: SolidMesh) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    with os.fdopen(handle, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **mesh.to_arrays())
    os.replace(temporary, path)
