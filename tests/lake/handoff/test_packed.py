"""A small lake in one file: rows come back as they were, samples to the steps in which they are kept."""

from pathlib import Path

import numpy as np
import pytest

from fast.lake.handoff.packed import read_packed, write_packed
from fast.lake.tables.campaign import (
    DesignRow,
    GraspRow,
    PosteriorDrawsRow,
    SimTraceRow,
    SimulationRow,
    TraceRow,
)
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.row import Row
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.records import GraspSetup, Trace
from fast.models.traces.step_features import step_means


def made_trace(rng: np.random.Generator, n: int, noise_n: float) -> Trace:
    time_s = np.cumsum(rng.uniform(0.01, 0.2, n))
    lift_mm = 5.0 * np.maximum(time_s - time_s[n // 4] - 0.003, 0.0)
    return Trace(time_s, lift_mm, 8.0 * np.sin(0.1 * lift_mm) + noise_n * rng.standard_normal(n))


def made_rows() -> list[Row]:
    rng = np.random.default_rng(0)
    design, setup = numbered_design(0), setup_columns(GraspSetup())
    grasp = GraspRow(
        grasp_id="K1", campaign_id="c", tool_id="c/B01T0", design_id=design.design_id, object_id=3, repeat=0,
        status="ok", bench="virtual", **setup,
    )  # fmt: skip
    lost = grasp.model_copy(update={"grasp_id": "K2", "repeat": 1, "status": "failed", "reason": "dropped"})
    simulations = [
        SimulationRow(
            simulation_id=f"S{k}", design_id=design.design_id, object_id=k, version_id="V", status="ok", **setup
        )
        for k in range(3)
    ]
    draws = PosteriorDrawsRow.of("L1", 0, "friction", rng.normal(0.6, 0.01, 500))
    traces = [SimTraceRow.of(f"S{k}", made_trace(rng, 60 + k, 0.0)) for k in range(3)]
    return [
        DesignRow.of(design), grasp, lost, TraceRow.of("K1", made_trace(rng, 300, 0.1)), *simulations, *traces, draws
    ]  # fmt: skip


def test_rows_come_back(tmp_path: Path) -> None:
    rows = made_rows()
    write_packed(tmp_path / "lake.npz", rows)
    back = {(row.table, getattr(row, row.id_column())): row for row in read_packed(tmp_path / "lake.npz")}
    assert len(back) == len(rows)
    for row in rows:
        found = back[row.table, getattr(row, row.id_column())]
        assert type(found) is type(row)
        if isinstance(row, TraceRow | SimTraceRow):
            assert isinstance(found, TraceRow | SimTraceRow)
            step_n = 0.01 if isinstance(row, TraceRow) else 0.001
            assert np.abs(found.time_s - row.time_s).max() <= 0.51e-4
            assert np.abs(found.lift_mm - row.lift_mm).max() <= 0.51e-3
            assert np.abs(found.force_n - row.force_n).max() <= 0.51 * step_n
            at_end_n = 8.0 * 0.51e-3 / 0.5  # where a trace ends under force, its last step is as long as it
            assert np.abs(step_means(found.trace) - step_means(row.trace)).max() < step_n + at_end_n
        elif isinstance(row, PosteriorDrawsRow):
            assert isinstance(found, PosteriorDrawsRow)
            assert np.abs(found.draws - row.draws).max() < 1e-4 * np.ptp(row.draws)
            assert found.model_dump(exclude={"draws"}) == row.model_dump(exclude={"draws"})
        else:
            assert found == row


def test_a_trace_that_never_lifts_comes_back(tmp_path: Path) -> None:
    flat = SimTraceRow.of("S1", Trace(np.array([0.0, 0.5]), np.zeros(2), np.array([0.0, 70000.0])))
    write_packed(tmp_path / "flat.npz", [flat])
    (found,) = read_packed(tmp_path / "flat.npz")
    assert isinstance(found, SimTraceRow)
    assert found.force_n.tolist() == [0.0, 70000.0]
    assert not found.lift_mm.any()


def test_another_file_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.npz"
    np.savez(other, rows=np.zeros(3))
    with pytest.raises(UsageError, match=r"other\.npz is not a packed lake of this version"):
        read_packed(other)
    with pytest.raises(UsageError, match="is not a packed lake"):
        read_packed(tmp_path / "nothing.npz")
