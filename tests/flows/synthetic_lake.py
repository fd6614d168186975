"""Builds a small made-up campaign in a lake: plausible traces (push, rise, plateau, decline), no physics run.

Numbers are functions of a seed, so two builds are equal. `Campaign.partial()` is one that has only just begun.
"""

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    BatchRow,
    CampaignRow,
    DesignRow,
    FitRow,
    GraspRow,
    ObjectRow,
    ProposalRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    ToolRow,
    TraceRow,
)
from fast.lake.tables.requests import setup_columns
from fast.models.design.space import random_designs, to_unit
from fast.models.ids import content_id, seed_from, tool_label
from fast.models.records import Design, GraspSetup, Theta, Trace
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces import initial_force_n, peak_force_n, work_j

SETUP = GraspSetup()
STARTED = datetime(2025, 3, 3, 9, 0, tzinfo=UTC)


@dataclass(frozen=True)
class Campaign:
    """Size of the made-up campaign."""

    campaign_id: str = "demo"
    n_batches: int = 2
    n_measured_batches: int = 2
    n_tools: int = 3
    n_objects: int = 4
    n_repeats: int = 3
    n_extra_simulated: int = 4
    with_simulations: bool = True
    failed_grasps: int = 2
    seed: int = 3


def build(lake: Lake, campaign: Campaign = Campaign()) -> Lake:
    """Append the whole campaign to the lake."""
    rng = np.random.default_rng(campaign.seed)
    versions = (SimulatorVersion(), SimulatorVersion(theta=Theta(young_modulus_mpa=9.86, friction=0.57)))
    designs = random_designs(campaign.n_batches * campaign.n_tools, rng)
    extra = random_designs(campaign.n_extra_simulated, rng)
    config_toml = f'name = "demo"\n\n[objects]\nids = {list(range(campaign.n_objects))}\n'
    rows: list = [CampaignRow(campaign_id=campaign.campaign_id, name="Synthetic demo", config_toml=config_toml)]
    rows += [
        ObjectRow(object_id=i, name=f"object {i}", object_class="made up", orientation="upright", parameters_json="{}")
        for i in range(campaign.n_objects)
    ]
    rows += [DesignRow.of(design) for design in [*designs, *extra]]
    rows += [SimulatorVersionRow.of(version) for version in versions]
    for batch in range(1, campaign.n_batches + 1):
        rows += _batch(campaign, batch, designs)
    for index, design in enumerate(extra):
        rows.append(_proposal(campaign, None, None, 100 + index, design))
    if campaign.with_simulations:
        for design in [*designs, *extra]:
            rows += _simulations(campaign, design, versions)
    lake.append(rows, _provenance(campaign))
    return lake


def _provenance(campaign: Campaign) -> Provenance:
    return Provenance(
        code_version="0.1.0+abc1234", code_dirty=False, config_hash="c0ffee123456", seed=campaign.seed, parents=()
    )


def _batch(campaign: Campaign, batch: int, designs: list[Design]) -> list:
    chosen = designs[(batch - 1) * campaign.n_tools : batch * campaign.n_tools]
    rows: list = [
        BatchRow(
            batch_id=BatchRow.make_id(campaign.campaign_id, batch),
            campaign_id=campaign.campaign_id,
            batch=batch,
            kind="random" if batch == 1 else "guided",
            n_tools=len(chosen),
        )
    ]
    for slot, design in enumerate(chosen):
        rows.append(_proposal(campaign, batch, slot, batch * 10 + slot, design))
        if batch > campaign.n_measured_batches:
            continue
        rows.append(
            ToolRow(
                tool_id=ToolRow.make_id(campaign.campaign_id, batch, slot),
                campaign_id=campaign.campaign_id,
                batch=batch,
                slot=slot,
                design_id=design.design_id,
                status="printed",
                material_lot="AG-85A-017",
                operator="R. Lane",
                confirmed_by="person",
            )
        )
        rows += _grasps(campaign, batch, slot, design)
    if batch <= campaign.n_measured_batches and batch > 1:
        rows.append(_fit(campaign, batch))
    return rows


def _proposal(campaign: Campaign, batch: int | None, slot: int | None, index: int, design: Design) -> ProposalRow:
    return ProposalRow(
        proposal_id=content_id("P", [campaign.campaign_id, index]),
        campaign_id=campaign.campaign_id,
        batch=batch,
        slot=slot,
        index=index,
        fidelity="sim" if batch is None else "real",
        design_id=design.design_id,
        acquisition="random" if batch == 1 else "mes",
        acquisition_value=None if batch == 1 else 0.031,
        n_real=0,
        n_sim=0,
        n_pending=0,
    )


