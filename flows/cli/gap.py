"""`fast gap`: the effects by which simulation and measurement may differ."""

from typing import Annotated

from cyclopts import Parameter

from flows.cli.common import AsJson, show, table_text

_COSTS = (
    "cost P: post-processing of a trace; C: other closings or frictions of the simulator without it; "
    "F: finite elements of its own"
)


def gap(
    *,
    catalogue: Annotated[bool, Parameter(negative="", help="Print the catalogue of effects.")] = False,
    json: AsJson = False,
) -> None:
    """The catalogue of effects that a simulator version can switch on, with bounds, priors and what confuses them."""
    from models.effects.table import catalogue_entries, catalogue_rows
    from models.errors import UsageError

    if not catalogue:
        raise UsageError(
            "`fast gap` cannot search for a gap yet; `fast gap --catalogue` prints the effects to choose from."
        )
    show(catalogue_entries(), f"{table_text(catalogue_rows())}\n\n{_COSTS}", json)
