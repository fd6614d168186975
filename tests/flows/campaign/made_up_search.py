"""A made-up search: it cannot tell lag from shift and asks for two pairs of grasps; with their answer it says lag."""

from typing import Any

from fast.flows.gap.search import GapOutcome, GapRequest
from fast.flows.progress import ProgressReporter
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.models.gap.findings import (
    Asked,
    AskedGrasps,
    Decision,
    Findings,
    Gap,
    NextExperiment,
    PersonQuestion,
    RoundFindings,
)
from fast.models.records import GraspSetup
from fast.tasks.bench.asked import write_requests
from fast.tasks.campaign.state import tuples
from fast.tasks.gap.ask import list_requests
from fast.tasks.gap.findings import GapRun, find_run, write_run

FAST = GraspSetup(lift_speed_mm_per_s=20.0)
N_MADE = "SELECT count(*) FROM grasps WHERE request_id IS NOT NULL AND status = 'ok'"


def search_made_up(lake: Lake, request: GapRequest, reporter: ProgressReporter | None, *_: Any) -> GapOutcome:
    """What it says depends on how many asked grasps the lake has."""
    if reporter is not None:
        reporter.progress(f"searching {request.campaign_id}")
    ((n_made,),) = tuples(lake, N_MADE)
    ((object_id,),) = tuples(lake, "SELECT coalesce(min(object_id), 3) FROM grasps")
    gap_id = f"A{n_made}"
    known = find_run(lake, gap_id)
    if known is not None:
        return GapOutcome(known, False)
    kind: Any = "effect" if n_made else "set"
    effects = ("load_cell_lag",) if n_made else ("load_cell_lag", "lift_misalignment")
    asked = None
    if not n_made:
        pairs = tuple(
            AskedGrasps(tool=f"{request.campaign_id}/B01T{slot}", object=object_id, setup=FAST, n=1, setting="fast")
            for slot in range(2)
        )
        asked = NextExperiment(grasps=pairs, separates=effects, promised_grasps=4, sentence="Lift fast.")
        write_requests(lake, gap_id, list_requests(asked.grasps), request.campaign_id, current_provenance())
    named = Decision(kind=kind, effects=effects, probability=0.9, sentence=f"{kind}.")
    told = (
        Asked(
            promised=4,
            spent=n_made,
            promised_nats=3.0,
            got_nats=4.0,
            before=dict.fromkeys(effects, 0.5),
            after=dict.fromkeys(effects, 0.9),
            outcome=f"{n_made} grasps say lag.",
        ),
    )
    run = write_made_up_run(lake, request.campaign_id, gap_id, named, asked, told if n_made else ())
    return GapOutcome(run, True)


def ask_person(lake: Lake, campaign_id: str | None) -> GapRun:
    """A search that cannot tell ribs from walls, and asks for a calliper."""
    named = Decision(kind="set", effects=("rib_imperfection", "wall_thickness_offset"), probability=0.9)
    question = PersonQuestion(kind="walls", sentence="Please measure the walls.", label="Walls, more than drawn, mm")
    asked = NextExperiment(separates=named.effects, promised_grasps=0, sentence=question.sentence, person=question)
    return write_made_up_run(lake, campaign_id, "P0", named, asked)


def write_made_up_run(
    lake: Lake,
    campaign_id: str | None,
    gap_id: str,
    named: Decision,
    asked: NextExperiment | None,
    told: tuple[Asked, ...] = (),
) -> GapRun:
    """A finished search of one round, in the lake."""
    findings = Findings(
        alarm=True,
        rounds=(RoundFindings(where=(), candidates=(), named=named),),
        gap=Gap(rmse_before_n=0.5, rmse_after_n=0.2, rmse_floor_n=0.1, closed_fraction=0.75, ci95=None),
        aliases=(),
        next_experiment=asked,
        asked=told,
        seed=0,
        budget={},
    )
    run = GapRun(
        gap_id=gap_id,
        campaign_id=campaign_id,
        seed=0,
        split_id="Z",
        n_grasps=4,
        base_version_id="V",
        before_version_id="V",
        after_version_id="V",
        calibration_ids=("C",),
        findings=findings,
    )
    write_run(lake, run, f"found {named.kind}", current_provenance())
    return run
