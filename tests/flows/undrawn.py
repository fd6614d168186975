"""Reports without drawings on disk, where the claim is about words and numbers: a drawing takes most of a report."""

from pathlib import Path

import numpy as np
import pytest

from fast.flows.campaign.results import write_files
from fast.flows.report.folder import Folder
from fast.lake.store import Lake


def leave_undrawn(patch: pytest.MonkeyPatch) -> None:
    """Have figures made but not written, bodies left blank, and no grasp simulated for them.

    The tests of `tests/flows/report` draw every one.
    """
    patch.setattr("fast.flows.report.folder.save_svg", lambda figure, path: None)
    draw = Folder.draw
    patch.setattr(Folder, "draw", lambda self, name, figure, for_print=False, kind=None: draw(self, name, figure))
    for picture in ("fast.flows.report.campaign.finger.render", "fast.flows.report.campaign.traces.object_picture"):
        patch.setattr(picture, lambda *words, **options: np.zeros((8, 8, 4)))
    leave_unsimulated(patch)


def leave_unsimulated(patch: pytest.MonkeyPatch) -> None:
    """Have a report without the grasp that it simulates itself, seven times: `test_paper` shows it."""
    patch.setattr("fast.flows.report.campaign.simulation.simulate_again", lambda *_: None)


def write_files_undrawn(lake: Lake, campaign_id: str, output: Path) -> tuple[object, ...]:
    """What a campaign's last process writes, without drawings."""
    with pytest.MonkeyPatch.context() as patch:
        leave_undrawn(patch)
        return write_files(lake, campaign_id, output)
