"""The grasp that a bench makes now, for those who look on from another thread: it costs the bench nothing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from fast.models.records import Trace

NOTHING = Trace(np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, eq=False)
class GraspInView:
    """A grasp while it is made, or the last one after its end.

    `read`: its samples from number n on, tared, as far as they go now; time from the start of closing. `purpose`: of a
    grasp that is no ordinary one, in a word.
    """

    tool_id: str
    object_id: int
    repeat: int
    started_at: datetime
    read: Callable[[int], Trace]
    purpose: str = ""


def read_samples(
    time_s: Sequence[float], lift_mm: Sequence[float], force_n: Sequence[float], first: int, start_s: float = 0.0
) -> Trace:
    """Samples from number `first` on, of channels that another thread appends to, `force_n` last."""
    part = slice(first, len(force_n))
    return Trace(np.array(time_s[part]) - start_s, np.array(lift_mm[part]), np.array(force_n[part]))
