"""The state is what the rows say, whatever happened to the lake: kills, corrections, merged files, lost traces."""

import random
from collections import defaultdict
from dataclasses import replace

import pytest

from fast.lake.maintenance import compact
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, GraspRow, ProposalRow, SimulationRow, TraceRow
from fast.models.design.space import numbered_design
from fast.models.records import BENCH_FAULT, Theta
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.state import derive_state
from fast.tasks.scientist.propose import propose_initial
from tests.tasks.simulation.made_up import append_grasp, append_simulation

OLDER = SimulatorVersion(theta=Theta(friction=0.31))
FOREIGN = SimulatorVersion(theta=Theta(friction=0.77))
N_STEPS = 40


class History:
    """Things that happen to a lake: rows of this process and of others, merged files, restarts."""

    def __init__(self, campaign, seed: int) -> None:
        self.random = random.Random(seed)
        self.campaign = replace(campaign, versions=(OLDER, campaign.version))
        self.other = replace(self.campaign, lake=Lake(campaign.lake.address))
        self.n_proposed = 0

    def step(self) -> str:
        what = self.random.choice((self.grasp, self.grasp, self.simulate, self.simulate, self.propose, self.merge))
        what()
        if self.random.random() < 0.05:
            self.campaign.lake.close()
        return what.__name__

    @property
    def writer(self):
        return self.random.choice((self.campaign, self.other))

    def grasp(self) -> None:
        tool = self.random.choice(self.campaign.state().tools)
        cell, status = self.random.choice(((4, 0), (4, 1), (7, 0), (7, 1))), self.random.choice(("ok", "ok", "failed"))
        kind, attempt = self.random.random(), self.random.randrange(3)
        if kind < 0.2:  # its trace is lost
            row = append_row(tool, cell, attempt, self.campaign)
            self.writer.lake.append([row], self.campaign.provenance())
        elif kind < 0.4:
            row = append_row(tool, cell, attempt, self.campaign, status="failed", end=BENCH_FAULT)
            self.writer.lake.append([row], self.campaign.provenance())
        else:
            bench = "real" if kind > 0.95 else "virtual"
            append_grasp(self.writer, tool, *cell, 10.0 + self.random.random(), attempt, status, bench)

    def simulate(self) -> None:
        design = numbered_design(self.random.randrange(4))
        force_n = self.random.choice((5.0, 6.0, None))
        version = self.random.choice((self.campaign.version, self.campaign.version, OLDER, FOREIGN))
        append_simulation(self.writer, design, self.random.choice((4, 7)), force_n, version)

    def propose(self) -> None:
        design, self.n_proposed = numbered_design(self.n_proposed), self.n_proposed + 1
        row = ProposalRow(
            proposal_id=f"P{self.n_proposed}", campaign_id=self.campaign.campaign_id, batch=2, index=self.n_proposed,
            fidelity="sim", design_id=design.design_id, acquisition="random", n_real=0, n_sim=0, n_pending=0, slot=None,
        )  # fmt: skip
        self.writer.lake.append([DesignRow.of(design), row], self.campaign.provenance())

    def merge(self) -> None:
        compact(self.writer.lake, self.random.choice((GraspRow, TraceRow, SimulationRow, ProposalRow, DesignRow)))


def append_row(tool, cell, attempt, campaign, status="ok", end=""):
    setup_id, (object_id, repeat) = campaign.config.grasp.setup_id, cell
    return GraspRow(
        grasp_id=GraspRow.make_id(tool.tool_id, object_id, repeat, attempt), campaign_id=campaign.campaign_id,
        tool_id=tool.tool_id, batch=tool.batch, slot=tool.slot, design_id=tool.design.design_id, object_id=object_id,
        repeat=repeat, attempt=attempt, status=status, setup_id=setup_id, setup_json="{}", bench="virtual", work_j=0.1,
        details_json=f'{{"end":"{end}"}}',
    )  # fmt: skip


def fresh_state(campaign):
    config, present = campaign.config, {campaign.version.version_id}
    lake = Lake.open(campaign.lake.address)
    return derive_state(lake, campaign.campaign_id, config.grasp.setup_id, present, {OLDER.version_id})


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.study) for seed in (1, 2))])
def test_the_state_is_what_the_rows_say(campaign, seed):
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada", rejected={1: "torn"}))
    history = History(campaign, seed)
    steps = []
    for number in range(N_STEPS):
        steps.append(history.step())
        if number % 8 == 0:
            assert history.campaign.state() == fresh_state(history.campaign), steps
    state = history.campaign.state()
    assert state == fresh_state(history.campaign), steps
    assert (state.measured, state.failures, state.next_attempts) == expected_grasps(history.campaign), steps
    assert state.simulated == expected_simulated(history.campaign, history.campaign.version)
    assert state.simulated_before == expected_simulated(history.campaign, OLDER)
    assert {tool.tool_id: tool.design for tool in state.tools} == expected_designs(history.campaign)
    assert state.confirmed == {"small/B01T0": "printed", "small/B01T1": "rejected"}


def expected_grasps(campaign):
    """Measured cells of each tool; failures, and numbers of the next attempt, of each cell that has had trouble."""
    traces = campaign.lake.ids(TraceRow)
    measured, failures, failed, lost = defaultdict(set), defaultdict(int), {}, {}
    for row in sorted(campaign.lake.rows(GraspRow, campaign_id="small"), key=lambda row: row["attempt"]):
        cell = row["object_id"], row["repeat"]
        if row["status"] != "ok":
            failed[row["tool_id"], cell] = row["attempt"] + 1
            if BENCH_FAULT not in row["details_json"]:
                failures[row["tool_id"], cell] += 1
        elif row["grasp_id"] in traces:
            measured[row["tool_id"]].add(cell)
        else:
            lost[row["tool_id"], cell] = row["attempt"]
    return measured, failures, failed | lost


def expected_simulated(campaign, version):
    found = defaultdict(set)
    for row in campaign.lake.rows(SimulationRow, version_id=version.version_id):
        found[row["design_id"]].add(row["object_id"])
    return found


def expected_designs(campaign):
    designs = {row.design_id: row.design for row in campaign.lake.records(DesignRow)}
    rows = campaign.lake.rows(ProposalRow, campaign_id="small", fidelity="real")
    return {f"small/B{row['batch']:02d}T{row['slot']}": designs[row["design_id"]] for row in rows}
