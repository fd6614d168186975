"""A lineage as a tree for people and as nodes and edges for machines."""

from collections.abc import Iterator
from typing import Any

from fast.lake.query.lineage import UNKNOWN, Group, Lineage, Node, StoredRow
from fast.lake.tables.links import summary_columns

_LAST, _MORE, _UNDER_LAST, _UNDER_MORE = "└─ ", "├─ ", "   ", "│  "


def lineage_text(lineage: Lineage) -> str:
    """Return the tree, two lines a row: what it is, and what wrote it."""
    return "\n".join(_Tree(lineage).lines(lineage.root))


def lineage_json(lineage: Lineage) -> dict[str, Any]:
    """Return nodes and edges; a node is named `<table>/<id>`."""
    return {
        "root": _name(lineage.root),
        "direction": "children" if lineage.is_forward else "parents",
        "nodes": [_json_node(lineage, node) for node in lineage.rows],
        "edges": [{"child": _name(e.child), "parent": _name(e.parent), "by": e.by} for e in lineage.edges],
        "not_followed": [
            {"node": _name(g.node), "table": g.table, "by": g.by, "n_rows": g.n_rows, "first_ids": list(g.first_ids)}
            for g in lineage.groups
        ],
    }


class _Tree:
    """Draws each row once, below the row that is nearest to it; a second time it is only named."""

    def __init__(self, lineage: Lineage) -> None:
        self._lineage = lineage
        self._drawn: set[Node] = set()
        self._beside: dict[Node, list[Node]] = {}
        self._groups: dict[Node, list[Group]] = {}
        self._reached: dict[Node, set[Node]] = {}
        for edge in lineage.edges:
            here, there = (edge.parent, edge.child) if lineage.is_forward else (edge.child, edge.parent)
            self._beside.setdefault(here, []).append(there)
        for group in lineage.groups:
            self._groups.setdefault(group.node, []).append(group)

    def lines(self, node: Node) -> Iterator[str]:
        """Yield the lines of a row and of what hangs below it."""
        if node in self._drawn:
            yield f"{_label(node)} (above)"
            return
        self._drawn.add(node)
        below: list[Node | Group] = [*self._next(node), *self._own_groups(node)]
        yield from self._own_lines(node, _UNDER_MORE if below else _UNDER_LAST)
        for number, entry in enumerate(below):
            first, rest = (_LAST, _UNDER_LAST) if number + 1 == len(below) else (_MORE, _UNDER_MORE)
            entry_lines = iter([_group_line(entry)]) if isinstance(entry, Group) else self.lines(entry)
            yield first + next(entry_lines)
            yield from (rest + line for line in entry_lines)

    def _next(self, node: Node) -> list[Node]:
        """Return the rows beside this one, without those that another of them leads to."""
        beside = dict.fromkeys(self._beside.get(node, []))
        return [one for one in beside if not any(self._reaches(other, one) for other in beside)]

    def _own_groups(self, node: Node) -> list[Group]:
        """Return rows that are only counted, without those that are counted again further on."""
        beyond = {group[1:2] + group[3:] for far in self._behind(node) - {node} for group in self._groups.get(far, [])}
        return [group for group in self._groups.get(node, []) if group[1:2] + group[3:] not in beyond]

    def _reaches(self, one: Node, other: Node) -> bool:
        return other in self._behind(one) and one not in self._behind(other)

    def _behind(self, node: Node) -> set[Node]:
        """Return every row that following on from this one reaches."""
        if node not in self._reached:
            self._reached[node] = found = set()
            for other in self._beside.get(node, []):
                found |= {other} | self._behind(other)
        return self._reached[node]

    def _own_lines(self, node: Node, indent: str) -> Iterator[str]:
        row = self._lineage.rows[node]
        if row is None:
            yield f"{_label(node)}: not in this lake"
            return
        facts = ", ".join(
            f"{name} {_value(row.columns[name])}" for name in summary_columns(node.table) if _says(row, name)
        )
        yield f"{_label(node)}: {facts}" if facts else _label(node)
        yield f"{indent}{self._provenance(row)}"
        for old in self._lineage.superseded.get(node, []):
            yield f"{indent}superseded: {self._provenance(old)}"

    def _provenance(self, row: StoredRow) -> str:
        """Tell when, by which code, with which config and seed; samples tell only the time without being read."""
        stored = row.provenance
        words = [f"{stored['created_at']:%Y-%m-%d %H:%M:%S} UTC"]
        if "code_version" in stored:
            words.append(f"code {stored['code_version']}{' with local changes' if stored['code_dirty'] else ''}")
        if stored.get("config_hash"):
            campaign = self._lineage.campaign_of_config.get(stored["config_hash"])
            words.append(f"config {stored['config_hash']}" + (f" of campaign {campaign}" if campaign else ""))
        seed = row.columns.get("seed") or stored.get("seed")
        return ", ".join([*words, f"seed {seed}"] if seed else words)


def _json_node(lineage: Lineage, node: Node) -> dict[str, Any]:
    row = lineage.rows[node]
    entry: dict[str, Any] = {"node": _name(node), "table": node.table, "id": node.row_id, "found": row is not None}
    if row is None:
        return entry
    campaign = lineage.campaign_of_config.get(row.provenance.get("config_hash", ""))
    superseded = [old.columns | old.provenance for old in lineage.superseded.get(node, [])]
    return entry | row.provenance | {"config_campaign": campaign, "row": row.columns, "superseded": superseded}


def _name(node: Node) -> str:
    return f"{node.table}/{node.row_id}"


def _label(node: Node) -> str:
    return node.row_id if node.table == UNKNOWN else f"{_singular(node.table)} {node.row_id}"


def _group_line(group: Group) -> str:
    return f"{group.n_rows:,} {group.table.replace('_', ' ')}: {', '.join(group.first_ids)}, ..."


def _singular(table: str) -> str:
    return table.replace("_", " ").removesuffix("es" if table.endswith("ches") else "s")


def _says(row: StoredRow, name: str) -> bool:
    return row.columns.get(name) not in (None, "", [], ())


def _value(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
