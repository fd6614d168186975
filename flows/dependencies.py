"""The packages FAST is built on: which are missing, and the sentence that says how to get them."""

import importlib.util
from collections.abc import Iterable

from fast.models.errors import MissingDependencyError

# Import name -> name in the package index, where the two differ.
DISTRIBUTIONS = {
    "rerun": "rerun-sdk",
    "serial": "pyserial",
    "skimage": "scikit-image",
    "mapbox_earcut": "mapbox-earcut",
}

# What a campaign uses; looked up before anything is written.
CAMPAIGN = ("prefect", "duckdb", "pyarrow", "torch", "botorch", "gpytorch", "numba", "scipy", "qdldl", "shapely",
            "trimesh", "manifold3d", "mapbox_earcut", "networkx", "lxml", "skimage", "matplotlib", "rerun", "serial",
            "pymodbus")  # fmt: skip
ALL = (*CAMPAIGN, "pymc", "pytetwild")

OWN = ("fast",)


def is_installed(name: str) -> bool:
    """True when the package can be found; nothing is imported."""
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):  # ValueError: it is half imported, so it is not whole
        return False


def require(names: Iterable[str]) -> None:
    """Check that packages are there before anything is written.

    Raises:
        MissingDependencyError: names every missing one.
    """
    missing = [name for name in names if not is_installed(name)]
    if missing:
        raise MissingDependencyError(missing_sentence(missing))


def missing_sentence(names: list[str]) -> str:
    """What is missing and how to get it."""
    listed = ", ".join(f"`{DISTRIBUTIONS.get(name, name)}`" for name in names)
    which = f"package {listed} is" if len(names) == 1 else f"packages {listed} are"
    return f"the {which} not installed; run `make setup` and use the `fast` of its environment (.venv/bin/fast)."
