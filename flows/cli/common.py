"""What the commands share: the lake option, output as text or JSON, spoken progress."""

import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TextIO, get_args

from cyclopts import App, ArgumentCollection, Group, Parameter
from cyclopts.exceptions import CoercionError

from fast.models.errors import UsageError, describe_cause

LakePath = Annotated[
    Path,
    Parameter(
        name="--lake", env_var="FAST_LAKE", help="The lake, which keeps all data: a folder, or s3://BUCKET/PREFIX."
    ),
]
AsJson = Annotated[bool, Parameter(name="--json", negative="", help="Print the result as JSON, for machines.")]
CampaignId = Annotated[str | None, Parameter(help="Campaign; not needed when the lake has only one.")]
OBJECT_HELP = "Number or name of an object (fast objects list), or the file of an own one."

DEFAULT_LAKE = Path("lake-data")
_WIDEST_FIELD = 60


def _refuse_fractions(arguments: ArgumentCollection) -> None:
    """Refuse 3.5 where a whole number is wanted, which cyclopts would round; 3.0 is one.

    Raises:
        CoercionError: an argument has a fraction.
    """
    for argument in arguments:
        kinds = {argument.hint, *get_args(argument.hint)}
        if int not in kinds or kinds & {float, str}:
            continue
        for token in argument.tokens:
            if "." in token.value and not float(token.value).is_integer():
                raise CoercionError(argument=argument, token=token, target_type=int)


make_app = partial(
    App,
    group_arguments=Group("Arguments", validator=_refuse_fractions),
    group_parameters=Group("Parameters", validator=_refuse_fractions),
)


def say(text: str) -> None:
    """Print a line of result to standard output."""
    _write(text, sys.stdout)


def say_progress(text: str) -> None:
    """Print progress to standard error, so that standard output stays the result."""
    _write(text, sys.stderr)


def _write(text: str, stream: TextIO) -> None:
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:  # the reader has what it wants (`| head`); the work goes on
        drop(stream)


def drop(stream: TextIO) -> None:
    """Drop what is left in a stream that nobody takes: it goes nowhere, without a traceback at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def show(data: Any, text: str, as_json: bool) -> None:
    """Print a result: `data` as JSON for machines, or `text` for people."""
    say(json.dumps(data, indent=2, default=str) if as_json else text)


def write_out(option: str, path: Path, content: bytes) -> None:
    """Write the one file that an option names, whole or not at all.

    Raises:
        UsageError: it cannot be written; an older file of its name is as it was.
    """
    from fast.lake.storage.files import write_file

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, content)
    except OSError as error:
        raise UsageError(f"{option} `{path}` cannot be written: {describe_cause(error)}; give another file.") from error


def table_text(rows: list[dict[str, Any]], columns: list[str] | None = None, width: int | None = None) -> str:
    """Return rows as an aligned plain-text table; numbers to the right, long values cut.

    width: a wider table is cut into tables below each other, each with the first column.
    """
    names = columns or list(rows[0] if rows else {})
    if width is not None and rows:
        return "\n\n".join(table_text(rows, part) for part in _fit_columns(rows, names, width))
    if not rows:
        return "  ".join(names) + "\n(no rows)" if names else "(no rows)"
    cells = [[_field(row.get(name)) for name in names] for row in rows]
    widths = [max(len(name), *(len(row[i]) for row in cells)) for i, name in enumerate(names)]
    numeric = [all(isinstance(row.get(name), int | float) for row in rows) for name in names]
    lines = ["  ".join(name.ljust(width) for name, width in zip(names, widths, strict=True)).rstrip()]
    lines.append("  ".join("-" * width for width in widths))
    for row in cells:
        padded = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(row, widths, numeric, strict=True)]
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def _fit_columns(rows: list[dict[str, Any]], names: list[str], width: int) -> list[list[str]]:
    """Return the columns of the tables that a wide one is cut into; the first one leads each."""
    wide = {name: max(len(name), *(len(_field(row.get(name))) for row in rows)) for name in names}
    first, *others = names
    parts, taken = [[first]], wide[first]
    for name in others:
        if taken + 2 + wide[name] > width and len(parts[-1]) > 1:
            parts.append([first])
            taken = wide[first]
        parts[-1].append(name)
        taken += 2 + wide[name]
    return parts


def _field(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    text = " ".join(text.split("\n"))
    return text if len(text) <= _WIDEST_FIELD else text[: _WIDEST_FIELD - 3] + "..."
