"""The base of all row records, and the types that their columns share."""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict

from fast.models.records import Record


def _finite_vector(values: Any) -> np.ndarray:
    vector = np.array(values, dtype=np.float64)
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise ValueError("it must be one row of finite numbers")
    vector.flags.writeable = False
    return vector


Channel = Annotated[np.ndarray, BeforeValidator(_finite_vector)]
Status = Literal["ok", "failed"]


class Row(Record):
    """One row of a table; `table` names the folder, the first field is the id."""

    model_config = ConfigDict(arbitrary_types_allowed=True)
    table: ClassVar[str]

    @classmethod
    def id_column(cls) -> str:
        """Return the name of the id column, the first field."""
        return next(iter(cls.model_fields))
