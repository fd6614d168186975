"""Lakes and a runner for the tests of the command line."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from fast.flows.cli.main import run
from fast.lake.store import Lake
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.setup import register
from fast.tasks.scientist.propose import propose_initial

ROOT = Path(__file__).parents[3]
WORLD = ROOT / "worlds" / "quick.toml"
QUICK = (ROOT / "campaigns" / "quick.toml").read_text().replace("../worlds/quick.toml", "world.toml")


class Answer(NamedTuple):
    """How a command ended."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output, as JSON."""
        assert self.out, self
        return json.loads(self.out)


class Fast:
    """Runs `fast` in this process."""

    def __init__(self, capsys: Any) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> Answer:
        self._capsys.readouterr()
        status = run([str(word) for word in words])
        out, err = self._capsys.readouterr()
        return Answer(status, out, err)

    def refused(self, *words: object, status: int = 2) -> str:
        """The one line that a wrong use gets."""
        answer = self(*words)
        assert answer.status == status, answer
        assert answer.out == ""
        lines = answer.err.splitlines()
        assert len(lines) == 1, answer.err
        assert lines[0].startswith("fast: ")
        return lines[0]


def write_config(folder: Path, text: str = QUICK) -> Path:
    """A campaign config with its world beside it."""
    (folder / "world.toml").write_text(WORLD.read_text())
    path = folder / "quick.toml"
    path.write_text(text)
    return path


def proposed_lake(folder: Path, address: str | None = None) -> Path:
    """A lake, in the folder or at an address, whose campaign `quick` waits for the print of its first tools."""
    config = write_config(folder)
    if address is None:
        shutil.copytree(_proposed_once(), folder / "lake")
        return folder / "lake"
    return _propose(config, address)


@cache
def _proposed_once() -> Path:
    """The lake that every test gets a copy of, in a folder that goes with this session."""
    state = Path(os.environ["XDG_STATE_HOME"])
    state.mkdir(parents=True, exist_ok=True)  # a test may have named a folder that is not there yet
    folder = Path(tempfile.mkdtemp(dir=state))
    return _propose(write_config(folder), folder / "lake")


def _propose(config: Path, address: str | Path) -> Path:
    campaign = Campaign(Lake.open(address, create=True), load_config(config))
    register(campaign, QUICK)
    propose_initial(campaign)
    return campaign.lake.root


def everything_in(folder: Path) -> dict[str, bytes]:
    """All files below a folder with their content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def leaves(found: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Commands that do something, by their words."""
    for name in found:
        if name.startswith("-"):
            continue
        child = found[name]
        if child.default_command is not None:
            yield " ".join((*path, name)), child
        yield from leaves(child, (*path, name))
