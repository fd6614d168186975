"""The folder of a gap search: `findings.json` and its page."""

from pathlib import Path

from flows.gap import GapOutcome
from lake.store import Lake


def write_folder(lake: Lake, outcome: GapOutcome, out: Path | None = None) -> Path:
    """Write findings.json into a folder, by default in the lake's outputs; returns the path of the file."""
    folder = out or lake.root / "outputs" / outcome.run.gap_id
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "findings.json"
    path.write_text(outcome.run.findings.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return path
