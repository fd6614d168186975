"""The simulators that benchmarks compare, by name."""

from models.errors import UsageError
from models.records import MeshSettings, SimulatorVersion
from models.validation import closest

VERSIONS: dict[str, SimulatorVersion] = {
    "production": SimulatorVersion(),
    "screening": SimulatorVersion(tier="screening"),
    "reference": SimulatorVersion(tier="reference", mesh=MeshSettings(edge_mm=6, refine=1, layers=2)),
    # Quadratic wedges of 6 mm, whole and split once: the two settings measured in the solver's design study.
    "wedge": SimulatorVersion(mesh=MeshSettings(edge_mm=6, refine=0, layers=1, fillet_mm=0)),
    "wedge refined": SimulatorVersion(mesh=MeshSettings(edge_mm=6, refine=1, layers=1, fillet_mm=0)),
}


def version_of(tier: str) -> SimulatorVersion:
    """The simulator version behind a name.

    Raises:
        UsageError: there is no such name.
    """
    if tier not in VERSIONS:
        raise UsageError(f"there is no tier `{tier}`; {closest(tier, list(VERSIONS))}")
    return VERSIONS[tier]
