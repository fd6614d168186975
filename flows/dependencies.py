"""The packages FAST is built on: missing or of another version, and the sentence that says how to get them."""

import importlib.util
import re
import sysconfig
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path

from fast.models.errors import MissingDependencyError

# Import name -> name in the package index, where the two differ.
DISTRIBUTIONS = {
    "rerun": "rerun-sdk",
    "serial": "pyserial",
    "skimage": "scikit-image",
    "sklearn": "scikit-learn",
    "mapbox_earcut": "mapbox-earcut",
}

# What every command needs, and what a campaign uses besides; looked up before anything is written.
BASE = ("duckdb", "pyarrow", "numba", "scipy", "qdldl", "shapely", "trimesh", "manifold3d", "mapbox_earcut", "networkx",
        "lxml", "skimage", "matplotlib", "jinja2", "serial", "pymodbus")  # fmt: skip
CAMPAIGN = (*BASE, "prefect", "torch", "botorch", "gpytorch", "rerun")
CALIBRATION = ("pymc", "arviz", "h5netcdf")
ALL = (*CAMPAIGN, *CALIBRATION, "pytetwild")

OWN = ("fast",)
LOCK = Path(__file__).resolve().parents[1] / "requirements.lock"
_PROJECT = "fast-gripper-lab"
_PIN = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[A-Za-z0-9.+!_-]+)")
_EXTRA = re.compile(r"^(?P<name>[A-Za-z0-9._-]+).*;.*extra == [\"'](?P<extra>[a-z]+)[\"']")


def is_checkout() -> bool:
    """Return True where FAST runs from its repository, whose `make setup` installs everything."""
    return (Path(__file__).resolve().parents[1] / "Makefile").exists()


def is_installed(name: str) -> bool:
    """Return True when the package can be found; nothing is imported."""
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
    """Say what is missing and how to get it."""
    wanted = [DISTRIBUTIONS.get(name, name) for name in names]
    listed = ", ".join(f"`{name}`" for name in wanted)
    which = f"package {listed} is" if len(names) == 1 else f"packages {listed} are"
    return f"the {which} not installed; run {_advise(wanted)}."


def _advise(distributions: list[str]) -> str:
    """Return the command that installs what is missing: of the repository, or of an extra of the installed package."""
    if is_checkout():
        return "`make setup` and use the `fast` of its environment (.venv/bin/fast)"
    known = _read_extras()
    extras = ",".join(sorted({known[name][0] for name in distributions if name in known}))
    others = [name for name in distributions if name not in known]
    wanted = [f"'{_PROJECT}[{extras}]'", *others] if extras else others
    return f"`pip install {' '.join(wanted)}`"


def _read_extras() -> dict[str, list[str]]:
    """Read the extras of FAST that bring a distribution, by its name, as the installed package itself says."""
    found: dict[str, list[str]] = {}
    for line in metadata.requires(_PROJECT) or []:
        if (match := _EXTRA.match(line)) and match["name"] != _PROJECT and match["extra"] != "dev":
            found.setdefault(match["name"], []).append(match["extra"])
    return found


def read_lock(text: str) -> tuple[dict[str, str], list[str]]:
    """Read the versions by package of a lock file, and the lines that pin nothing."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    found = {line: _PIN.fullmatch(line) for line in lines}
    pins = {_plain(match["name"]): match["version"] for match in found.values() if match}
    return pins, [line for line, match in found.items() if match is None]


def find_mismatches(text: str) -> Iterator[str]:
    """Find packages of a lock file that are missing, or there in another version, one sentence each."""
    installed = installed_packages()
    for name, version in read_lock(text)[0].items():
        found = installed.get(name)
        if found is None:
            yield f"{name} {version} is locked but not installed; run `make clean setup`."
        elif found.version.partition("+")[0] != version.partition("+")[0]:
            yield f"{name} is {found.version}, the lock says {version}; run `make clean setup`."


def installed_packages() -> dict[str, metadata.Distribution]:
    """Return what is in the environment, by name."""
    return {_plain(found.metadata["Name"]): found for found in list_distributions()}


def list_distributions() -> list[metadata.Distribution]:
    """List what is in the environment; not counted are own copies that setuptools, once imported, adds to the path."""
    paths = sysconfig.get_paths()
    return list(metadata.distributions(path=list(dict.fromkeys([paths["purelib"], paths["platlib"]]))))


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
