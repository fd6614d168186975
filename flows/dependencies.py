"""The packages FAST is built on: which are missing, and the sentence that says how to get them."""

import importlib.util
import re
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from fast.models.errors import MissingDependencyError

# Import name -> name in the package index, where the two differ.
DISTRIBUTIONS = {
    "rerun": "rerun-sdk",
    "serial": "pyserial",
    "skimage": "scikit-image",
    "mapbox_earcut": "mapbox-earcut",
}

# What every command needs, and what a campaign uses besides; looked up before anything is written.
BASE = ("duckdb", "pyarrow", "numba", "scipy", "qdldl", "shapely", "trimesh", "manifold3d", "mapbox_earcut", "networkx",
        "lxml", "skimage", "matplotlib", "serial", "pymodbus")  # fmt: skip
CAMPAIGN = (*BASE, "prefect", "torch", "botorch", "gpytorch", "rerun")
ALL = (*CAMPAIGN, "pymc", "pytetwild")

OWN = ("fast",)
_PROJECT = "fast-gripper-lab"
_EXTRA = re.compile(r"^(?P<name>[A-Za-z0-9._-]+).*;.*extra == [\"'](?P<extra>[a-z]+)[\"']")


def is_checkout() -> bool:
    """True where FAST runs from its repository, whose `make setup` installs everything."""
    return (Path(__file__).resolve().parents[1] / "Makefile").exists()


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
    wanted = [DISTRIBUTIONS.get(name, name) for name in names]
    listed = ", ".join(f"`{name}`" for name in wanted)
    which = f"package {listed} is" if len(names) == 1 else f"packages {listed} are"
    return f"the {which} not installed; run {_advise(wanted)}."


def _advise(distributions: list[str]) -> str:
    """The command that installs what is missing: of the repository, or of an extra of the installed package."""
    if is_checkout():
        return "`make setup` and use the `fast` of its environment (.venv/bin/fast)"
    known = _read_extras()
    extras = ",".join(sorted({known[name][0] for name in distributions if name in known}))
    others = [name for name in distributions if name not in known]
    wanted = [f"'{_PROJECT}[{extras}]'", *others] if extras else others
    return f"`pip install {' '.join(wanted)}`"


def _read_extras() -> dict[str, list[str]]:
    """Extras of FAST that bring a distribution, by its name, as the installed package itself says."""
    found: dict[str, list[str]] = {}
    for line in metadata.requires(_PROJECT) or []:
        if (match := _EXTRA.match(line)) and match["name"] != _PROJECT and match["extra"] != "dev":
            found.setdefault(match["name"], []).append(match["extra"])
    return found
