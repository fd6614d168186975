"""From a row back to the rows it came from, or forward to what was made of it.

`find_lineage` walks the links of `lake.tables.links` and the stored `parents` level by level, one query a level.
Samples are never read: of traces only the index of ids is asked.
"""

from collections.abc import Container, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from fast.lake.order import OLDEST_FIRST
from fast.lake.provenance import ProvenanceColumns
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLE_BY_NAME, TABLES
from fast.lake.tables.links import LINKS, is_linked, key_of
from fast.lake.tables.schema import has_samples
from fast.models.errors import UsageError

UNKNOWN = "unknown"  # table of a stored parent that the lake does not have
_STORED = "parents"
_N_FIRST_IDS = 3
_N_CLOSEST = 3
_SCALARS = tuple(row_type.table for row_type in TABLES if not has_samples(row_type))
_SAMPLES = tuple(row_type.table for row_type in TABLES if has_samples(row_type))
_TABLES = (*_SCALARS, *_SAMPLES)


def _all_ids(tables: Iterable[str]) -> str:
    """Write the SELECT of the place in `_TABLES` and the id of all rows, superseded ones too."""
    places = {table: place for place, table in enumerate(_TABLES)}
    return " UNION ALL ".join(
        f"SELECT {places[table]} AS place, {key_of(table)} AS id FROM raw_{table}" for table in tables
    )


class Node(NamedTuple):
    """One row of the lake, by table and id."""

    table: str
    row_id: str


class Edge(NamedTuple):
    """`child` was made from `parent`; `by` names the columns that say so."""

    child: Node
    parent: Node
    by: str


class Group(NamedTuple):
    """Rows of one table beside `node` that are too many to follow; `first_ids` are some of the `n_rows`."""

    node: Node
    table: str
    by: str
    n_rows: int
    first_ids: tuple[str, ...]


class StoredRow(NamedTuple):
    """A row as it was written: its own columns and its provenance, without `parents`; of samples, id and time."""

    columns: dict[str, Any]
    provenance: dict[str, Any]


@dataclass(frozen=True)
class Lineage:
    """What was found from `root`, in order of distance."""

    root: Node
    is_forward: bool
    rows: dict[Node, StoredRow | None]
    superseded: dict[Node, list[StoredRow]]
    campaign_of_config: dict[str, str]
    edges: list[Edge] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)


class _Beside(NamedTuple):
    """Rows of `table` one step from `node`."""

    node: Node
    table: str
    by: str
    n_rows: int
    ids: tuple[str, ...]


def find_lineage(
    lake: Lake, row_id: str, *, forward: bool = False, depth: int | None = None, limit: int | None = None
) -> Lineage:
    """Find parents of the row with this id, their parents, and so on; with `forward`, what was made from it.

    `depth` is how many steps are followed, `limit` of how many rows of one table beside a row each is
    followed: more than that are one `Group`. None follows everything.

    Raises:
        UsageError: no row has this id; the message names the closest ids.
        LakeError: a file of the lake cannot be read.
    """
    root = _root(lake, row_id)
    seen, frontier = {root: None}, [root]
    edges: list[Edge] = []
    groups: list[Group] = []
    step = 0
    while frontier and (depth is None or step < depth):
        reached: dict[Node, None] = {}
        for beside in _step(lake, frontier, forward, limit):
            if limit is not None and beside.n_rows > limit:
                groups.append(Group(*beside[:4], beside.ids[:_N_FIRST_IDS]))
                continue
            for other in (Node(beside.table, found) for found in beside.ids):
                child, parent = (other, beside.node) if forward else (beside.node, other)
                edges.append(Edge(child, parent, beside.by))
                reached[other] = None
        frontier = [node for node in reached if node not in seen]
        seen |= dict.fromkeys(frontier)
        step += 1
    rows, superseded = _read_rows(lake, seen)
    return Lineage(root, forward, rows, superseded, _campaigns_by_config(lake), edges, groups)


def _root(lake: Lake, row_id: str) -> Node:
    """Find the row with this id; of a grasp and its samples, the grasp."""
    for tables in (_SCALARS, _SAMPLES):
        found = lake.query(f"SELECT min(place) FROM ({_all_ids(tables)}) WHERE id = $id", {"id": row_id})
        place = found.column(0)[0].as_py()
        if place is not None:
            return Node(_TABLES[place], row_id)
    near = lake.query(
        "SELECT DISTINCT place, id, contains(id, $id) AS has_it, "
        "levenshtein(id, $id) / greatest(length(id), length($id)) AS far "
        f"FROM ({_all_ids(_SCALARS)}) ORDER BY has_it DESC, far, id LIMIT {_N_CLOSEST}",
        {"id": row_id},
    ).to_pylist()
    if not near:
        raise UsageError(f"No row of {lake.address} has the id `{row_id}`: the lake is empty.")
    words = ", ".join(f"`{row['id']}` ({_TABLES[row['place']]})" for row in near)
    raise UsageError(f"No row of {lake.address} has the id `{row_id}`; the closest ids are {words}.")


