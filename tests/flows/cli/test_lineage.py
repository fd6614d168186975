"""From a number back to its rows: `fast lake lineage` on rows that the campaign's own tasks wrote."""

from concurrent.futures import Future
from contextlib import contextmanager
from datetime import UTC, datetime

import numpy as np
import pytest

from fast.flows.report.campaign.queries import FITS, fetch
from fast.hardware.station.station import MeasuredGrasp
from fast.lake.provenance import Provenance
from fast.lake.query.lineage import UNKNOWN, Node, find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    TABLE_BY_NAME,
    TABLES,
    DesignRow,
    EventRow,
    FitRow,
    GraspRow,
    SimulationRow,
    ToolRow,
)
from fast.lake.tables.links import LINKS, is_linked, summary_columns
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.schema import has_samples
from fast.models.design.space import BEST_PUBLISHED
from fast.models.records import GraspSetup, GraspSimulation, Trace
from fast.tasks.bench.measure import BenchUse, measure_tool
from fast.tasks.bench.plan import plan_tool
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.setup import register
from fast.tasks.scientist.fit import fit, surrogate_for_simulation
from fast.tasks.scientist.observe import observe, observed_rows
from fast.tasks.scientist.propose import propose_initial, propose_simulation, propose_tools
from fast.tasks.simulation.attempt import Attempt
from fast.tasks.simulation.simulate import simulate_design
from tests.flows.cli.cli_lakes import Fast

CONFIG = {
    "name": "small",
    "seed": 3,
    "schedule": {
        "initial_tools": 2,
        "tools_per_batch": 2,
        "guided_batches": 1,
        "initial_simulations": 2,
        "simulations_per_batch": 2,
    },
    "objects": {"ids": [4, 7], "repeats": 2},
    "bench": {"world": "world.toml"},
}
N_GRASPS, N_SIMULATIONS = 2 * 2 * 2, 2 * 2  # of the first batch
LIFT_MM = np.linspace(0, 10, 11)


class Cell:
    """A bench whose grasps are made up; the first of a whole plan fails, a second call repeats it."""

    def measure_tool(self, slot, plan, setup, record, should_stop):
        for number, (object_id, repeat) in enumerate(plan):
            trace = Trace(time_s=LIFT_MM / 5, lift_mm=LIFT_MM, force_n=(9 + slot + object_id) * np.sin(LIFT_MM / 4))
            started = datetime(2026, 3, 1, 8, slot, number, tzinfo=UTC)
            status, reason = ("failed", "separation_not_found") if (number, len(plan)) == (0, 4) else ("ok", "")
            record(MeasuredGrasp(object_id, repeat, started, trace, status, reason, 0.02))


class Pool:
    """A worker that answers at once with a made-up simulation."""

    ends_hangs = False

    def __init__(self):
        self.n_done = 0

    @contextmanager
    def lend(self):
        yield self

    def submit(self, function, *arguments):
        self.n_done += 1
        peak_n = 8.0 + self.n_done % 5
        trace = Trace(time_s=LIFT_MM / 5, lift_mm=LIFT_MM, force_n=peak_n * np.sin(LIFT_MM / 4))
        numbers = {"peak_force_n": peak_n, "contact_force_n": peak_n / 2, "work_j": 0.1, "cpu_s": 0.5}
        result = GraspSimulation(trace=trace, **numbers, n_steps=3, n_newton=9, n_dof=30)
        future = Future()
        future.set_result(Attempt(result, "", "", cpu_s=0.6, mesh_cpu_s=0.1, wall_s=0.7))
        return future


def measure(campaign, batch):
    confirm_print(campaign.lake, "small", batch, PrintConfirmation(operator="ada"))
    for tool in campaign.state().tools_of(batch):
        for _ in range(2):
            work = plan_tool(campaign, campaign.state(), tool)
            measure_tool(campaign, Cell(), work, BenchUse(None, "w1"))


def run_campaign(campaign):
    """Two batches, each measured and its tools' designs and proposals simulated, by the tasks that flows call."""
    register(campaign, "name = 'small'")
    propose_initial(campaign)
    pool = Pool()
    for proposal in campaign.state().simulations_of(1):
        simulate_design(campaign, proposal.design, pool=pool)
    measure(campaign, 1)
    state = campaign.state()
    data, rows = observe(campaign, state, [1]), observed_rows(campaign, state, [1])
    propose_tools(campaign, 2, data, fit(campaign, 2, data, rows), state)
    surrogate, fit_id = surrogate_for_simulation(campaign, 2, 0, data, lambda: rows)
    propose_simulation(campaign, 2, 0, surrogate, fit_id, campaign.state())
    measure(campaign, 2)
    simulate_design(campaign, campaign.state().simulations_of(2)[0].design, pool=pool)
    append_event(campaign.lake, "small", "finished", "all done")
    return campaign.lake


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    root = tmp_path_factory.mktemp("lineage") / "lake"
    return run_campaign(Campaign(Lake.open(root, create=True), CampaignConfig.model_validate(CONFIG)))


