"""`fast lake`: import, export, check, compact and measure the lake."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say, show, table_text

app = App(name="lake", help="Import, export, check, compact and measure the lake.")


@app.command(name="import")
def import_(
    directory: Path, *, lake: LakePath = DEFAULT_LAKE, campaign: str | None = None, json: AsJson = False
) -> None:
    """Import designs, grasps and traces in the hand-off format; all of it or, with every fault named, nothing."""
    from lake.handoff import import_handoff
    from lake.provenance import current_provenance
    from lake.store import Lake

    counts = import_handoff(Lake.open(lake, create=True), directory, current_provenance(), campaign_id=campaign)
    show(counts._asdict(), _counts_text("imported", counts._asdict()), json)


@app.command
def export(
    directory: Path, *, lake: LakePath = DEFAULT_LAKE, campaign: str | None = None, json: AsJson = False
) -> None:
    """Export designs, grasps and traces in the hand-off format."""
    from lake.handoff import export_handoff
    from lake.store import Lake

    counts = export_handoff(Lake.open(lake), directory, campaign_id=campaign)
    show(counts._asdict(), _counts_text("exported", counts._asdict()), json)


@app.command
def check(
    *,
    lake: LakePath = DEFAULT_LAKE,
    quarantine: Annotated[bool, Parameter(negative="", help="set bad files aside; nothing is deleted")] = False,
    json: AsJson = False,
) -> None:
    """Find torn, foreign and incomplete files; exit status 1 when there are any."""
    import sys

    from lake.maintenance import check as check_lake
    from lake.store import Lake

    findings = [finding._asdict() for finding in check_lake(Lake.open(lake), quarantine=quarantine)]
    text = "\n".join(str(finding["message"]) for finding in findings) or "every file of the lake is whole."
    show(findings, text, json)
    if findings:
        sys.exit(1)


@app.command
def compact(*, lake: LakePath = DEFAULT_LAKE) -> None:
    """Merge small files; readers and writers need not stop."""
    from lake.maintenance import compact as compact_table
    from lake.store import Lake
    from lake.tables import TABLES

    found = Lake.open(lake)
    for row_type in TABLES:
        done = compact_table(found, row_type)
        if done.n_files_before != done.n_files_after:
            say(f"{row_type.table}: {done.n_files_before} files merged into {done.n_files_after}")


@app.command
def stats(*, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Rows, files and size of every table."""
    from lake.maintenance import stats as table_stats
    from lake.store import Lake

    rows = [entry._asdict() for entry in table_stats(Lake.open(lake))]
    show(rows, table_text(rows, ["table", "n_rows", "n_files", "n_superseded", "size_mb"]), json)


def _counts_text(verb: str, counts: dict[str, int]) -> str:
    return f"{verb} " + ", ".join(f"{n} {name.removeprefix('n_').replace('_', ' ')}" for name, n in counts.items())
