"""`fast init`: a folder with campaign configs, virtual worlds and material data to start from."""

import shutil
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fast.flows.cli.common import AsJson, show
from fast.models.errors import UsageError

PARTS = ("campaigns", "worlds", "materials", "recipes")
_SHIPPED = Path(__file__).resolve().parents[2]
_README = """\
# A FAST project

- `campaigns/`: one config file a campaign. `quick.toml` is small, `paper.toml` the one of the FAST paper.
- `worlds/`: what a virtual bench hides (its true material, friction and scatter).
- `materials/`: what was measured of a printing material.
- `recipes/`: how fingers are printed: printer, materials, support, what is done after.

```sh
fast campaign run campaigns/quick.toml --auto-print   # a small campaign on the virtual bench, with report
fast campaign status
fast sql "SELECT tool_id, tool_quality_n FROM tool_quality ORDER BY 2 DESC"
```

Data go to the lake `lake-data/`, or to the folder that the variable FAST_LAKE names. `fast --help` lists the commands.
"""


def init(
    folder: Annotated[Path, Parameter(help="New folder; an empty one is fine.")] = Path("fast-project"),
    *,
    json: AsJson = False,
) -> None:
    """Make a project folder: configs of campaigns, virtual worlds, material data and a README with the first commands.

    Nothing is ever replaced: a folder that holds something is refused.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise UsageError(f"{folder} exists and is not an empty folder; give another one.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for part in PARTS:
            shutil.copytree(_SHIPPED / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "__init__.py"))
        (folder / "README.md").write_text(_README, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{folder} cannot be written ({error.strerror}); give another folder.") from error
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*") if path.is_file())
    text = f"{folder}: {len(files)} files.\nNext: cd {folder} && fast campaign run campaigns/quick.toml --auto-print"
    show({"folder": str(folder), "files": files}, text, json)
