"""GRBL 1.1 alarm and error codes: what they say, and what they mean for the position."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AlarmMeaning:
    """An alarm in words.

    Attributes:
        text: what happened.
        keeps_position: whether MPos is still true; if not, only homing gives a position again.
        is_critical: whether the controller is deaf to all but a soft reset afterwards.
        next_step: what a person does.
    """

    text: str
    keeps_position: bool
    is_critical: bool
    next_step: str


HARD_LIMIT = 1
HOMING_REQUIRED = 11  # grblHAL
_HOME_AGAIN = "home again"
_CHECK_SWITCH = "check the limit switches and the motors, then home again"

ALARMS = {
    HARD_LIMIT: AlarmMeaning(
        "a hard limit was hit", False, True, "look at the machine, free the switch, then home again"
    ),
    2: AlarmMeaning("a target lay beyond the soft limits", True, True, "correct the plan; stop the campaign"),
    3: AlarmMeaning("it was reset while moving", False, False, _HOME_AGAIN),
    4: AlarmMeaning("the probe was already in its end state", True, False, "check the probe"),
    5: AlarmMeaning("the probe found nothing", True, False, "check the probe"),
    6: AlarmMeaning("homing was reset", False, False, _HOME_AGAIN),
    7: AlarmMeaning("the door opened during homing", False, False, "close the door, then home again"),
    8: AlarmMeaning("a switch did not open on pull-off during homing", False, False, _CHECK_SWITCH),
    9: AlarmMeaning("homing found no switch", False, False, _CHECK_SWITCH),
    10: AlarmMeaning("homing failed on a dual axis (grblHAL: an emergency stop)", False, True, _CHECK_SWITCH),
}

UNKNOWN_ALARM = AlarmMeaning("an alarm of unknown meaning", False, True, "look at the machine, then home again")


def alarm_meaning(code: int) -> AlarmMeaning:
    """Return the meaning of `ALARM:code`; an unknown code counts as the worst: deaf, position lost."""
    return ALARMS.get(code, UNKNOWN_ALARM)


ERRORS = {
    1: "no letter before a number",
    2: "bad number",
    3: "unknown $ command",
    4: "negative value",
    5: "homing is not enabled",
    6: "step pulse below 3 us",
    7: "EEPROM read failed, defaults restored",
    8: "$ command needs Idle",
    9: "locked by alarm or jog",
    10: "soft limits need homing",
    11: "line too long",
    12: "step rate too high",
    13: "door is open",
    14: "start-up or info line too long",
    15: "target beyond travel",
    16: "bad jog",
    17: "laser mode needs PWM",
    20: "unsupported word",
    21: "two words of one modal group",
    22: "no feed rate",
    23: "integer needed",
    24: "two commands that use axis words",
    25: "repeated word",
    26: "axis words missing",
    27: "bad line number",
    28: "P or L missing",
    29: "G59.x is not supported",
    30: "G53 needs G0 or G1",
    31: "axis words unused",
    32: "arc without axis words in the plane",
    33: "bad target",
    34: "bad arc radius",
    35: "arc without offsets",
    36: "unused words",
    37: "G43.1 axis",
    38: "tool number too large",
    # grblHAL's own
    18: "it was reset",
    19: "value not above zero",
    39: "value out of range",
    43: "feed rate too high",
    45: "a limit switch is closed",
    46: "homing needed",
    52: "setting out of range",
    53: "no such setting in this build",
    79: "not in a critical alarm",
}


LOSES_POSITION = frozenset({7})  # default settings: other steps per mm


def error_keeps_position(code: int) -> bool:
    """Return whether MPos is true after `error:code`: a refused line moves nothing; an unknown code counts as no."""
    return code in ERRORS and code not in LOSES_POSITION


def error_text(code: int) -> str:
    """Return what `error:code` says."""
    return ERRORS.get(code, "error of unknown meaning")
