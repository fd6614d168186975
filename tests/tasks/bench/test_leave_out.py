"""A tool that a person leaves out counts as rejected from then on."""

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ToolRow
from fast.models.errors import UsageError
from fast.tasks.bench.leave_out import is_left_out, leave_out
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from tests.flows.cli.cli_lakes import proposed_lake


def test_a_tool_is_left_out_once_and_with_a_reason(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    with pytest.raises(UsageError, match="nobody has confirmed a tool `quick/B01T0`"):
        leave_out(lake, "quick/B01T0", "tip torn", "ada")
    confirm_print(lake, "quick", 1, PrintConfirmation(operator="ada"))
    with pytest.raises(UsageError, match="say why"):
        leave_out(lake, "quick/B01T0", " ", "ada")
    assert not is_left_out(lake, "quick/B01T0")
    leave_out(lake, "quick/B01T0", "tip torn", "grace")
    assert is_left_out(lake, "quick/B01T0")
    assert not is_left_out(lake, "quick/B01T1")
    row = lake.rows(ToolRow, tool_id="quick/B01T0")[-1]
    assert (row["status"], row["reason"]) == ("rejected", "tip torn (left out by grace)")
    assert lake.records(EventRow, kind="tool_left_out")[0].message == "grace left out quick/B01T0: tip torn"
    with pytest.raises(UsageError, match="is left out already"):
        leave_out(lake, "quick/B01T0", "again", "ada")
