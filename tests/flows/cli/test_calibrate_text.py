"""What `fast calibrate` says of held-out designs."""

from types import SimpleNamespace

import pytest

from fast.flows.cli.calibrate import _held_out_line

ROW = {
    "data": "mean", "n_held_out": 3, "held_out_by": "emulator", "rmse_before_n": 2.5, "rmse_after_n": 0.75,
    "correlation_before": 0.5, "correlation_after": 0.9,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({}, "held out: 3 designs by the emulator, correlation 0.500 -> 0.900, RMSE 2.50 -> 0.75 N"),
        ({"correlation_before": None}, "held out: 3 designs by the emulator, RMSE 2.50 -> 0.75 N"),
        ({"correlation_after": None}, "held out: 3 designs by the emulator, RMSE 2.50 -> 0.75 N"),
        ({"rmse_after_n": None}, "held out: 3 designs, nothing compared"),
        ({"rmse_before_n": None}, "held out: 3 designs, nothing compared"),
        ({"n_held_out": None}, "held out: 0 designs, nothing compared"),
        ({"data": "trace"}, "held out: none; traces teach about theta, not about designs"),
    ],
)
def test_held_out_designs_in_a_line(changes: dict, line: str) -> None:
    assert _held_out_line(SimpleNamespace(**ROW | changes)) == line  # type: ignore[arg-type]
