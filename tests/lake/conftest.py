from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    BatchRow,
    CampaignRow,
    DesignRow,
    FitRow,
    GraspRow,
    ObjectRow,
    Row,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    ToolRow,
    TraceRow,
)
from fast.lake.tables.requests import setup_columns
from fast.models import traces as features
from fast.models.design.space import BEST_PUBLISHED
from fast.models.records import GraspSetup, Trace
from fast.models.simulation.version import SimulatorVersion

START = datetime(2026, 3, 1, 8, tzinfo=UTC)


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake", create=True)


@pytest.fixture
def provenance() -> Provenance:
    return Provenance(code_version="abc", code_dirty=False, config_hash="cfg", seed=7, parents=("P1",))


@pytest.fixture
def make_trace() -> Callable[..., Trace]:
    def make(peak_n: float = 10.0, n: int = 60) -> Trace:
        time_s = np.arange(n) / 80
        lift_mm = np.clip(np.arange(n) - n // 3, 0, None) * 0.0625
        force_n = -1.5 + (peak_n + 1.5) * np.sin(np.linspace(0, np.pi, n)) ** 2
        return Trace(time_s=time_s, lift_mm=lift_mm, force_n=force_n)

    return make


@pytest.fixture
def make_grasp(make_trace: Callable[..., Trace]) -> Callable[..., list[Row]]:
    def make(slot: int = 0, object_id: int = 0, repeat: int = 0, peak_n: float = 10.0, **changes: object) -> list[Row]:
        tool_id = ToolRow.make_id("c1", 1, slot)
        trace = make_trace(peak_n)
        attempt = int(str(changes.get("attempt", 0)))
        values: dict[str, object] = {
            "grasp_id": GraspRow.make_id(tool_id, object_id, repeat, attempt),
            "campaign_id": "c1",
            "tool_id": tool_id,
            "batch": 1,
            "slot": slot,
            "design_id": BEST_PUBLISHED.design_id,
            "object_id": object_id,
            "repeat": repeat,
            "order": object_id * 3 + repeat,
            "status": "ok",
            "started_at": START + timedelta(minutes=object_id),
            "peak_force_n": features.peak_force_n(trace),
            "work_j": features.work_j(trace),
            "initial_force_n": features.initial_force_n(trace),
            "bench": "virtual",
            **setup_columns(GraspSetup()),
        }
        row = GraspRow.model_validate(values | changes)
        return [row, TraceRow.of(row.grasp_id, trace)]

    return make


@pytest.fixture
def make_simulation(make_trace: Callable[..., Trace]) -> Callable[..., list[Row]]:
    def make(object_id: int = 0, peak_n: float = 12.0) -> list[Row]:
        setup, version, trace = GraspSetup(), SimulatorVersion(), make_trace(peak_n)
        simulation_id = SimulationRow.make_id(BEST_PUBLISHED.design_id, object_id, version.version_id, setup.setup_id)
        row = SimulationRow(
            simulation_id=simulation_id,
            design_id=BEST_PUBLISHED.design_id,
            object_id=object_id,
            version_id=version.version_id,
            status="ok",
            peak_force_n=features.peak_force_n(trace),
            contact_force_n=3.25,
            work_j=features.work_j(trace),
            cpu_s=4.0,
            **setup_columns(setup),
        )
        return [SimulatorVersionRow.of(version), row, SimTraceRow.of(simulation_id, trace)]

    return make


@pytest.fixture
def small_rows() -> list[Row]:
    return [
        CampaignRow(campaign_id="c1", name="first", config_toml="seed = 1"),
        DesignRow.of(BEST_PUBLISHED),
        BatchRow(batch_id=BatchRow.make_id("c1", 1), campaign_id="c1", batch=1, kind="random", n_tools=2),
        ObjectRow(object_id=0, name="cube 40", object_class="cube", orientation="flat", parameters_json="{}"),
        FitRow(
            fit_id="F1",
            campaign_id="c1",
            batch=1,
            n_real=10,
            n_sim=100,
            rho=0.8,
            noise_sd_n=0.5,
            log_posterior=-12.5,
            lengthscales_h=(0.1, 0.2),
            lengthscales_e=(0.3,),
            sd_h=1.0,
            sd_e=2.0,
            seed=99,
        ),
    ]
