"""`fast lake`: import, export, check, compact and measure the lake; where a row comes from."""

import csv
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, make_app, say, say_progress, show, table_text
from fast.models.errors import ConfigError, UsageError
from fast.models.units import spell_count

if TYPE_CHECKING:
    from fast.lake.handoff.import_folder import HandoffCounts, Origin
    from fast.lake.store import Lake
    from fast.models.records import GraspSetup
    from fast.tasks.bench.told import Taken

_LIMIT_TEXT, _LIMIT_JSON = 5, 10_000

app = make_app(name="lake", help="Import, export, check, compact and measure the lake; where its rows come from.")


@app.command(name="import")
def import_(
    directory: Annotated[Path, Parameter(help="Folder with designs.csv, grasps.csv and traces.parquet (or .csv).")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    campaign: Annotated[str | None, Parameter(help="Campaign the data become part of; default: import-FOLDER.")] = None,
    reader: Annotated[
        str | None, Parameter(help="FILE.py:FUNCTION that reads DIRECTORY where it has another format.")
    ] = None,
    set: Annotated[
        list[str] | None,
        Parameter(
            negative="", help="NAME=VALUE of how grasps were made where the files do not say it, e.g. closed_gap_mm=30."
        ),
    ] = None,
    lab: Annotated[
        str | None,
        Parameter(help="Who measured, where the files do not say it; stands in front of the ids of grasps."),
    ] = None,
    dry_run: Annotated[bool, Parameter(negative="", help="Only check and count, write nothing.")] = False,
    json: AsJson = False,
) -> None:
    """Import designs, grasps and traces in the hand-off format; all of it or, with every fault named, nothing."""
    from fast.lake.handoff.files import read_handoff
    from fast.lake.handoff.import_folder import Origin, check_campaign_id, count_all, import_handoff
    from fast.lake.handoff.readers import handoff_folder, load_reader
    from fast.lake.provenance import current_provenance
    from fast.lake.store import Lake

    setup = _read_setup(set or [])
    _check_lab(lab)
    if campaign is not None:
        check_campaign_id(campaign)
    source = directory.resolve().stem if directory.is_file() else directory.resolve().name
    with handoff_folder(directory, load_reader(reader) if reader else None) as folder:
        _note_usual_setup(folder, setup, set or [])
        if not Lake.exists(lake):
            handoff = read_handoff(folder, frozenset())  # a folder that cannot be imported makes no lake
            if dry_run:
                show_import(count_all(handoff), is_dry=True, as_json=json)
                return
        found = open_lake(lake, create=True)
        origin = Origin(campaign, setup, source, lab)
        if (taken := _take_answers(found, folder, origin, is_dry=dry_run)) is not None:
            words = f"nothing was written (--dry-run); it would be: {taken.sentence}" if dry_run else taken.sentence
            show(asdict(taken) | {"is_dry": dry_run}, f"{words}.", json)
            return
        counts = import_handoff(found, folder, current_provenance(), origin, is_dry=dry_run)
    show_import(counts, is_dry=dry_run, as_json=json)


def _note_usual_setup(folder: Path, setup: "GraspSetup", settings: list[str]) -> None:
    """Say which settings are taken as usual, where neither the folder nor the command gives those that matter most."""
    from fast.lake.handoff.format import TELLING_COLUMNS
    from fast.lake.handoff.tables import find_separator

    table = folder / "grasps.csv"
    if not table.is_file():
        return
    with table.open(encoding="utf-8-sig", errors="replace") as file:
        header = file.readline()
    there = [name.strip().lower() for name in next(csv.reader([header], delimiter=find_separator(header)), [])]
    given = [setting.partition("=")[0] for setting in settings]
    missing = [name for name in TELLING_COLUMNS if name not in there and name not in given]
    if missing:
        taken = ", ".join(f"{name} {getattr(setup, name):g}" for name in missing)
        say_progress(
            f"grasps.csv does not say how the grasps were made; taken as usual: {taken}. If that is not so, forces are "
            f"compared with those of another grasp: import with {' '.join(f'--set {name}=...' for name in missing)}."
        )


def _check_lab(lab: str | None) -> None:
    """Raise ConfigError for a name that no lab can have."""
    from fast.lake.handoff.fields import lab_name

    try:
        lab_name(lab or "")
    except ValueError as error:
        raise ConfigError(f"--lab `{lab}`: it {error}") from error


def _read_setup(settings: list[str]) -> "GraspSetup":
    """Read the default setup with `name=value` settings.

    Raises:
        ConfigError: a name is unknown, or a value out of its range.
    """
    from fast.models.records import GraspSetup
    from fast.models.validation import load_record

    values = dict(setting.partition("=")[::2] for setting in settings)
    if wrong := [name for name, value in values.items() if not value]:
        raise ConfigError(f"--set `{wrong[0]}` has no value; write it like --set closed_gap_mm=30.")
    return load_record(GraspSetup, values, "--set")


def show_import(counts: "HandoffCounts", *, is_dry: bool, as_json: bool) -> None:
    """Say what an import wrote, or with `is_dry` what it would have."""
    numbers, n_known = counts._asdict(), counts.n_known
    words = _counts_text("nothing was written (--dry-run); it would be:" if is_dry else "imported", numbers)
    if n_known:
        words += f"; {spell_count(n_known, 'grasp')} {'was' if n_known == 1 else 'were'} there already"
    if counts.n_replaced:
        words += f", {counts.n_replaced} of them with other numbers, which {'would be' if is_dry else 'were'} replaced"
    if counts.known_in:
        words += (
            f", of the campaign {' and '.join(counts.known_in)}, and stay there; if another lab measured them anew, "
            "say who with --lab, else give them other ids"
        )
    show(counts._asdict() | {"is_dry": is_dry}, words, as_json)


def _take_answers(lake: "Lake", folder: Path, origin: "Origin", *, is_dry: bool) -> "Taken | None":
    """Tell what became of grasps that a campaign on one's own bench asked for; None if none did, or another lab made.

    Raises:
        UsageError: they are not what was asked for; nothing was written.
    """
    from fast.flows.campaign.ask_tell import find_told_campaign
    from fast.lake.handoff.files import read_handoff
    from fast.lake.tables.campaign import CampaignRow, DesignRow
    from fast.tasks.bench.told import Telling, take_told
    from fast.tasks.bench.told_files import read_folder

    if not lake.ids(CampaignRow):
        return None
    handoff = read_handoff(folder, lake.ids(DesignRow))
    real = [grasp for grasp in handoff.grasps if grasp.fidelity == "real"]
    campaign = find_told_campaign(lake, [grasp.tool_id for grasp in real])
    if campaign is None or origin.campaign_id not in (None, campaign.campaign_id):
        return None
    if {grasp.lab or origin.lab for grasp in real} - {None, campaign.config.lab}:
        return None
    try:
        return take_told(campaign, read_folder(campaign, folder), Telling(f"import of {origin.source}", is_dry=is_dry))
    except UsageError as error:
        raise UsageError(f"{error} Grasps that another lab made are imported with --lab NAME.") from error


@app.command
def export(
    directory: Annotated[Path, Parameter(help="Folder to write to; must hold no hand-off files yet.")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    campaign: Annotated[str | None, Parameter(help="Export this campaign alone; default: everything.")] = None,
    json: AsJson = False,
) -> None:
    """Export designs, grasps and traces in the hand-off format."""
    from fast.lake.handoff.export_folder import export_handoff

    found = open_lake(lake)
    if campaign is not None:
        _check_campaign(found, campaign)
    counts = export_handoff(found, directory, campaign_id=campaign)
    show(counts._asdict(), _counts_text("exported", counts._asdict()), json)


@app.command
def labs(
    *,
    lake: LakePath = DEFAULT_LAKE,
    out: Annotated[Path | None, Parameter(help="Folder for the page; default: labs, in the lake's outputs.")] = None,
    json: AsJson = False,
) -> None:
    """Compare labs that measured the same fingers: bias, scatter by object and finger, and their fits."""
    from fast.flows.report.labs import format_bias, write_labs_report

    found = open_lake(lake)
    page, shown = write_labs_report(found, out or (found.root or Path()) / "outputs" / "labs")
    compared = shown.compared
    rows = [
        {"lab": lab.lab, "grasps": lab.n_grasps, "pairs": lab.n_cells, "bias": format_bias(lab)}
        for lab in compared.labs
    ]
    sds = [compared.overall.repeat_sd_n, compared.overall.lab_sd_n, compared.overall.reproducibility_sd_n]
    told = ["not known" if sd is None else f"{sd:.2f} N" for sd in sds]
    words = f"SD of repeats {told[0]}, between labs {told[1]}, of one grasp in any lab {told[2]}; page: {page}"
    data = {
        "labs": [{**row, "bias": lab.bias._asdict()} for row, lab in zip(rows, compared.labs, strict=True)],
        "overall": asdict(compared.overall),
        "report": str(page),
    }
    show(data, f"{table_text(rows)}\n\n{words}", json)


@app.command
def publish(
    directory: Annotated[Path | None, Parameter(help="New folder for the deposit.")] = None,
    *,
    title: Annotated[str, Parameter(help="Title of the data set.")],
    author: Annotated[list[str], Parameter(negative="", help="Who made the data; may be given several times.")],
    licence: Annotated[str, Parameter(help="CC-BY-4.0, CC0-1.0 or ODC-By-1.0.")] = "CC-BY-4.0",
    eln: Annotated[Path | None, Parameter(help="Also write one file for electronic lab notebooks (.eln).")] = None,
    zenodo: Annotated[
        bool, Parameter(negative="", help="Also upload it to Zenodo, as a draft; FAST_ZENODO_TOKEN is your token.")
    ] = False,
    lake: LakePath = DEFAULT_LAKE,
    campaign: Annotated[str | None, Parameter(help="Publish this campaign alone; default: everything.")] = None,
    json: AsJson = False,
) -> None:
    """Write a deposit for Zenodo or another archive: an export that describes itself, readable without FAST.

    Give a folder, --eln, --zenodo, or several of them.
    """
    from tempfile import TemporaryDirectory

    from fast.lake.handoff.eln import check_eln_path, write_eln
    from fast.lake.handoff.publish import publish as write_deposit
    from fast.lake.handoff.zenodo import read_access, upload_deposit

    if directory is None and eln is None and not zenodo:
        raise UsageError("nothing is asked for; give a new folder, --eln FILE.eln, --zenodo, or several of them.")
    access = read_access() if zenodo else None
    if eln is not None:
        check_eln_path(eln)
    found = open_lake(lake)
    if campaign is not None:
        _check_campaign(found, campaign)
    with TemporaryDirectory(prefix="fast-deposit-") as spare:
        folder = directory or Path(spare) / (campaign or "fast-grasps")
        counts = write_deposit(found, folder, title=title, authors=author, licence=licence, campaign_id=campaign)
        words = [_counts_text("wrote", counts._asdict())]
        words += [f"to {directory}; pack the folder and upload it as it is"] if directory else []
        if eln is not None:
            write_eln(folder, eln)
            words.append(f"to {eln}; import it into your notebook")
        page = upload_deposit(folder, access) if access else None
        words += [f"to {page} as a draft; look at it and publish it there"] if page else []
    show({**counts._asdict(), "draft": page}, f"{words[0]} {', and '.join(words[1:])}.", json)


@app.command
def check(
    *,
    lake: LakePath = DEFAULT_LAKE,
    quarantine: Annotated[bool, Parameter(negative="", help="Set bad files aside; nothing is deleted.")] = False,
    json: AsJson = False,
) -> None:
    """Find torn, unreadable, foreign and incomplete files; exit status 1 when there are any."""
    from fast.lake.maintenance import check as check_lake

    findings = check_lake(open_lake(lake), quarantine=quarantine)
    text = "\n".join(finding.line for finding in findings) or "every file of the lake is whole."
    show([finding._asdict() for finding in findings], text, json)
    if findings:
        sys.exit(1)


@app.command
def compact(*, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Merge small files into few; no row is lost, and readers and writers need not stop."""
    from fast.lake.maintenance import compact as compact_table
    from fast.lake.tables.campaign import TABLES

    found = open_lake(lake)
    rows = [compact_table(found, row_type)._asdict() for row_type in TABLES]
    merged = [row for row in rows if row["n_files_before"] != row["n_files_after"]]
    lines = [f"{row['table']}: {row['n_files_before']} files merged into {row['n_files_after']}" for row in merged]
    show(rows, "\n".join(lines) or "nothing to merge.", json)


@app.command
def stats(*, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """List rows, files and size of every table; superseded rows are kept, but no query sees them."""
    from fast.lake.maintenance import stats as table_stats

    rows = [entry._asdict() for entry in table_stats(open_lake(lake))]
    show(rows, table_text(rows, ["table", "n_rows", "n_files", "n_superseded", "size_mb"]), json)


@app.command
def lineage(
    row_id: Annotated[str, Parameter(name="ID", help="Id of a row: grasp, simulation, tool, design, batch, fit, ...")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    children: Annotated[bool, Parameter(negative="", help="What was made from it, instead of its parents.")] = False,
    depth: Annotated[int | None, Parameter(help="Steps to follow; default: all.")] = None,
    limit: Annotated[
        int | None,
        Parameter(
            help="More rows of one table beside a row than this are only counted; default: 5, with --json 10000."
        ),
    ] = None,
    json: AsJson = False,
) -> None:
    """Show what a row was made from, back to config, code and seed; each row with its parents in turn."""
    from fast.flows.report.lineage import lineage_json, lineage_text
    from fast.lake.query.lineage import find_lineage

    _check_not_negative("--depth", depth)
    _check_not_negative("--limit", limit)
    if limit is None:
        limit = _LIMIT_JSON if json else _LIMIT_TEXT
    found = find_lineage(open_lake(lake), row_id, forward=children, depth=depth, limit=limit)
    if json:
        show(lineage_json(found), "", json)
    else:
        say(lineage_text(found))


def _check_not_negative(option: str, value: int | None) -> None:
    """Raise UsageError for a negative count."""
    if value is not None and value < 0:
        raise UsageError(f"{option} is {value}, it must be at least 0; change it.")


def _check_campaign(lake: "Lake", campaign: str) -> None:
    """Raise UsageError when neither a campaign nor an import of this name is in the lake."""
    from fast.models.validation import closest

    sql = "SELECT campaign_id FROM campaigns UNION SELECT campaign_id FROM grasps"
    known = lake.query(sql).column(0).to_pylist()
    if campaign not in known:
        raise UsageError(f"campaign `{campaign}` is not in this lake; {closest(campaign, known)}")


def _counts_text(verb: str, counts: dict[str, int]) -> str:
    nouns = {"n_designs": "design", "n_real": "measured grasp", "n_sim": "simulated grasp", "n_samples": "sample"}
    return f"{verb} " + ", ".join(spell_count(counts[name], noun) for name, noun in nouns.items())
