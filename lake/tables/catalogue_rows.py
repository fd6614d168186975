"""Rows of what the program itself knows: test objects, simulator versions and the effects that they switch on."""

from collections.abc import Sequence

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EffectRow, ObjectRow, SimulatorVersionRow
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.row import Row
from fast.models.objects.catalogue import OBJECTS
from fast.models.objects.rigid import RigidObject
from fast.models.records import EffectValue
from fast.models.simulation.version import SimulatorVersion


def version_rows(version: SimulatorVersion) -> list[Row]:
    """Return rows of a simulator version and its effects, in the order of the version.

    Raises:
        ConfigError: an effect or parameter is unknown, or a value is out of bounds.
    """
    from fast.models.simulation.effects.catalogue import build_effects  # all effects: no question to a lake needs them

    build_effects(version.effects)  # names the effect or parameter that is wrong
    effects = [_effect_row(version.version_id, place, value) for place, value in enumerate(version.effects)]
    return [*effects, SimulatorVersionRow.of(version)]


def missing_version_rows(lake: Lake, version: SimulatorVersion) -> list[Row]:
    """Return rows of `version_rows` that the lake lacks; of a lake older than the table of effects, those alone."""
    return [row for row in version_rows(version) if not lake.has(type(row), getattr(row, row.id_column()))]


def append_version(lake: Lake, version: SimulatorVersion, provenance: Provenance) -> None:
    """Make sure that the lake describes a simulator version and its effects."""
    if rows := missing_version_rows(lake, version):
        lake.append(rows, provenance)


def _effect_row(version_id: str, place: int, value: EffectValue) -> EffectRow:
    """Make the row of one effect, with the neutral value of every parameter that the version leaves out."""
    from fast.models.simulation.effects.catalogue import CATALOGUE

    spec = CATALOGUE[value.effect]
    parameters = spec.neutral.parameters | value.parameters
    return EffectRow(
        effect_id=EffectRow.make_id(version_id, place, value.effect),
        version_id=version_id,
        place=place,
        effect=value.effect,
        title=spec.title,
        code=spec.code,
        layer=spec.layer,
        effect_version=spec.version,
        parameters=tuple(parameters),
        parameter_values=tuple(parameters.values()),
    )


def object_rows(own: Sequence[RigidObject] = ()) -> list[ObjectRow]:
    """Make a row for each of the 36 test objects, and for own ones."""
    return [ObjectRow.of(obj) for obj in (*OBJECTS, *own)]


def read_lot_rows(lake: Lake, lot: str | Sequence[str] | None = None) -> list[MaterialRow]:
    """Read what is measured of a lot, of several, or of all of the lake, but for what was taken back."""
    where = {} if lot is None else {"lot": lot}
    return lake.records(MaterialRow, taken_back_by=None, **where)
