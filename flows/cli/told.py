"""`fast ask` and `fast tell`: a campaign on a bench of one's own, a batch at a time."""

import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say_progress, show, table_text
from fast.models.errors import UsageError
from fast.models.units import spell_count

_SHOWN = 4  # samples of a guess
_MOST_PULLS = 12
Config = Annotated[Path, Parameter(help='TOML file of a campaign with bench.kind = "folder".')]


def ask(
    config: Config,
    *,
    out: Annotated[
        Path | None, Parameter(help="New folder for the files of printer and bench; without it only the list is shown.")
    ] = None,
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Say which tools to print and which grasps to make next: the open batch, or a new one; makes the lake if needed.

    Simulations of the schedule that a guided batch waits for are made first. The same command again gives the same
    batch until it is told.
    """
    from fast.flows.campaign.ask_tell import ask as ask_next
    from fast.lake.store import Lake
    from fast.tasks.campaign.config import load_config
    from fast.tasks.campaign.state import rank_tools

    asked = ask_next(config, lake, out, say_progress)
    if asked is None:
        best = rank_tools(open_lake(lake), load_config(config).campaign_id)[:1]
        words = f"; best tool {best[0]['tool_id']}, {best[0]['tool_quality_n']:.2f} N" if best else ""
        text = f"the schedule is complete{words}. Raise schedule.guided_batches for more."
        show({"batch": None, "best_tool": best[0] if best else None}, text, json)
        return
    rows = [
        {"tool": tool_id, "grasps": sum(grasp.tool_id == tool_id for grasp in asked.grasps), **design.model_dump()}
        for tool_id, design in sorted(asked.designs.items())
    ]
    counted = f"{spell_count(len(rows), 'tool')}, {spell_count(len(asked.grasps), 'grasp')}"
    lines = [f"batch {asked.batch_id}: {counted}", "", table_text(rows, width=110)]
    if asked.folder is not None:
        lines += ["", f"wrote {asked.folder}; fill in results.csv, then:"]
        lines += [
            shlex.join(["fast", "tell", str(config), str(asked.folder / "results.csv"), "--lake", Lake(lake).address])
        ]
    grasps = [grasp.model_dump(include={"tool_id", "object_id", "repeat"}) for grasp in asked.grasps]
    data = {"batch": asked.batch_id, "designs": {k: d.model_dump() for k, d in asked.designs.items()}}
    show(data | {"grasps": grasps, "folder": asked.folder}, "\n".join(lines), json)


def tell(
    config: Config,
    results: Annotated[
        list[Path] | None,
        Parameter(
            negative="", help="Tables of peaks (results.csv), folders with traces, or with --format files of a machine."
        ),
    ] = None,
    *,
    format: Annotated[
        Path | None,
        Parameter(help="TOML file that says how a testing machine writes; guessed and written if it is not there."),
    ] = None,
    operator: Annotated[str, Parameter(help="Who measured.")] = "unknown",
    replace: Annotated[bool, Parameter(negative="", help="Correct what was told before with other numbers.")] = False,
    sure: Annotated[
        bool, Parameter(negative="", help="Numbers that look strange are right; they are marked in the lake.")
    ] = False,
    undo: Annotated[bool, Parameter(negative="", help="Take back the last telling, in place of telling.")] = False,
    dry_run: Annotated[bool, Parameter(negative="", help="Only check, write nothing.")] = False,
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Tell what was measured: all is written or, with what is wrong named, nothing. A campaign that waits goes on.

    Tools of which a grasp is told count as printed; say otherwise with `fast print confirm` before.
    """
    import tempfile
    from dataclasses import asdict

    from fast.flows.campaign.ask_tell import tell as tell_all
    from fast.flows.campaign.ask_tell import untell
    from fast.tasks.bench.told import Telling

    if undo == bool(results):
        raise UsageError("give files to tell, or --undo and no files; nothing was written.")
    if undo:
        n = untell(config, lake, operator)
        show({"n_taken_back": n}, f"{spell_count(n, 'grasp')} taken back; tell again what is right.", json)
        return
    results = results or []

    is_guessed = format is not None and not format.exists()
    is_dry = dry_run or is_guessed
    is_sure = sure or is_guessed  # what is strange is asked when it is told, not while its format is looked at
    with tempfile.TemporaryDirectory() as folder:
        path = format
        if format is not None and is_guessed:
            path = Path(folder) / format.name if dry_run else format
            _guess(config, lake, results, path, f"{format} is not there: guessed{'' if dry_run else ' and written'}")
        taken = tell_all(
            config, lake, results, Telling(operator, is_dry, may_replace=replace, is_sure=is_sure), format_path=path
        )
    for note in taken.notes:
        say_progress(note)
    why = "--dry-run" if dry_run else f"look at {format}, then give the same command again"
    words = f"nothing was written ({why}); it would be: {taken.sentence}" if is_dry else taken.sentence
    show(asdict(taken) | {"is_dry": is_dry}, f"{words}.", json)


def _guess(config: Path, lake: Path, results: list[Path], path: Path, words: str) -> None:
    """Write a format file, guessed from the first file of a machine; show it, and what is read with it."""
    from fast.flows.campaign.ask_tell import describe_pull, guess

    text, grasps = guess(config, lake, results, path)
    rows = [
        {
            "file": Path(one.place).name,
            **describe_pull(one),
            "at, mm": float(one.trace.lift_mm[one.trace.force_n.argmax()]),
        }
        for one in grasps
        if one.trace is not None
    ]
    first = grasps[0].trace
    samples = [] if first is None else list(zip(first.time_s, first.lift_mm, first.force_n, strict=True))[:_SHOWN]
    shown = [dict(zip(("time_s", "lift_mm", "force_n"), map(float, sample), strict=True)) for sample in samples]
    say_progress(f"{words}:\n\n{text}")
    say_progress(f"With it the first samples of {rows[0]['file']} are\n\n{table_text(shown)}\n\nand the pulls\n")
    more = f"\nand {len(rows) - _MOST_PULLS} more" if len(rows) > _MOST_PULLS else ""
    say_progress(table_text(rows[:_MOST_PULLS]) + more + "\n")
