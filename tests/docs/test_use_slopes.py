"""Runs the code of docs/how-to/use-slopes.md as it is printed there."""

from typing import Any

import pytest

from tests.docs.pages import DOCS, blocks_of

SIMULATE, OPTIMISE = [block.text for block in blocks_of(DOCS / "how-to" / "use-slopes.md", "python")]


def run_block(code: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(code, "use-slopes.md", "exec"), names)
    return names


def test_slopes_are_those_that_were_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    result = run_block(SIMULATE)["result"]
    assert [line.split()[::2] for line in capsys.readouterr().out.splitlines()] == [
        [name, slope.unit] for name, slope in result.slopes.by.items()
    ]
    assert result.slopes.by["length_mm"].force_n.shape == result.trace.force_n.shape


def test_torch_gets_the_slope_of_the_peak() -> None:
    names = run_block(OPTIMISE)
    assert names["x"].grad.shape == (1, 2)
    moved = names["x"].detach() + names["torch"].tensor([[0.0, 0.02]])
    difference = (names["peak"](moved) - names["peak"](names["x"])).item() / 0.02
    assert names["x"].grad[0, 1].item() == pytest.approx(difference, rel=0.2)
