"""Replay of any wire log of a bench against the driver of its device."""

from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.replay.grbl import replay_grbl
from fast.hardware.replay.modbus import replay_modbus
from fast.hardware.replay.recording import Replay
from fast.hardware.wire.log_files import GANTRY, LOAD_CELL, PLC, RecordedWire
from fast.models.errors import UsageError


def replay(recorded: RecordedWire, profile: GrblProfile | None = None) -> Replay:
    """Have the driver do again what the log holds, against the recorded device; stops at the first difference.

    `profile`: settings of the gantry's controller, where they are not the lab's.

    Raises:
        UsageError: the device is unknown, or the beginning of a gantry's log is missing.
    """
    device = recorded.header.device
    if device in (PLC, LOAD_CELL):
        return replay_modbus(recorded.entries, device)
    if device != GANTRY:
        raise UsageError(f"No driver knows the device `{device}` of this log; known are {GANTRY}, {PLC}, {LOAD_CELL}.")
    if recorded.is_cut:
        raise UsageError(
            f"The log begins in part {recorded.header.part} of session {recorded.header.session}: its first part was "
            "removed to make room, and a gantry can only be replayed from its connection on. Take a newer session."
        )
    return replay_grbl(recorded.entries, profile)
