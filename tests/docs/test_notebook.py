"""docs/tutorial/first-grasps.ipynb: its cells run in order, and show what their text says."""

import json
from typing import Any

import pytest

from tests.docs.pages import DOCS

NOTEBOOK = json.loads((DOCS / "tutorial" / "first-grasps.ipynb").read_text(encoding="utf-8"))
CELLS = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow  # processes start, and kernels may have to be compiled
@pytest.mark.timeout(900)
def test_the_cells_run_in_order(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for cell in CELLS:
        exec(compile(cell, "first-grasps.ipynb", "exec"), names)
    assert "<svg" in names["result"]._repr_html_()
    peaks = names["found"].peak_force_n
    assert peaks.shape == (2, 2)
    assert (peaks > 1.0).all()
    assert peaks[1, 0] == pytest.approx(names["result"].peak_force_n)  # the published finger has five ribs
    assert capsys.readouterr().out == "FinRay: `length_mm` is 99 mm, it must be at most 35.0 mm; change it.\n"


def test_it_is_kept_without_what_it_showed() -> None:
    assert all(not cell.get("outputs") for cell in NOTEBOOK["cells"])
