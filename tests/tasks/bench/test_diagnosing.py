from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from fast.hardware.cell.cell import MeasuredGrasp
from fast.hardware.cell.diagnostics import DiagnosticPlan, DiagnosticRun
from fast.hardware.virtual.world.file import World
from fast.lake.tables.campaign import DiagnosticRow, GraspRow
from fast.models.errors import UsageError
from fast.models.records import BENCH_FAULT, GraspSetup, Trace
from fast.tasks.bench.measure import append_diagnostic
from fast.tasks.bench.plan import draw_protocol, find_missing_runs, order_items
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.scientist.observe import unfinished_tools
from fast.tasks.scientist.propose import propose_initial
from tests.studies.benchmarks.made_up_batch import Batch, measure_missing
from tests.tasks.campaign.test_state import append_grasp

CELLS = [(object_id, repeat) for object_id in (4, 7, 9) for repeat in range(2)]


def made(diagnostic, minute=0):
    object_id = 4 if diagnostic is None else diagnostic.object_id
    setup = GraspSetup() if diagnostic is None else diagnostic.setup_of(GraspSetup())
    trace = Trace(np.arange(4.0), np.arange(4.0), np.full(4, 99.0))
    started_at = datetime(2030, 1, 1, 12, minute, tzinfo=UTC)
    return MeasuredGrasp(object_id, 0, started_at, trace, "ok", "", 8.2, {"pressure_psi": 30.0}, setup, diagnostic)


@pytest.fixture
def tool(campaign):
    """A tool with one ordinary grasp of 10 N."""
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    first = campaign.state().tools_of(1)[0]
    append_grasp(campaign, first, 4, 0, 10.0)
    return first


def write(campaign, tool, grasp):
    append_diagnostic(
        campaign.lake, campaign.provenance(), tool, grasp,
        campaign_id="small", n_grasps_before=1, world_hash="W1",
    )  # fmt: skip


def test_a_diagnostic_run_enters_neither_tool_quality_nor_progress(campaign, tool):
    before = campaign.lake.query("FROM tool_quality").to_pylist(), campaign.state()
    runs = [
        DiagnosticRun(kind="reference", object_id=4),
        DiagnosticRun(kind="lift_speed", object_id=4, lift_speed_mm_per_s=20.0),
        DiagnosticRun(kind="closed_empty"),
    ]
    for minute, run in enumerate(runs):
        write(campaign, tool, made(run, minute))
    assert (campaign.lake.query("FROM tool_quality").to_pylist(), campaign.state()) == before
    assert len(campaign.lake.rows(GraspRow)) == 1
    for view in ("grasp_summary", "tool_object", "object_profile", "grasp_features"):
        assert campaign.lake.query(f"FROM {view} WHERE peak_force_n = 99").num_rows == 0


def test_kind_knobs_and_samples_are_kept(campaign, tool):
    write(campaign, tool, made(DiagnosticRun(kind="lift_speed", object_id=4, lift_speed_mm_per_s=20.0)))
    write(campaign, tool, made(DiagnosticRun(kind="closed_empty"), 1))
    sql = """SELECT kind, object_id, parameters_json::JSON ->> 'lift_speed_mm_per_s' AS speed,
        setup_json::JSON ->> 'lift_speed_mm_per_s' AS setup_speed, len(force_n) AS n, bench, n_grasps_before
        FROM diagnostics ORDER BY started_at"""
    fast, empty = campaign.lake.query(sql).to_pylist()
    assert fast == {
        "kind": "lift_speed", "object_id": 4, "speed": "20.0", "setup_speed": "20.0", "n": 4, "bench": "virtual",
        "n_grasps_before": 1,
    }  # fmt: skip
    assert (empty["kind"], empty["object_id"], empty["speed"]) == ("closed_empty", None, None)


def test_every_run_is_a_row_of_its_own_and_written_once(campaign, tool):
    run = DiagnosticRun(kind="reference", object_id=4)
    for minute in (0, 1, 1):
        write(campaign, tool, made(run, minute))
    assert len(campaign.lake.ids(DiagnosticRow)) == 2


