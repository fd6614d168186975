"""Logs of tests/data/wire against the drivers of today: the wire is what it was."""

from pathlib import Path

import pytest

from fast.hardware.replay.grbl import split
from fast.hardware.replay.replay import replay
from fast.hardware.wire.log_files import RecordedWire, read_session
from fast.models.errors import UsageError

FOLDER = Path(__file__).parents[2] / "data" / "wire"
RECORD = "the drivers speak differently now; if that is meant, run `python -m tests.hardware.wire.record_wire_logs`"


@pytest.mark.parametrize("name", ["gantry", "gantry-firmware", "plc", "load-cell", "load-cell-rtu"])
def test_a_recorded_session_is_repeated_to_the_byte(name):
    recorded = read_session(FOLDER / f"{name}.log")
    outcome = replay(recorded)
    assert outcome.difference is None, f"{RECORD}\n{outcome.difference.as_text()}"
    sent = [entry.data for entry in recorded.entries if entry.direction == "sent"]
    pieces = [piece for piece in split(b"".join(sent))[0] if piece != b"?"] if name.startswith("gantry") else sent
    assert outcome.n_compared == len(pieces) > 10
    if name.startswith("gantry"):
        assert ["ALARM:1" in error for error in outcome.errors] == [True]
    else:
        assert outcome.errors == []


def test_a_log_of_an_unknown_device_is_refused():
    recorded = read_session(FOLDER / "gantry.log")
    header = recorded.header
    unknown = RecordedWire(type(header)(**{**header.__dict__, "device": "oven"}), recorded.entries)
    with pytest.raises(UsageError, match="No driver knows the device `oven`.*gantry, plc, load-cell"):
        replay(unknown)


def test_a_gantry_log_without_its_beginning_is_refused():
    recorded = read_session(FOLDER / "gantry.log")
    with pytest.raises(UsageError, match="only be replayed from its connection on"):
        replay(RecordedWire(recorded.header, recorded.entries, is_cut=True))
