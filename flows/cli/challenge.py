"""`fast challenge`: worlds that hide what is missing in the simulator, and the grading of answers to them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.common import AsJson, make_app, say_progress, show, table_text

if TYPE_CHECKING:
    from fast.flows.challenge.grade import Rows

app = make_app(name="challenge", help="Test a method of your own: find what made-up benches hide, and be graded.")
_SHOWN = ["figure", "worlds", "value", "low95", "high95", "bound"]


@app.command
def start(
    folder: Annotated[Path, Parameter(help="New folder for the worlds; the answers go beside it.")],
    *,
    json: AsJson = False,
) -> None:
    """Get the twelve public worlds, and a file of answers to fill in."""
    from fast.flows.challenge.public import start as copy

    answers = copy(folder)
    text = f"{folder}: twelve worlds\n{answers}: your answers; then `fast challenge grade {answers}`"
    show({"worlds": folder, "answers": answers}, text, json)


@app.command
def make(
    folder: Annotated[Path, Parameter(help="New folder for the worlds; the keys go to FOLDER_keys beside it.")],
    *,
    seed: Annotated[Path, Parameter(help="File with 16 secret characters or more: who knows them knows the keys.")],
    worlds: Annotated[int, Parameter(help="How many worlds.", validator=Number(gte=3, lte=999))] = 12,
    panel: Annotated[
        Path | None, Parameter(help="Panel of true grasps to make them of; default: the public one.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Make sealed worlds from a secret: a folder to hand out, and the keys, whose hashes the folder tells."""
    from fast.flows.challenge.hidden.panel_file import PANEL
    from fast.flows.challenge.keys import find_keys
    from fast.flows.challenge.make import make_challenge, read_seed

    manifest = make_challenge(read_seed(seed), folder, worlds, panel or PANEL, say_progress)
    keys = find_keys(folder)
    text = (
        f"{folder}: challenge {manifest.challenge}, {len(manifest.worlds)} worlds to hand out\n"
        f"{keys}: the keys; hand them out when the answers are in"
    )
    show({"challenge": manifest.challenge, "worlds": folder, "keys": keys}, text, json)


@app.command
def grade(
    answers: Annotated[Path, Parameter(help="File of the answers, ANSWERS.json.")],
    *,
    challenge: Annotated[
        Path | None, Parameter(help="Folder of the worlds that were answered; default: the public ones.")
    ] = None,
    keys: Annotated[Path | None, Parameter(help="Folder of the keys; default: FOLDER_keys beside the worlds.")] = None,
    json: AsJson = False,
) -> None:
    """Open the keys and grade the answers: false alarms, alarms by size, families, probabilities, gap closed, cost."""
    from fast.flows.challenge.grade import describe_doubts, grade_answers, make_tables
    from fast.flows.challenge.public import PUBLIC

    given, graded = grade_answers(answers, challenge or PUBLIC, keys)
    tables, doubts = make_tables(graded), describe_doubts(graded)
    text = _text(f"{given.entrant}, {len(graded)} worlds; 95 % intervals", tables)
    text = "\n\n".join([text, *(f"warning: {one}" for one in doubts)])
    show({"entrant": given.entrant, "challenge": given.challenge, **tables, "warnings": doubts}, text, json)


def _text(head: str, tables: "dict[str, Rows]") -> str:
    return "\n\n".join(
        [
            head,
            table_text(tables["figures"], _SHOWN),
            "stated probability that something is missing, and how often it was",
            table_text(tables["probabilities"], ["figure", "worlds", "stated", "value", "low95", "high95"]),
            "what each world hid, and what was said",
            table_text(tables["worlds"]),
        ]
    )