def test_an_ordinary_grasp_is_refused(campaign, tool):
    with pytest.raises(UsageError, match="An ordinary grasp is not a diagnostic run"):
        write(campaign, tool, made(None))


def with_plan(campaign, **knobs):
    plan = DiagnosticPlan(**({"repeats": 1, "objects": (4,)} | knobs))
    return Campaign(campaign.lake, campaign.config.model_copy(update={"diagnostics": plan}))


def test_a_batch_makes_what_its_config_asks_for(campaign, tool):
    assert order_items(DiagnosticPlan(), CELLS, 0, draw_protocol(campaign, tool)) == CELLS
    campaign = with_plan(campaign, reference_every=4, protocol_slot=tool.slot, dead_weights_kg=(1.0,))
    plan, runs = campaign.config.diagnostics, draw_protocol(campaign, tool)
    items = order_items(plan, CELLS, 0, runs)
    kinds = [item.kind if isinstance(item, DiagnosticRun) else "" for item in items]
    assert kinds[:9] == ["reference", "", "", "", "", "reference", "", "", "closed_empty"], "after the grasps"
    assert "dead_weight" not in kinds, "nobody stands by"
    assert [item for item in items if not isinstance(item, DiagnosticRun)] == CELLS
    assert draw_protocol(campaign, campaign.state().tools_of(1)[1]) == [], "only one tool of a batch makes the protocol"
    assert order_items(plan, [], 6, runs) == runs


def test_the_protocol_goes_on_at_the_run_that_is_missing(campaign, tool):
    campaign = with_plan(campaign, protocol_slot=tool.slot)
    runs = draw_protocol(campaign, tool)
    owed = lambda: find_missing_runs(campaign, campaign.state(), tool)  # noqa: E731
    assert owed() == runs
    for minute, run in enumerate(runs[:4]):
        write(campaign, tool, made(run, minute))
    assert owed() == runs[4:]
    write(campaign, tool, replace(made(runs[4], 10), status="failed", details={"end": BENCH_FAULT}))
    assert owed() == runs[4:], "cut short by the bench: made again"
    write(campaign, tool, replace(made(runs[4], 11), status="failed"))
    assert owed() == runs[4:], "one more try"
    write(campaign, tool, replace(made(runs[4], 12), status="failed"))
    assert owed() == runs[5:], "given up after two failures of its own"
    assert tool in unfinished_tools(campaign, campaign.state(), 1)


def test_no_protocol_is_owed_by_a_tool_that_no_longer_hangs_there(campaign, tool):
    campaign = with_plan(campaign, protocol_slot=tool.slot)
    state = campaign.state()
    assert find_missing_runs(campaign, state, tool)
    assert find_missing_runs(campaign, replace(state, batch_on_rack=2), tool) == []
    assert find_missing_runs(campaign, replace(state, confirmed={tool.tool_id: "rejected"}), tool) == []


class Killed(BaseException):
    """The process died here."""


def test_killed_in_the_protocol_the_same_command_makes_the_rest_once(tmp_path):
    batch = Batch(2, (4,), 1)
    knobs = {"dwell_s": (0.0, 1.0), "lift_speeds_mm_per_s": (20.0,), "supply_pressures_psi": (), "closed_empty": 1}
    campaign = with_plan(batch.make(tmp_path / "lake"), protocol_slot=0, **knobs)
    made = []

    def die_at(n_runs):
        def on_grasp(_tool, grasp):
            made.append(grasp.diagnostic)
            if n_runs == len([run for run in made if run is not None]):
                raise Killed

        return on_grasp

    for n_runs in (1, 3):
        with pytest.raises(Killed):
            measure_missing(campaign, World(), die_at(n_runs))
    measure_missing(campaign, World(), die_at(None))
    tool = campaign.state().tools_of(1)[0]
    assert [run for run in made if run is not None] == draw_protocol(campaign, tool)
    assert len(campaign.lake.ids(DiagnosticRow)) == 4
    assert made.count(None) == 2
    assert not unfinished_tools(campaign, campaign.state(), 1)
