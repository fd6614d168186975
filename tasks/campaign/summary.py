"""The result of a campaign in a few rows, for the terminal, the Prefect artifact and `--json`."""

from typing import Any

from lake.store import Lake

_TOOLS = """
SELECT tool_id, batch, slot, tool_quality_n, n_objects, n_grasps
FROM tool_quality WHERE campaign_id = ?
ORDER BY n_objects = max(n_objects) OVER () DESC, tool_quality_n DESC
"""


def ranked_tools(lake: Lake, campaign_id: str) -> list[dict[str, Any]]:
    """Measured tools, best first, with tool quality (mean peak pull-off force over the objects) in N.

    Tools that miss objects come after all others: their means are over easier or harder objects.
    """
    return lake.query(_TOOLS, [campaign_id]).to_pylist()


def markdown_table(tools: list[dict[str, Any]]) -> str:
    """The ranking as a Markdown table."""
    head = "| tool | batch | tool quality (N) | objects | grasps |\n| --- | --- | --- | --- | --- |"
    rows = [
        f"| {t['tool_id']} | {t['batch']} | {t['tool_quality_n']:.2f} | {t['n_objects']} | {t['n_grasps']} |"
        for t in tools
    ]
    return "\n".join([head, *rows])
