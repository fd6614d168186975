"""Configs that the page knows: those kept in the lake, those of the lab's folder, and those of FAST."""

import json
import os
import re
from contextlib import suppress
from pathlib import Path

from fast.flows.page.strip import read_last_start
from fast.flows.server.child_process import CHECKOUT
from fast.flows.server.environment import FOLDER_VARIABLE
from fast.lake.storage.files import write_file
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError
from fast.tasks.campaign.config import load_config, world_path

# A text with a dot in quotes names a file where there is one: alone, in a list, or as a key of `objects.file_ids`.
_NAMED_FILE = re.compile(r"""\"([^"/~\n][^"\n]*\.[^"\n]*)\"|'([^'/~\n][^'\n]*\.[^'\n]*)'""")


def list_configs(lake: Lake) -> list[str]:
    """List configs to start from: those that were kept here, those of the folder of `fast serve`, and those of FAST."""
    own = sorted(path.name for path in _own_folder(lake).glob("[!.]*.toml"))
    coming = sorted({path.name for folder in _list_folders() for path in folder.glob("*.toml")})
    first = ["quick.toml"] if "quick.toml" in coming else []
    return [*(f"lake/{name}" for name in own), *first, *(name for name in coming if name not in first)]


def read_config(lake: Lake, name: str) -> str:
    """Read the text of a config by its name in the list.

    Raises:
        UsageError: it is not in the list, or cannot be read.
    """
    try:
        return _find_config(lake, name).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{name} cannot be read ({error}); choose another.") from error


def find_same(lake: Lake, text: str) -> Path | None:
    """Find the config of the list with this very text, if there is one."""
    for path in (_find_config(lake, name) for name in list_configs(lake)):
        if path.read_bytes().decode("utf-8-sig", "replace").strip() == text.strip():
            return path
    return None


def keep_config(lake: Lake, text: str, base: str, name: str) -> Path:
    """Write a config beside those of the lake; files that it names are looked for where its base names them."""
    folders = [_find_config(lake, base).parent] if base in list_configs(lake) else _list_folders()

    def place(match: re.Match[str]) -> str:
        path = next((path for near in folders if (path := near / (match[1] or match[2])).is_file()), None)
        return match[0] if path is None else json.dumps(str(path.resolve()), ensure_ascii=False)

    path = _own_folder(lake) / f"{name}.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, _NAMED_FILE.sub(place, text).encode())
    return path


def find_world(lake: Lake, campaign_id: str) -> Path:
    """Find the world file of a campaign's virtual bench; without one, that of the list's first config that has one.

    Raises:
        UsageError: none has.
    """
    start = read_last_start(lake, campaign_id)
    first = [Path(start.config)] if start is not None and start.config else []
    for path in [*first, *(_find_config(lake, name) for name in list_configs(lake))]:
        with suppress(FastError):
            return world_path(path, load_config(path))
    raise UsageError("no config that can be used names a world, so there is no virtual bench; add one to campaigns/.")


def _own_folder(lake: Lake) -> Path:
    return lake.root / "outputs" / "configs"


def _list_folders() -> list[Path]:
    """List folders of configs; of two files with one name, the first's is meant, as by the worker (`find_config`)."""
    served = os.environ.get(FOLDER_VARIABLE)
    return [folder / "campaigns" for folder in ([Path(served)] if served else []) + [CHECKOUT]]


def _find_config(lake: Lake, name: str) -> Path:
    if name not in list_configs(lake):
        raise UsageError(f"there is no config `{name}`; choose one of the list.")
    folder, _, file = name.rpartition("/")
    if folder == "lake":
        return _own_folder(lake) / file
    return next(path for near in _list_folders() if (path := near / file).is_file())