@pytest.fixture
def fast(capsys, monkeypatch, lake):
    monkeypatch.setenv("FAST_LAKE", str(lake.root))
    return Fast(capsys)


def ids(nodes, table):
    return {node.row_id for node in nodes if node.table == table}


def test_from_a_tool_quality_to_grasps_traces_design_proposal_fit_and_config(lake, fast):
    tool_id = lake.query("FROM tool_quality WHERE batch = 2 ORDER BY tool_id").to_pylist()[0]["tool_id"]
    behind = fast("lake", "lineage", tool_id, "--children", "--json").json
    assert behind["root"] == f"tools/{tool_id}"
    grasps = [entry for entry in behind["nodes"] if entry["table"] == "grasps"]
    assert {entry["id"] for entry in grasps} == {row["grasp_id"] for row in lake.rows(GraspRow, tool_id=tool_id)}
    mean = np.mean([entry["row"]["peak_force_n"] for entry in grasps if entry["row"]["status"] == "ok"])
    quality = lake.query("SELECT tool_quality_n FROM tool_quality WHERE tool_id = $1", [tool_id])[0][0].as_py()
    assert mean == pytest.approx(quality)

    found = fast("lake", "lineage", grasps[0]["id"], "--json").json
    nodes = {entry["node"]: entry for entry in found["nodes"]}
    edges = {(edge["child"], edge["parent"]) for edge in found["edges"]}
    grasp = f"grasps/{grasps[0]['id']}"
    tool = lake.rows(ToolRow, tool_id=tool_id)[0]
    (proposal,) = {parent for child, parent in edges if child == f"tools/{tool_id}" and parent.startswith("proposals/")}
    (fitted,) = {parent for child, parent in edges if child == proposal and parent.startswith("fits/")}
    for parent in (f"traces/{grasps[0]['id']}", f"tools/{tool_id}", f"designs/{tool['design_id']}", "campaigns/small"):
        assert (grasp, parent) in edges
    assert (f"designs/{tool['design_id']}", proposal) in edges
    seen = {parent for child, parent in edges if child == fitted}
    assert len([name for name in seen if name.startswith("grasps/")]) == N_GRASPS
    assert len([name for name in seen if name.startswith("simulations/")]) == N_SIMULATIONS
    assert {nodes[name]["config_campaign"] for name in (grasp, proposal, fitted, f"tools/{tool_id}")} == {"small"}
    assert nodes["campaigns/small"]["row"]["config_toml"] == "name = 'small'"
    assert nodes[fitted]["row"]["seed"] != 0
    assert nodes[grasp]["seed"] != 0
    assert nodes[grasp]["code_version"]


def test_every_row_of_a_campaign_hangs_on_it_and_names_its_config(lake):
    found = find_lineage(lake, "small", forward=True)
    own_reason = {"objects", "simulator_versions"}
    for row_type in TABLES:
        if not has_samples(row_type) and row_type.table not in own_reason:
            assert ids(found.rows, row_type.table) == lake.ids(row_type), row_type.table
    assert all(row.provenance["config_hash"] in found.campaign_of_config for row in found.rows.values())


def test_nothing_a_row_came_from_is_missing(lake):
    latest = lake.rows(SimulationRow)[-1]["simulation_id"]
    found = find_lineage(lake, latest)
    assert UNKNOWN not in {node.table for node in found.rows}
    assert None not in found.rows.values()
    tables = {node.table for node in found.rows}
    assert tables >= {"sim_traces", "designs", "proposals", "fits", "grasps", "traces", "tools", "batches", "campaigns"}
    failed = {row["grasp_id"] for row in lake.rows(GraspRow, status="failed")}
    assert failed
    assert not failed & ids(found.rows, "grasps")  # a fit saw the good grasps alone


def test_a_random_proposal_has_no_fit(lake):
    found = find_lineage(lake, "small/B01T0")
    assert {node.table for node in found.rows} == {"tools", "designs", "proposals", "batches", "campaigns"}


def test_tree_names_each_row_once_and_counts_large_groups(lake, fast):
    grasp = lake.rows(GraspRow, tool_id="small/B02T0")[0]["grasp_id"]
    lines = fast("lake", "lineage", grasp).out.splitlines()
    assert lines[0].startswith(f"grasp {grasp}: tool_id small/B02T0, object_id ")
    assert lines[1].startswith("│  20")
    assert " of campaign small, seed " in lines[1]
    assert len([line for line in lines if "─ tool small/B02T0:" in line]) == 1
    assert len([line for line in lines if f"─ {N_GRASPS} grasps: K" in line]) == 1
    assert "│  │" in "".join(lines)
    assert lines[-2].endswith(f"└─ trace {grasp}")
    assert any("─ 8 grasps" not in line and "─ simulation S" in line for line in lines)  # 4 of them: few enough


