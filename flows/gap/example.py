"""The example of gap discovery: a small lake that comes with the program, measured grasps and warm simulations."""

from pathlib import Path
from tempfile import mkdtemp

from fast.lake.handoff.packed import read_packed
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow
from fast.models.errors import UsageError

CAMPAIGN = "example"
FILE = Path(__file__).with_name("example.npz")
LAKE = "lake"


def open_example(out: Path | None = None, file: Path = FILE) -> tuple[Lake, Path]:
    """The example's lake, unpacked into `lake` in the folder `out` (default: a new temporary one), and that folder.

    A folder that has it already is gone on with.

    Raises:
        UsageError: the lake in the folder is another one, or cannot be written.
    """
    folder = Path(mkdtemp(prefix="fast-gap-")) if out is None else out
    lake = Lake.open(folder / LAKE, create=True)
    known = lake.ids(CampaignRow)
    if known - {CAMPAIGN}:
        raise UsageError(f"{folder / LAKE} is another lake (campaign {sorted(known)[0]}); give a new folder as --out.")
    if not known:
        lake.append(read_packed(file), current_provenance())
    return lake, folder
