"""The panel of a search: which of the measured designs and objects it takes, if not all of them."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fast.lake.tables.campaign import GraspRow
from fast.models.design.space import space_of
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import Design

LEAST_DESIGNS, LEAST_OBJECTS = 1, 2  # with fewer, whatever is missing is as well friction or a modulus


@dataclass(frozen=True)
class PanelSize:
    """How many designs and objects a search takes at most; None: all that were measured."""

    designs: int | None = None
    objects: int | None = None

    def __post_init__(self) -> None:
        """Check that anything can be told.

        Raises:
            UsageError: there are too few.
        """
        for what, n, least in (("designs", self.designs, LEAST_DESIGNS), ("objects", self.objects, LEAST_OBJECTS)):
            if n is not None and n < least:
                raise UsageError(f"a panel of {n} {what} tells nothing, {least} are the least; ask for more.")


WHOLE = PanelSize()


def select_panel(rows: Sequence[GraspRow], designs: Mapping[str, Design], size: PanelSize) -> list[GraspRow]:
    """Select the grasps of a panel; designs: by the id that rows have. A larger panel holds every smaller one."""
    chosen = spread_designs(list(designs.values()))[: size.designs]
    objects = set(spread_objects({row.object_id for row in rows})[: size.objects])
    return [row for row in rows if designs[row.design_id] in chosen and row.object_id in objects]


def spread_designs(designs: Sequence[Design]) -> list[Design]:
    """Return each design once, the one next to the middle first, then always the one farthest from all before it."""
    unique = list({design.design_id: design for design in sorted(designs, key=lambda d: d.design_id)}.values())
    unit = space_of(unique).to_unit(unique)
    first = int(np.argmin(np.linalg.norm(unit - unit.mean(axis=0), axis=1)))
    order, distance = [first], np.linalg.norm(unit - unit[first], axis=1)
    while len(order) < len(unique):
        distance[order] = -1.0
        order.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(unit - unit[order[-1]], axis=1))
    return [unique[place] for place in order]


def spread_objects(objects: set[int]) -> list[int]:
    """Return objects by turns of their classes, each class in the order of the catalogue."""
    by_class: dict[str, list[int]] = defaultdict(list)
    for object_id in sorted(objects):
        by_class[get_object(object_id).object_class].append(object_id)
    turns = max(map(len, by_class.values()), default=0)
    return [of_class[turn] for turn in range(turns) for of_class in by_class.values() if turn < len(of_class)]