def test_rows_counted_below_a_tool_are_not_counted_again_below_its_design(lake, fast):
    design_id = lake.rows(ToolRow, tool_id="small/B02T0")[0]["design_id"]
    lines = fast("lake", "lineage", design_id, "--children", "--limit", 4).out.splitlines()
    assert [line for line in lines if " 5 grasps: " in line] == lines[-1:]
    assert lines[-1].startswith("   └─ ")  # below the tool


def test_depth_and_limit_bound_what_is_followed(lake, fast):
    near = fast("lake", "lineage", "small/B02T0", "--depth", 1, "--json").json
    assert {entry["table"] for entry in near["nodes"]} == {"tools", "campaigns", "designs", "proposals"}
    assert {edge["child"] for edge in near["edges"]} == {"tools/small/B02T0"}
    alone = fast("lake", "lineage", "small/B02T0", "--depth", 0, "--json").json
    assert [entry["node"] for entry in alone["nodes"]] == ["tools/small/B02T0"]
    counted = fast("lake", "lineage", "small/B02T0", "--children", "--limit", 0, "--json").json
    (group,) = counted["not_followed"]
    assert (group["table"], group["n_rows"], len(group["first_ids"])) == ("grasps", 5, 3)
    assert "--depth is -1, it must be at least 0" in fast.refused("lake", "lineage", "small", "--depth", -1)


@pytest.mark.parametrize(
    ("wanted", "closest"),
    [("small/B02T9", "`small/B02T0` (tools)"), ("B02T1", "the closest ids are `small/B02T1` (tools)")],
)
def test_an_unknown_id_gets_the_closest_ones(fast, wanted, closest):
    sentence = fast.refused("lake", "lineage", wanted)
    assert f"has the id `{wanted}`; " in sentence
    assert closest in sentence


def test_any_id_is_found(lake):
    for row_type in TABLES:
        for row_id in map(str, list(lake.ids(row_type))[:1]):
            root = find_lineage(lake, row_id, depth=0).root
            samples_of = {"traces": "grasps", "sim_traces": "simulations"}
            assert root == Node(samples_of.get(row_type.table, row_type.table), row_id)


def test_superseded_rows_and_missing_parents_are_shown_as_such(tmp_path, monkeypatch, capsys):
    lake = Lake.open(tmp_path / "lake", create=True)
    design = DesignRow.of(BEST_PUBLISHED)
    grasp = GraspRow(
        grasp_id="K1", campaign_id="import-x", tool_id="their-tool", design_id=design.design_id, object_id=3, repeat=0,
        status="ok", bench="real", **setup_columns(GraspSetup()),
    )  # fmt: skip
    for code, peak_n in (("old1", 4.0), ("new2", 5.0)):
        changed = grasp.model_copy(update={"peak_force_n": peak_n})
        lake.append([design, changed], Provenance(code_version=code, code_dirty=code == "old1", parents=("Xlost",)))
    monkeypatch.setenv("FAST_LAKE", str(lake.root))
    fast = Fast(capsys)
    lines = fast("lake", "lineage", "K1").out.splitlines()
    assert "peak_force_n 5" in lines[0]
    assert "code new2" in lines[1]
    assert "superseded: " in lines[2]
    assert "code old1 with local changes" in lines[2]
    for absent in ("tool their-tool", "object 3", "campaign import-x", "Xlost"):
        assert any(line.endswith(f"─ {absent}: not in this lake") for line in lines), absent
    node = fast("lake", "lineage", "K1", "--json").json["nodes"][0]
    assert (node["row"]["peak_force_n"], [old["peak_force_n"] for old in node["superseded"]]) == (5.0, [4.0])


def test_an_empty_lake_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FAST_LAKE", str(Lake.open(tmp_path / "lake", create=True).root))
    assert Fast(capsys).refused("lake", "lineage", "K1").endswith("the lake is empty.")


def test_links_name_tables_and_columns_that_exist(lake):
    for link in LINKS:
        assert {link.child, link.parent} <= set(TABLE_BY_NAME)
        assert lake.query(link.pairs).column_names == ["child", "parent"]
    assert is_linked("tools", "proposals")
    assert is_linked("proposals", "tools")
    assert not is_linked("fits", "grasps")
    for row_type in TABLES:
        assert set(summary_columns(row_type.table)) <= set(row_type.model_fields)


def test_the_report_shows_the_fit_that_the_tools_were_chosen_with(lake):
    chosen = find_lineage(lake, "small/B02", depth=1)
    assert len(lake.ids(FitRow)) == 2  # one more chose a simulation
    (fit_id,) = ids(chosen.rows, "fits")
    (shown,) = fetch(lake, "fits", FITS, "small").rows
    assert shown["rho"] == lake.rows(FitRow, fit_id=fit_id)[0]["rho"]


def test_parents_of_an_event_are_its_campaign(lake):
    event_id = lake.rows(EventRow)[-1]["event_id"]
    assert list(find_lineage(lake, event_id).rows) == [Node("events", event_id), Node("campaigns", "small")]
