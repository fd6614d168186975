"""The table of what was measured of the lots of printing material."""

from typing import ClassVar, Self

from pydantic import Field

from fast.lake.tables.row import Row
from fast.models.ids import content_id
from fast.models.material import QUANTITIES, MaterialLot, MaterialMeasurement


class MaterialRow(Row):
    """One quantity of a lot, as it was measured; `tools.material_lot` names the lot."""

    table: ClassVar[str] = "materials"
    material_id: str
    """Of lot and quantity."""
    lot: str
    """As `tools.material_lot` names it."""
    quantity: str
    """What was measured."""
    value: float
    """As measured."""
    unit: str
    """Of the value."""
    sd: float | None = Field(default=None, description="standard deviation of single tests, in the unit of the value")
    n: int | None = Field(default=None, description="number of tests")
    method: str
    """How."""
    source: str
    """By whom."""
    sure: str | None = Field(default=None, description="what was strange in it, and is so")
    taken_back_by: str | None = Field(default=None, description="who said that it was not measured after all")

    @classmethod
    def of(cls, lot: str, quantity: str, measured: MaterialMeasurement, sure: str | None = None) -> Self:
        """Make the row of a quantity of a lot: a corrected measurement replaces the one before."""
        values = measured.model_dump(exclude={"sure"})
        return cls(material_id=content_id("L", [lot, quantity]), lot=lot, quantity=quantity, sure=sure, **values)

    @property
    def measurement(self) -> MaterialMeasurement:
        """The measurement of this row."""
        return MaterialMeasurement(**self.model_dump(include=set(MaterialMeasurement.model_fields) - {"sure"}))


def lot_of_rows(rows: list[MaterialRow]) -> MaterialLot:
    """Return the lot that these rows are of; leave out quantities that FAST has no use for."""
    return MaterialLot(**{row.quantity: row.measurement for row in rows if row.quantity in QUANTITIES})
