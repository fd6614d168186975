"""FAST from Python: the grasp simulator and the search for a gap as plain functions. `import fast` offers them."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lake.store import Lake
    from models.gap.findings import Findings


def find_gap(
    lake: "Lake | Path | str",
    campaign: str | None = None,
    *,
    n_designs: int | None = None,
    n_objects: int | None = None,
    budget_minutes: float | None = None,
    n_workers: int = 2,
    on_progress: Callable[[str], None] = lambda sentence: None,
) -> "Findings":
    """Find where simulation and measurement disagree, as `fast gap` does, and return what was found.

    `lake`: an open lake or its address. `campaign`: whose measurements count; default: all of the lake. `n_designs`,
    `n_objects`: search with so many, spread over those measured. `budget_minutes`: of simulating. `on_progress` gets
    a sentence now and then. What was simulated stays in the lake, so the same call continues a search that was
    killed; a search that has ended is told again at once.

    Raises:
        UsageError: measurements are missing, too few, not of one kind, or not in N.
        FastError: the budget ended before the simulations were complete, or another process searches in this lake.
    """
    from flows.gap.search import GapOrder, run_gap
    from flows.progress import ProgressReporter
    from lake.store import Lake
    from tasks.gap.panel import PanelSize

    found = lake if isinstance(lake, Lake) else Lake.open(lake)
    order = GapOrder(campaign, budget_minutes=budget_minutes, panel=PanelSize(n_designs, n_objects))
    outcome = run_gap(found, order.with_workers(n_workers), ProgressReporter(on_progress, on_progress))
    return outcome.run.findings
