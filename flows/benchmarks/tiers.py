"""The simulators that benchmarks compare, by name."""

from collections.abc import Mapping

from models.errors import UsageError
from models.records import TIERS, MeshSettings, SimulatorVersion
from models.validation import closest

# Their meshes are not of this program's mesher but those of `flows.benchmarks.wedges`.
WEDGE_REFINEMENT = {"wedge": 0, "wedge refined": 1}
SIMULATORS: dict[str, SimulatorVersion] = TIERS | {
    name: SimulatorVersion(mesh=MeshSettings(refine=refine, fillet_mm=0), fem_version="wedges")
    for name, refine in WEDGE_REFINEMENT.items()
}


def version_of(name: str, among: Mapping[str, SimulatorVersion] = SIMULATORS) -> SimulatorVersion:
    """The simulator version behind a name.

    Raises:
        UsageError: there is no such name.
    """
    if name not in among:
        raise UsageError(f"there is no tier `{name}`; {closest(name, list(among))}")
    return among[name]
