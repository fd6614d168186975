import pytest

from lake.tables import ToolRow
from models.errors import UsageError
from tasks.printing import MeasuredTool, PrintConfirmation, confirm_print, print_folder, write_tray
from tasks.proposing import propose_initial


@pytest.fixture
def proposed(campaign):
    propose_initial(campaign)
    return campaign


def test_tray_is_written_with_sheet_and_files(proposed):
    folder = print_folder(proposed.lake, "small", 1)
    sheet = write_tray(proposed.lake, "small", 1, folder)
    names = {path.name for path in folder.iterdir()}
    assert {"tray.3mf", "B01T0_compliant.stl", "B01T1_rigid.stl", "sheet.html"} <= names
    assert "fast print confirm small/B01 --operator NAME" in sheet.read_text()


def test_confirmation_records_rejects_and_measures(proposed):
    word = PrintConfirmation(
        operator="ada", rejected={1: "tip torn"}, measured={0: MeasuredTool(measured_front_thickness_mm=2.4)}
    )
    assert confirm_print(proposed.lake, "small", 1, word) == 1
    tools = {row["slot"]: row for row in proposed.lake.rows(ToolRow)}
    assert tools[0]["measured_front_thickness_mm"] == 2.4
    assert (tools[1]["status"], tools[1]["reason"]) == ("rejected", "tip torn")
    assert proposed.state().is_confirmed(1)


def test_second_confirmation_changes_nothing(proposed):
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada"))
    with pytest.raises(UsageError, match="already confirmed; nothing was changed"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="bob"))
    assert {row["operator"] for row in proposed.lake.rows(ToolRow)} == {"ada"}


def test_unknown_slot_and_batch_are_refused(proposed):
    with pytest.raises(UsageError, match="slot 7 is not in batch small/B01, its slots are 0 to 1"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", rejected={7: "lost"}))
    with pytest.raises(UsageError, match="batch small/B09 does not exist"):
        confirm_print(proposed.lake, "small", 9, PrintConfirmation(operator="ada"))
    assert proposed.lake.rows(ToolRow) == []
