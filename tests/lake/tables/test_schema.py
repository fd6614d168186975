import numpy as np
import pyarrow as pa
import pytest
from pydantic import ValidationError

from fast.lake.provenance import ProvenanceColumns, current_provenance, stamped
from fast.lake.tables.campaign import (
    TABLE_BY_NAME,
    TABLES,
    DesignRow,
    FitRow,
    GraspRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    TraceRow,
)
from fast.lake.tables.schema import has_samples, schema_of, to_arrow
from fast.models.design.space import BEST_PUBLISHED, PARAMETERS
from fast.models.simulation.version import SimulatorVersion
from fast.models.units import unit_of

CONTRACT = {
    "campaigns",
    "designs",
    "objects",
    "materials",
    "batches",
    "proposals",
    "tools",
    "simulator_versions",
    "simulations",
    "sim_traces",
    "grasps",
    "traces",
    "fits",
    "calibrations",
    "posterior_draws",
    "effects",
    "gap_findings",
    "grasp_requests",
    "trace_features",
    "anomaly_flags",
    "events",
    "flow_runs",
}


def test_every_table_of_the_contract_is_there():
    assert set(TABLE_BY_NAME) == CONTRACT


@pytest.mark.parametrize("row_type", TABLES, ids=lambda t: t.table)
def test_schema_starts_with_the_id_and_ends_with_provenance(row_type):
    schema = schema_of(row_type)
    assert schema.names[0] == row_type.id_column()
    assert len(set(schema.names)) == len(schema.names)
    assert set(ProvenanceColumns.model_fields) <= set(schema.names)
    assert schema.field("created_at").type == pa.timestamp("us", tz="UTC")
    assert schema.metadata[b"fast.schema_version"] == b"1"


@pytest.mark.parametrize("row_type", TABLES, ids=lambda t: t.table)
def test_unit_metadata_agrees_with_the_name(row_type):
    for field in schema_of(row_type):
        written = (field.metadata or {}).get(b"unit", b"").decode() or None
        assert written == unit_of(field.name), field.name


def test_a_pressure_has_its_unit():
    assert schema_of(SimulationRow).field("pressure_kpa").metadata[b"unit"] == b"kPa"


def test_types_follow_the_annotations():
    schema = schema_of(GraspRow)
    assert schema.field("peak_force_n").type == pa.float64()
    assert schema.field("peak_force_n").nullable
    assert not schema.field("grasp_id").nullable
    assert schema.field("batch").type == pa.int64()
    assert schema.field("status").type == pa.string()
    assert schema_of(TraceRow).field("force_n").type == pa.list_(pa.float64())
    sampled = [t.table for t in TABLES if has_samples(t)]
    assert sampled == ["traces", "sim_traces", "posterior_draws"]


def test_samples_are_written_before_the_scalars_that_announce_them():
    order = [t.table for t in TABLES]
    assert order.index("traces") < order.index("grasps")
    assert order.index("sim_traces") < order.index("simulations")


def test_design_row_has_the_nine_parameters_and_gives_the_design_back():
    row = DesignRow.of(BEST_PUBLISHED)
    assert tuple(DesignRow.model_fields) == ("design_id", *PARAMETERS, "family", "parameters_json")
    assert row.design == BEST_PUBLISHED
    assert row.design_id == BEST_PUBLISHED.design_id


def test_simulator_version_row_gives_the_version_back():
    version = SimulatorVersion(tier="reference")
    assert SimulatorVersionRow.of(version).version == version


def test_channels_of_unequal_length_are_refused():
    with pytest.raises(ValidationError, match="differ in length"):
        TraceRow(grasp_id="K", time_s=[0, 1], lift_mm=[0, 1], force_n=[0])


def test_not_a_number_is_refused():
    with pytest.raises(ValidationError, match="finite"):
        SimTraceRow(simulation_id="S", time_s=[0], lift_mm=[0], force_n=[np.nan])


def test_a_column_of_the_row_wins_over_provenance(small_rows, provenance):
    fit = [row for row in small_rows if isinstance(row, FitRow)]
    table = to_arrow(fit, stamped(provenance, 1))
    assert table["seed"].to_pylist() == [99]
    assert table["lengthscales_h"].to_pylist() == [[0.1, 0.2]]


def test_current_provenance_names_the_code():
    provenance = current_provenance("cfg", 3, ["a"])
    assert provenance.code_version
    assert (provenance.config_hash, provenance.seed, provenance.parents) == ("cfg", 3, ("a",))


def test_without_git_the_package_version_is_the_code_version(monkeypatch):
    monkeypatch.setenv("PATH", "")
    _cached = current_provenance.__globals__["_code_version"]
    _cached.cache_clear()
    monkeypatch.setattr("importlib.metadata.version", lambda name: "9.9")
    assert current_provenance().code_version == "9.9"
    _cached.cache_clear()
