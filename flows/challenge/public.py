"""The public set: twelve worlds that come with the program, keys and all, to try a method on."""

import json
import shutil
from pathlib import Path

from fast.flows.challenge.manifest import Manifest
from fast.models.errors import UsageError

PUBLIC = Path(__file__).with_name("public_worlds")
TEMPLATE = "answers.json"


def start(folder: Path) -> Path:
    """Copy the public worlds, without their keys, into a new folder; beside it the answers of who says nothing.

    Returns the file of the answers.

    Raises:
        UsageError: the folder is there already, or cannot be written.
    """
    folder = folder.absolute()
    answers = folder.parent / f"{folder.name}-{TEMPLATE}"
    for there in (folder, answers):
        if there.exists():
            raise UsageError(f"{there} is there already; nothing was written: name a new folder.")
    try:
        shutil.copytree(PUBLIC, folder)
        answers.write_text(json.dumps(make_template(folder), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{folder} cannot be written ({error}); name another folder.") from error
    return answers


def make_template(folder: Path) -> dict[str, object]:
    """Make answers that say of every world that nothing is missing, half sure."""
    manifest = Manifest.read(folder)
    answers = [
        {"world": name, "missing": False, "probability": 0.5, "effect": "", "cpu_s": 0.0} for name in manifest.worlds
    ]
    return {"entrant": "your method", "challenge": manifest.challenge, "answers": answers}
