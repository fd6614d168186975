"""The example of gap discovery: a small lake that comes with the program, measured grasps and warm simulations."""

from pathlib import Path
from tempfile import mkdtemp
from zipfile import ZipFile

from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow
from fast.models.errors import UsageError, describe_cause

CAMPAIGN = "example"
FILE = Path(__file__).with_name("example.zip")
LAKE = "lake"


def open_example(out: Path | None = None, file: Path = FILE) -> tuple[Lake, Path]:
    """Open the example's lake, unpacked into `lake` in folder `out` (default: a new temporary one), and return both.

    A folder that has it already is gone on with.

    Raises:
        UsageError: the lake in the folder is another one, or cannot be written.
    """
    folder = Path(mkdtemp(prefix="fast-gap-")) if out is None else out
    if not Lake.exists(folder / LAKE):
        _unpack(file, folder / LAKE)
    lake = Lake.open(folder / LAKE)
    known = lake.ids(CampaignRow)
    if known != {CAMPAIGN}:
        found = sorted(known - {CAMPAIGN})[:1] or ["none"]
        raise UsageError(f"{folder / LAKE} is another lake (campaign {found[0]}); give a new folder as --out.")
    return lake, folder


def _unpack(file: Path, root: Path) -> None:
    """Unpack a lake beside its place, then move it there: a kill leaves no half of it."""
    try:
        root.parent.mkdir(parents=True, exist_ok=True)
        part = Path(mkdtemp(prefix=f".{root.name}-", dir=root.parent))
        with ZipFile(file) as archive:
            archive.extractall(part)
        part.replace(root)
    except OSError as error:
        raise UsageError(
            f"{root} cannot be written ({describe_cause(error)}); give another folder as --out."
        ) from error
