"""Answers to what a search asked for: measured grasps of a hand-off folder that name their request.

They are checked against the requests before anything is written; what does not fit is refused as a whole, and the
search keeps what it had.
"""

from collections.abc import Sequence
from statistics import median

from fast.lake.handoff.files import HandoffGrasp
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ToolRow
from fast.lake.tables.requests import PLACEMENT, GraspRequestRow
from fast.models.errors import UsageError
from fast.models.records import GraspSetup, Placement, find_setup_id
from fast.models.traces import peak_force_n

_MOST_FACTOR = 5.0  # between a tool and itself: wear and settings do less, units more
_REMEDY = "nothing was imported, the search keeps what it had"


def find_settings(grasp: HandoffGrasp, usual: GraspSetup) -> tuple[GraspSetup, Placement]:
    """Find how a grasp was made: what the files say, and else the usual setup at the nominal placement."""
    of_setup = {name: value for name, value in grasp.settings.items() if name not in PLACEMENT}
    placement = Placement(**{name: value for name, value in grasp.settings.items() if name in PLACEMENT})
    return usual.model_copy(update=of_setup), placement


def check_answers(lake: Lake, grasps: Sequence[HandoffGrasp], usual: GraspSetup) -> str | None:
    """Compare new grasps that name a request with what was asked for; returns the campaign of their tools.

    None: nothing answers this lake; grasps of another lake, which asked for some of them, come as they are.

    Raises:
        UsageError: a request is not in the lake, or the grasp is another than the one that was asked for, or made in
            another order, or in another unit, or grasps that nobody asked for are among them, or the tools are of
            several campaigns.
    """
    answers = [grasp for grasp in grasps if grasp.request_id]
    rows = {row.request_id: row for row in lake.records(GraspRequestRow, request_id=[g.request_id for g in answers])}
    is_mixed = len(answers) < len(grasps)
    if not answers or (is_mixed and not rows):
        return None
    if is_mixed:
        other = next(grasp for grasp in grasps if not grasp.request_id)
        raise UsageError(
            f"grasp {other.grasp_id} names no request, but {len(answers)} others of its folder do; {_REMEDY}: import "
            "grasps that nobody asked for from a folder of their own."
        )
    for grasp in answers:
        _compare(grasp, rows.get(grasp.request_id), usual)
    _check_order(answers, rows)
    _check_unit(lake, answers)
    campaigns = {row.campaign_id for row in lake.records(ToolRow, tool_id=[grasp.tool_id for grasp in answers])}
    if len(campaigns) != 1:
        raise UsageError(f"the tools of these answers are of {len(campaigns)} campaigns, not of one; {_REMEDY}.")
    return campaigns.pop()


def _check_unit(lake: Lake, answers: Sequence[HandoffGrasp]) -> None:
    """Compare peaks with those of the same tools on the same objects before: half of what is asked for is as usual."""
    before: dict[tuple[str, int], list[float]] = {}
    for row in lake.records(GraspRow, tool_id=[grasp.tool_id for grasp in answers], status="ok"):
        if row.peak_force_n is not None and row.fidelity == "real":
            before.setdefault((row.tool_id, row.object_id), []).append(row.peak_force_n)
    factors = []
    for grasp in answers:
        known_n = before.get((grasp.tool_id, grasp.object_id), [])
        peak_n = grasp.peak_force_n if grasp.trace is None else peak_force_n(grasp.trace)
        if grasp.status == "ok" and peak_n is not None and known_n and median(known_n) > 0.0:
            factors.append(peak_n / median(known_n))
    if factors and not 1.0 / _MOST_FACTOR < median(factors) < _MOST_FACTOR:
        raise UsageError(
            f"the peaks of these answers are {median(factors):.3g} times those of the same tools on the same objects "
            f"before; {_REMEDY}: give forces in N."
        )


def _compare(grasp: HandoffGrasp, asked: GraspRequestRow | None, usual: GraspSetup) -> None:
    if asked is None:
        raise UsageError(
            f"grasp {grasp.grasp_id} answers request {grasp.request_id}, which this lake does not have; {_REMEDY}: "
            "import it into the lake whose `fast gap next` wrote the plan."
        )
    made = {"tool_id": grasp.tool_id, "object_id": grasp.object_id, "repeat": grasp.repeat}
    for name, value in made.items():
        if value != getattr(asked, name):
            raise UsageError(
                f"grasp {grasp.grasp_id} has {name} {value}, its request {grasp.request_id} asks for "
                f"{getattr(asked, name)}; {_REMEDY}: make the grasp that was asked for."
            )
    request = asked.request
    setup, placement = find_settings(grasp, usual)
    if find_setup_id(setup, placement) == asked.setup_id:
        return
    for wanted, found in ((request.setup, setup), (request.placement, placement)):
        for name, value in found:
            if value != getattr(wanted, name):
                raise UsageError(
                    f"grasp {grasp.grasp_id} was made with {name} {_write(value)}, its request {grasp.request_id} asks "
                    f"for {_write(getattr(wanted, name))}; {_REMEDY}: make the grasp that was asked for."
                )


def _check_order(answers: Sequence[HandoffGrasp], rows: dict[str, GraspRequestRow]) -> None:
    """Check that grasps of a search follow each other as asked: effects of wear and time cancel only then."""
    if any(grasp.started_at is None for grasp in answers) and any(grasp.order is None for grasp in answers):
        return

    def when(grasp: HandoffGrasp) -> float:
        return grasp.started_at.timestamp() if grasp.started_at is not None else float(grasp.order or 0)

    by_search: dict[str, list[HandoffGrasp]] = {}
    for grasp in sorted(answers, key=when):
        by_search.setdefault(rows[grasp.request_id].search_id, []).append(grasp)
    for made in by_search.values():
        for before, after in zip(made, made[1:], strict=False):
            if rows[before.request_id].place > rows[after.request_id].place:
                raise UsageError(
                    f"grasp {before.grasp_id} was made before {after.grasp_id}, the plan asks for it after; {_REMEDY}: "
                    "make the grasps again in the order of the plan, or correct their times."
                )


def _write(value: float | None) -> str:
    return "none" if value is None else f"{value:g}"