def _fit(campaign: Campaign, batch: int) -> FitRow:
    return FitRow(
        fit_id=content_id("F", [campaign.campaign_id, batch]),
        campaign_id=campaign.campaign_id,
        batch=batch,
        n_real=(batch - 1) * campaign.n_tools,
        n_sim=8,
        rho=1.24,
        noise_sd_n=0.31,
        log_posterior=-41.2,
        loo_rmse_n=1.9,
        lengthscales_h=(0.5,) * 9,
        lengthscales_e=(0.8,) * 9,
        sd_h=4.0,
        sd_e=2.0,
        seed=campaign.seed,
        purpose="tools",
        nugget_n=0.02,
        mean_sim_n=12.0,
        mean_real_n=10.0,
        loo_coverage_90=0.88,
        loo_q2=0.7,
        sim_loo_rmse_n=0.8,
        sim_loo_coverage_90=0.9,
        sim_loo_q2=0.9,
        shared_variance=0.86,
        measured_only_loo_rmse_n=1.92,
        n_outliers=0,
    )


def _grasps(campaign: Campaign, batch: int, slot: int, design: Design) -> list:
    rows: list = []
    tool_id = ToolRow.make_id(campaign.campaign_id, batch, slot)
    for object_id in range(campaign.n_objects):
        for repeat in range(campaign.n_repeats):
            order = (slot * campaign.n_objects + object_id) * campaign.n_repeats + repeat
            started = STARTED + timedelta(days=batch - 1, seconds=24 * order)
            has_failed = batch == 1 and order < campaign.failed_grasps
            rng = np.random.default_rng(seed_from(campaign.seed, tool_id, object_id, repeat))
            trace = made_up_trace(design, object_id, 1.15 + 0.22 * (batch - 1), rng)
            grasp_id = GraspRow.make_id(tool_id, object_id, repeat)
            scalars = (
                {}
                if has_failed
                else {
                    "peak_force_n": peak_force_n(trace),
                    "work_j": work_j(trace),
                    "initial_force_n": initial_force_n(trace),
                    "tare_force_n": 0.02,
                }
            )
            rows.append(
                GraspRow(
                    grasp_id=grasp_id,
                    campaign_id=campaign.campaign_id,
                    tool_id=tool_id,
                    batch=batch,
                    slot=slot,
                    design_id=design.design_id,
                    object_id=object_id,
                    repeat=repeat,
                    order=order,
                    status="failed" if has_failed else "ok",
                    reason="separation_not_found" if has_failed else "",
                    started_at=started,
                    bench="virtual",
                    world_hash="w0r1d0000007",
                    details_json=json.dumps({"label": tool_label(batch, slot)}),
                    **scalars,
                    **setup_columns(SETUP),
                )
            )
            if not has_failed:
                rows.append(TraceRow.of(grasp_id, trace))
    return rows


def _simulations(campaign: Campaign, design: Design, versions: tuple[SimulatorVersion, ...]) -> list:
    rows: list = []
    for number, version in enumerate(versions):
        for object_id in range(campaign.n_objects):
            has_failed = object_id == 1 and design.rib_count == 1
            trace = made_up_trace(design, object_id, 0.95 + 0.15 * number, None)
            simulation_id = SimulationRow.make_id(design.design_id, object_id, version.version_id, SETUP.setup_id)
            scalars = (
                {}
                if has_failed
                else {"peak_force_n": peak_force_n(trace), "contact_force_n": 6.0, "work_j": work_j(trace)}
            )
            rows.append(
                SimulationRow(
                    simulation_id=simulation_id,
                    design_id=design.design_id,
                    object_id=object_id,
                    version_id=version.version_id,
                    status="failed" if has_failed else "ok",
                    reason="no_convergence" if has_failed else "",
                    n_dof=1800,
                    n_newton=210,
                    cpu_s=1.4 + 0.1 * object_id,
                    **scalars,
                    **setup_columns(SETUP),
                )
            )
            if not has_failed:
                rows.append(SimTraceRow.of(simulation_id, trace))
    return rows


def made_up_trace(design: Design, object_id: int, level: float, rng: np.random.Generator | None) -> Trace:
    """Closing for 1.35 s, then a lift of 40 mm: push, rise, plateau, decline, zero. Noise where `rng` is given."""
    rate_hz = 80.0 if rng is not None else 6.0
    unit = to_unit([design])[0]
    closing_s = 27.0 / SETUP.close_speed_mm_per_s
    time_s = np.arange(0.0, closing_s + 40.0 / SETUP.lift_speed_mm_per_s, 1.0 / rate_hz)
    lift_mm = np.maximum(time_s - closing_s, 0.0) * SETUP.lift_speed_mm_per_s
    push_n = 1.0 + 0.4 * (object_id % 4)
    peak_n = level * (9.0 + 9.0 * unit[6] + 6.0 * unit[4]) * (0.45 + 0.22 * (object_id % 5))
    let_go_mm = 16.0 + 3.0 * (object_id % 6)
    rise = 1 - np.exp(-lift_mm / (2.0 + object_id % 3))
    hold = 1 / (1 + np.exp((lift_mm - let_go_mm) / 2.2))
    force_n = (peak_n + push_n) * rise * hold - push_n * np.clip(time_s / closing_s, 0, 1) * hold
    if rng is not None:
        force_n = force_n * rng.normal(1.0, 0.02) + rng.normal(0.0, 0.12, force_n.size)
    return Trace(time_s=time_s, lift_mm=lift_mm, force_n=force_n)
