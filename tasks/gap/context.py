"""What came before each measured grasp, rebuilt from when and in which order the lake says they were made."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lake.store import Lake
from models.records import GraspContext


@dataclass(frozen=True)
class Contexts:
    """Contexts by grasp id, of failed grasps and replaced attempts too: they wear a finger like any other."""

    of: Mapping[str, GraspContext]
    warnings: tuple[str, ...]


def contexts_of(lake: Lake, campaign_id: str | None) -> Contexts:
    """Contexts of all grasps of a campaign, or of the lake.

    Batches are told apart by campaign and number. Within one, grasps follow each other by `started_at`, else by
    `order`, else tool by tool, repeat by repeat; only `started_at` tells the time.
    """
    where = "WHERE campaign_id = ?" if campaign_id else ""
    sql = (
        'SELECT grasp_id, campaign_id, batch, tool_id, object_id, repeat, attempt, "order", started_at '
        f"FROM grasps {where}"
    )
    batches: dict[tuple[str, int | None], list[dict[str, Any]]] = defaultdict(list)
    for row in lake.query(sql, [campaign_id] if campaign_id else []).to_pylist():
        batches[row["campaign_id"], row["batch"]].append(row)
    found: dict[str, GraspContext] = {}
    n_untimed = n_unordered = 0
    for rows in batches.values():
        if any(row["started_at"] is None for row in rows):
            n_untimed += len(rows)
            n_unordered += len(rows) if any(row["order"] is None for row in rows) else 0
        found |= _in_batch(rows)
    warnings = []
    if n_untimed:
        warnings.append(f"{n_untimed} grasps have no `started_at`: nothing that changes with the time can be found.")
    if n_unordered:
        warnings.append(
            f"{n_unordered} grasps have neither `started_at` nor `order`: they are taken to be made tool by tool and "
            "repeat by repeat, and what wears off is placed accordingly."
        )
    return Contexts(found, tuple(warnings))


def _in_batch(rows: Sequence[dict[str, Any]]) -> dict[str, GraspContext]:
    is_timed = all(row["started_at"] is not None for row in rows)
    is_ordered = all(row["order"] is not None for row in rows)

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        by = row["started_at"] if is_timed else row["order"] if is_ordered else 0
        return (by, row["tool_id"], row["repeat"], row["object_id"], row["attempt"])

    made = sorted(rows, key=place)
    began = made[0]["started_at"] if is_timed else None
    of_tool: dict[str, int] = defaultdict(int)
    of_pair: dict[tuple[str, int], int] = defaultdict(int)
    found = {}
    for number, row in enumerate(made):
        pair = row["tool_id"], row["object_id"]
        found[row["grasp_id"]] = GraspContext(
            repeat=of_pair[pair],
            tool_grasps=of_tool[row["tool_id"]],
            batch_grasps=number,
            clock_s=(row["started_at"] - began).total_seconds() if began is not None else 0.0,
        )
        of_tool[row["tool_id"]] += 1
        of_pair[pair] += 1
    return found
