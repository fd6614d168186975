"""Which table's rows come from which other table's rows, as data: what `lake.query.lineage` follows.

Most links follow from the names: a column called like the id of another table names a row of that table.
The few that do not are written out below. Rows also store the ids they were computed from (`parents`), but
all rows of one append share that list; where a link exists between two tables, the link is the exact one.
"""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import NamedTuple

from fast.lake.tables.campaign import TABLE_BY_NAME, TABLES, Row
from fast.lake.tables.schema import has_samples


class Link(NamedTuple):
    """`pairs` is a SELECT of `child` and `parent` ids: rows of table `child` come from rows of table `parent`."""

    child: str
    parent: str
    by: str
    pairs: str


def key_of(table: str) -> str:
    """Write the SQL of a table's id as text."""
    return f"{TABLE_BY_NAME[table].id_column()}::VARCHAR"


def _named_links() -> Iterator[Link]:
    """Yield a link for every column that is called like the id of another table.

    A row with a `base_version_id` came from that version, and made the one of its `version_id`.
    """
    for row_type, other in product(TABLES, TABLES):
        table, key = row_type.table, other.id_column()
        if (table, other.table) in _OTHERWISE or not _names(row_type, other):
            continue
        if has_samples(other):  # asked of their index, as a failed grasp may have none
            yield Link(table, other.table, key, f"SELECT {key} AS child, {key} AS parent FROM raw_{other.table}")
        elif (base := f"base_{key}") in row_type.model_fields:
            yield _column_link(table, other.table, base)
            made = f"SELECT {key}::VARCHAR AS child, {key_of(table)} AS parent FROM {table}"
            yield Link(other.table, table, key, made)
        else:
            yield _column_link(table, other.table, key)


def _names(row_type: type[Row], other: type[Row]) -> bool:
    """Return whether a column of `row_type` is the id of `other`; scalars share the id of their samples."""
    key = other.id_column()
    return key in row_type.model_fields and (key != row_type.id_column() or _are_samples_of(other, row_type))


def _are_samples_of(other: type[Row], row_type: type[Row]) -> bool:
    return has_samples(other) and not has_samples(row_type)


def _column_link(child: str, parent: str, column: str) -> Link:
    return Link(child, parent, column, f"SELECT {key_of(child)} AS child, {column}::VARCHAR AS parent FROM {child}")


# A proposal names the design that it made: the design comes from the proposal, not the other way. So it does
# through the batch.
_OTHERWISE = frozenset({("proposals", "designs"), ("batches", "designs")})
_WRITTEN_OUT = (
    Link(
        "designs",
        "proposals",
        "first proposal of the design",
        "SELECT design_id AS child, arg_min(proposal_id, (sequence, created_at)) AS parent FROM raw_proposals "
        "GROUP BY design_id",
    ),
    Link(
        "tools",
        "proposals",
        "campaign_id, batch, slot",
        "SELECT tool_id AS child, proposal_id AS parent FROM tools JOIN proposals USING (campaign_id, batch, slot)",
    ),
    Link(
        "proposals",
        "batches",
        "campaign_id, batch",
        "SELECT proposal_id AS child, batch_id AS parent FROM proposals JOIN batches USING (campaign_id, batch) "
        "WHERE fidelity = 'real'",
    ),
    Link(
        "tools",
        "materials",
        "material_lot",
        "SELECT tool_id AS child, material_id AS parent FROM tools JOIN materials ON material_lot = lot",
    ),
    Link(
        "simulations",
        "campaigns",
        "config_hash",
        "SELECT simulation_id AS child, c.campaign_id AS parent FROM simulations AS s JOIN "
        "(SELECT DISTINCT campaign_id, config_hash FROM raw_campaigns) AS c USING (config_hash)",
    ),
)
LINKS: tuple[Link, ...] = (*_named_links(), *_WRITTEN_OUT)
_LINKED = frozenset({frozenset(pair) for pair in _OTHERWISE} | {frozenset(link[:2]) for link in LINKS})

# What is said of a row in one line; of a table that is not listed, its first columns.
_N_COLUMNS = 5
_SUMMARY: Mapping[str, tuple[str, ...]] = {
    "campaigns": ("name",),
    "designs": ("height_mm", "front_thickness_mm", "rib_thickness_mm", "rib_count", "rib_angle_deg"),
    "objects": ("name", "object_class"),
    "batches": ("kind", "n_tools"),
    "proposals": ("fidelity", "design_id", "acquisition", "acquisition_value", "n_real", "n_sim"),
    "tools": (
        "design_id",
        "status",
        "reason",
        "operator",
        "material_lot",
        "confirmed_by",
        "hardness_shore_a",
        "measured_front_thickness_mm",
        "measured_back_thickness_mm",
        "measured_rib_thickness_mm",
    ),  # fmt: skip
    "simulator_versions": ("tier", "young_modulus_mpa", "friction", "poisson_ratio"),
    "simulations": ("design_id", "object_id", "status", "reason", "peak_force_n", "contact_force_n", "work_j"),
    "grasps": ("tool_id", "object_id", "repeat", "attempt", "bench", "status", "reason", "peak_force_n", "work_j"),
    "trace_features": ("feature_version", "peak_force_n", "work_j", "hold_mm", "n_peaks", "separation_lift_mm"),
    "anomaly_flags": ("kind", "is_flagged", "p_value", "compared", "reason"),
    "materials": ("lot", "quantity", "value", "unit", "sd", "n"),
    "fits": ("batch", "n_real", "n_sim", "rho", "noise_sd_n", "loo_rmse_n"),
    "gap_findings": ("gap_id", "round", "kind", "effect", "answer", "probability", "sentence"),
    "events": ("kind", "message"),
    "traces": (),
    "sim_traces": (),
}


def is_linked(one: str, other: str) -> bool:
    """Return whether a link says how two tables hang together, so that stored parents between them do not count."""
    return frozenset((one, other)) in _LINKED


def summary_columns(table: str) -> tuple[str, ...]:
    """List columns that tell rows of this table apart for a person."""
    if table in _SUMMARY:
        return _SUMMARY[table]
    row_type = TABLE_BY_NAME[table]
    plain = (name for name in row_type.model_fields if not name.endswith(("_json", "_toml")))
    return tuple(name for name in plain if name != row_type.id_column())[:_N_COLUMNS]
