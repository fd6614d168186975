"""The flag on a grasp that went wrong; apart from what finds it, since tables and commands need no more."""

from typing import Literal, NamedTuple, get_args

Kind = Literal["stuck_valve", "ejection", "early_loss", "torsional_slip", "negative_preload", "drifting_cell"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Compared = Literal["repeats", "expected", "peers", "zero"]  # peers: of lakes before there were expectations


class Anomaly(NamedTuple):
    """A flag on grasp number `place`: its p-value, the shortfall behind it (of the measure's unit), and why."""

    place: int
    kind: Kind
    p_value: float
    compared: Compared
    shortfall: float
    reason: str
