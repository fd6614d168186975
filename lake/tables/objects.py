"""The test objects as rows of the lake."""

from lake.tables.campaign import ObjectRow
from models.ids import canonical_json
from models.objects.catalogue import OBJECTS


def object_rows() -> list[ObjectRow]:
    """A row for each of the 36 test objects."""
    return [
        ObjectRow(
            object_id=obj.object_id,
            name=obj.name,
            object_class=obj.object_class,
            orientation=obj.orientation,
            parameters_json=canonical_json(obj.parameters),
        )
        for obj in OBJECTS
    ]
