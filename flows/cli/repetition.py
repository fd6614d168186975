"""What a stored simulation was made from, so that `fast simulate` can make it again."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from models.records import Design, GraspSetup, SimulatorVersion


def read_simulation(lake: Path, simulation_id: str) -> "tuple[Design, int, SimulatorVersion, GraspSetup]":
    """Design, object, simulator version and setup of a simulation (S...) of the lake, failed ones too.

    Raises:
        UsageError: the lake has no such simulation, or it is another lab's.
    """
    from lake.store import Lake
    from lake.tables.campaign import DesignRow, SimulationRow, SimulatorVersionRow
    from models.errors import UsageError
    from models.records import GraspSetup
    from models.validation import closest

    found = Lake.open(lake)
    rows = found.records(SimulationRow, simulation_id=simulation_id)
    if not rows:
        known = closest(simulation_id, sorted(found.ids(SimulationRow)))
        raise UsageError(f"simulation `{simulation_id}` is not in {lake}; {known}")
    (row,) = rows
    designs = found.records(DesignRow, design_id=row.design_id)
    versions = found.records(SimulatorVersionRow, version_id=row.version_id)
    if not designs or not versions or versions[0].tier == "imported":
        raise UsageError(f"simulation `{simulation_id}` was made elsewhere; only this program's can be repeated.")
    return designs[0].design, row.object_id, versions[0].version, GraspSetup.model_validate_json(row.setup_json)


def refuse_beside(option: str, others: dict[str, Any]) -> None:
    """Refuse options that another one has already decided.

    Raises:
        UsageError: naming the first of them that was given.
    """
    from models.errors import UsageError

    for name, value in others.items():
        if value is not None:
            raise UsageError(f"--{option} already says what --{name} would; leave one of them out.")