def _step(lake: Lake, frontier: list[Node], forward: bool, limit: int | None) -> list[_Beside]:
    """Find rows one step from the frontier, in the order of the frontier and of the tables."""
    place = {node: number for number, node in enumerate(frontier)}
    tables = {node.table for node in frontier} - {UNKNOWN, *_SAMPLES}
    parts = _linked_parts({node.table for node in frontier}, forward)
    if tables:
        parts.append(_stored_children() if forward else _stored_parents(tables))
    if not parts:
        return []
    first = "list(far ORDER BY far)" if limit is None else f"min(far, {max(limit, _N_FIRST_IDS)})"
    found = lake.query(
        "WITH frontier AS (SELECT unnest($tables) AS here, unnest($ids) AS near) "
        f"SELECT here, near, there, link, count(*) AS n_rows, {first} AS ids "
        f"FROM (SELECT DISTINCT here, near, there, far, link FROM ({' UNION ALL '.join(parts)})) GROUP BY ALL",
        {"tables": [node.table for node in frontier], "ids": [node.row_id for node in frontier]},
    ).to_pylist()
    besides = [
        _Beside(Node(row["here"], row["near"]), row["there"], row["link"], row["n_rows"], tuple(row["ids"]))
        for row in found
        if row["link"] != _STORED or not is_linked(row["here"], row["there"])
    ]
    return sorted(besides, key=lambda beside: (place[beside.node], (*_TABLES, UNKNOWN).index(beside.table), beside.by))


def _linked_parts(tables: Container[str], forward: bool) -> list[str]:
    """Write a SELECT per link that leaves one of these tables."""
    near, far = ("parent", "child") if forward else ("child", "parent")
    parts = []
    for link in LINKS:
        here, there = (link.parent, link.child) if forward else (link.child, link.parent)
        if here in tables:
            parts.append(
                f"SELECT '{here}' AS here, {near} AS near, '{there}' AS there, {far} AS far, '{link.by}' AS link "
                f"FROM ({link.pairs}) WHERE child IS NOT NULL AND parent IS NOT NULL "
                f"AND {near} IN (SELECT near FROM frontier WHERE here = '{here}')"
            )
    return parts


def _stored_parents(tables: Container[str]) -> str:
    """Write the SELECT of parents that rows of these tables store; one may be in any table, or in none."""
    names = "[" + ", ".join(f"'{table}'" for table in _SCALARS) + "]"
    rows = " UNION ALL ".join(
        f"SELECT '{table}' AS here, {key_of(table)} AS near, unnest(parents) AS parent FROM {table} "
        f"WHERE {key_of(table)} IN (SELECT near FROM frontier WHERE here = '{table}')"
        for table in _SCALARS
        if table in tables
    )
    return (
        f"SELECT here, near, coalesce({names}[place + 1], '{UNKNOWN}') AS there, parent AS far, '{_STORED}' AS link "
        f"FROM (WITH stored AS MATERIALIZED ({rows}) SELECT * FROM stored LEFT JOIN (SELECT id, min(place) AS place "
        f"FROM ({_all_ids(_SCALARS)}) WHERE id IN (SELECT parent FROM stored) GROUP BY id) ON id = parent)"
    )


def _stored_children() -> str:
    """Write the SELECT of the rows that store a row of the frontier as their parent."""
    rows = " UNION ALL ".join(
        f"SELECT '{table}' AS there, {key_of(table)} AS far, unnest(parents) AS parent FROM {table}"
        for table in _SCALARS
    )
    return f"SELECT here, near, there, far, '{_STORED}' AS link FROM frontier JOIN ({rows}) ON parent = near"


def _read_rows(lake: Lake, nodes: Iterable[Node]) -> tuple[dict[Node, StoredRow | None], dict[Node, list[StoredRow]]]:
    """Read the valid row of each node (None if the lake has none), and those it superseded, oldest first."""
    rows: dict[Node, StoredRow | None] = dict.fromkeys(nodes)
    superseded: dict[Node, list[StoredRow]] = {}
    by_table: dict[str, list[str]] = {}
    for node in rows:
        by_table.setdefault(node.table, []).append(node.row_id)
    for table, ids in by_table.items():
        if table == UNKNOWN:
            continue
        sql = f"SELECT * FROM raw_{table} WHERE {key_of(table)} IN (SELECT unnest($ids)) ORDER BY {OLDEST_FIRST}"
        for stored in lake.query(sql, {"ids": ids}).to_pylist():
            node = Node(table, str(stored[TABLE_BY_NAME[table].id_column()]))
            before = rows[node]
            if before is not None:
                superseded.setdefault(node, []).append(before)
            rows[node] = _stored_row(table, stored)
    return rows, superseded


def _stored_row(table: str, stored: dict[str, Any]) -> StoredRow:
    own = TABLE_BY_NAME[table].model_fields
    columns = {name: stored[name] for name in own if name in stored}
    names = (name for name in ProvenanceColumns.model_fields if name != _STORED and name in stored)
    return StoredRow(columns, {name: stored[name] for name in names})


def _campaigns_by_config(lake: Lake) -> dict[str, str]:
    """Return the campaign of each config hash; a campaign that has grown has had several configs."""
    found = lake.query("SELECT config_hash, min(campaign_id) AS campaign FROM raw_campaigns GROUP BY config_hash")
    return {row["config_hash"]: row["campaign"] for row in found.to_pylist()}
