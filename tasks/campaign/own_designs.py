"""Designs of one's own: a CSV file beside the config, whose fingers are printed and measured like proposed ones.

The reference finger of a config is one of them, in the first slot of the first batch.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fast.models.design.fin_ray import FinRay
from fast.models.design.printability import PrintingRules, broken_rules
from fast.models.design.reference import make_reference
from fast.models.errors import ConfigError, UsageError
from fast.models.records import Design
from fast.models.validation import load_record
from fast.tasks.campaign.csv_file import CsvRow, read_rows
from fast.tasks.campaign.settings import Schedule

OWN = "own"  # what `proposals.acquisition` says of them
REFERENCE = "reference"  # and of a reference finger
NAME, BATCH = "name", "batch"
_LIKE_A_TOOL = re.compile(r"B\d+T\d", re.IGNORECASE)
_LONGEST_NAME = 60


@dataclass(frozen=True)
class OwnDesign:
    """A design of the file. place: file and row, for messages; batch: in which it is printed, None: the first free."""

    place: str
    name: str
    design: Design
    batch: int | None = None
    rule: str = OWN


def list_references(schedule: Schedule, family: type[Design]) -> list[OwnDesign]:
    """List the reference finger that the config asks for, which the first batch prints; none where it asks for none.

    Raises:
        UsageError: the family cannot draw it.
    """
    name = schedule.reference
    if name is None:
        return []
    return [OwnDesign("schedule.reference", name, make_reference(name, family), 1, REFERENCE)]


def read_designs(path: Path, rules: PrintingRules | None = None, family: type[Design] = FinRay) -> list[OwnDesign]:
    """Read designs of a CSV file with the parameters of their family, and optionally `name` and `batch`.

    rules: of printing, that each must keep; None checks none.

    Raises:
        UsageError: the file cannot be read, a value is out of its range, or a finger cannot be printed.
    """
    rows = read_rows(path, tuple(family.model_fields), (NAME, BATCH))
    return [_read(row, number, rules, family) for number, row in enumerate(rows, start=1)]


def _read(row: CsvRow, number: int, rules: PrintingRules | None, family: type[Design]) -> OwnDesign:
    readers: dict[Any, Callable[[str], Any]] = {int: row.integer, float: row.number}
    values = {name: readers.get(field.annotation, row.get)(name) for name, field in family.model_fields.items()}
    try:
        design = load_record(family, values, row.place)
    except ConfigError as error:
        raise UsageError(f"{error} Nothing was written.") from error
    broken = broken_rules(design, rules) if rules is not None else []
    if broken:
        raise UsageError(
            f"{row.place}: the finger cannot be printed ({'; '.join(broken)}); nothing was written: change the design, "
            "the limits in [scientist.printing], or the recipe in [print]."
        )
    name = row.get(NAME) or f"own {number}"
    if len(name) > _LONGEST_NAME or not name.isprintable():
        raise row.wrong(NAME, f"it must be printable and at most {_LONGEST_NAME} characters long")
    if _LIKE_A_TOOL.fullmatch(name):
        raise row.wrong(NAME, "tools are called so by batch and slot, and it may lie in another one; take another name")
    batch = row.integer(BATCH) if row.get(BATCH) else None
    if batch is not None and batch < 1:
        raise row.wrong(BATCH, "it must be at least 1")
    return OwnDesign(row.place, name, design, batch)


def place_designs(designs: Sequence[OwnDesign], schedule: Schedule) -> Mapping[int, tuple[OwnDesign, ...]]:
    """Place designs by the batch that prints them: the one that they name, else the first initial one with room.

    Raises:
        UsageError: a batch is not in the schedule, or has fewer tools than designs of the file.
    """
    last = schedule.batches_of(schedule.n_stages - 1)[-1]
    placed: dict[int, list[OwnDesign]] = defaultdict(list)
    for own in designs:
        if own.batch is None:
            continue
        if own.batch > last:
            raise UsageError(
                f"{own.place}: batch is {own.batch}, the schedule ends with batch {last}; nothing was written: give an "
                "earlier one, or raise schedule.guided_batches."
            )
        placed[own.batch].append(own)
        if len(placed[own.batch]) > schedule.tools_of(own.batch):
            raise UsageError(
                f"{own.place}: batch {own.batch} has {schedule.tools_of(own.batch)} tools, and this design is one too "
                "many; nothing was written: give another batch, or raise schedule.tools_per_batch."
            )
    initial = schedule.batches_of(0)
    for own in (own for own in designs if own.batch is None):
        free = [batch for batch in initial if len(placed[batch]) < schedule.tools_of(batch)]
        if not free:
            raise UsageError(
                f"{own.place}: the initial batches have {schedule.initial_tools} tools, and this design is one too "
                "many; nothing was written: raise schedule.initial_tools, or give it a later batch."
            )
        placed[free[0]].append(own)
    return {batch: tuple(found) for batch, found in placed.items() if found}
