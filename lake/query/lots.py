"""What a lake has of the lots of printing material."""

from collections.abc import Sequence

from fast.lake.store import Lake
from fast.lake.tables.material import MaterialRow


def read_lot_rows(lake: Lake, lot: str | Sequence[str] | None = None) -> list[MaterialRow]:
    """What is measured of a lot, of several, or of all of the lake, but for what was taken back."""
    where = {} if lot is None else {"lot": lot}
    return lake.records(MaterialRow, taken_back_by=None, **where)
