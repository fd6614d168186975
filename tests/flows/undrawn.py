"""Reports without drawings on disk, where the claim is about words and numbers: a drawing takes most of a report."""

import numpy as np
import pytest

from fast.flows.report.folder import Folder


def leave_undrawn(patch: pytest.MonkeyPatch) -> None:
    """Have figures made but not written, and bodies left blank; the tests of `tests/flows/report` draw every one."""
    patch.setattr("fast.flows.report.folder.save_svg", lambda figure, path: None)
    draw = Folder.draw
    patch.setattr(Folder, "draw", lambda self, name, figure, for_print=False, kind=None: draw(self, name, figure))
    for picture in ("fast.flows.report.campaign.finger.render", "fast.flows.report.campaign.traces.object_picture"):
        patch.setattr(picture, lambda *words, **options: np.zeros((8, 8, 4)))
