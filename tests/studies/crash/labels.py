"""Reads from the force of a made-up grasp which tool gripped which object for which time, whatever its label says."""

import numpy as np

from fast.hardware.virtual.world.file import World
from fast.models.records import Trace
from tests.studies.benchmarks.fingerprints import (
    BASE_N,
    LEAST_DIFFERENCE,
    OBJECT_N,
    PLATEAUS_MM,
    SLOT_N,
    Label,
    repeat_factor,
    slot_of,
)

MARGIN_MM = 1.0  # at each end of a plateau: on a busy machine the lift is told late
FEWEST_SAMPLES = 3
TOLERANCE = 0.1  # of the step from one slot or object to the next


class SparseTraceError(ValueError):
    """A whole lift with too few readings in it to say what was gripped."""


def read_fingerprint(trace: Trace) -> tuple[int, int, float]:
    """Slot, object id and factor from grasp to grasp that a measured trace shows.

    Raises:
        SparseTraceError: a busy host took too few readings to tell.
        ValueError: the trace is of no single made-up grasp.
    """
    lift = trace.is_lift
    lift_mm, force_n = trace.lift_mm[lift], trace.force_n[lift]
    at_mm = [(low + MARGIN_MM, high - MARGIN_MM) for low, high in PLATEAUS_MM]
    held_n = [force_n[(lift_mm > low) & (lift_mm < high)] for low, high in at_mm]
    if lift_mm.size and lift_mm[-1] > PLATEAUS_MM[-1][1] and any(plateau.size < FEWEST_SAMPLES for plateau in held_n):
        raise SparseTraceError(f"a plateau has fewer than {FEWEST_SAMPLES} readings: the host was too busy")
    if any(plateau.size < FEWEST_SAMPLES or np.ptp(np.quantile(plateau, (0.1, 0.9))) > 0.1 for plateau in held_n):
        raise ValueError("the trace has not the three plateaus of a made-up grasp")
    base_n, slot_n, object_n = (float(np.median(plateau)) for plateau in held_n)
    factor = base_n / BASE_N
    slot, object_id = slot_n / factor / SLOT_N - 1, object_n / factor / OBJECT_N - 5
    if abs(slot - round(slot)) > TOLERANCE or abs(object_id - round(object_id)) > TOLERANCE:
        raise ValueError(
            f"the plateaus stand for slot {slot:.2f} and object {object_id:.2f}, which are no whole numbers"
        )
    return round(slot), round(object_id), factor


def label_problem(world: World, label: Label, trace: Trace) -> str:
    """What is wrong if this trace is stored under this label; empty if the label is right.

    Raises:
        SparseTraceError: too few readings to tell.
    """
    tool_id, object_id, repeat = label
    try:
        slot, shown_object, factor = read_fingerprint(trace)
    except SparseTraceError:
        raise
    except ValueError as error:
        return f"{label}: {error}"
    if (slot, shown_object) != (slot_of(tool_id), object_id):
        return f"{label} holds a grasp of slot {slot} on object {shown_object}"
    expected = repeat_factor(world, tool_id, object_id, repeat)
    if abs(factor - expected) > LEAST_DIFFERENCE / 2 * expected:
        return f"{label} holds another repeat: its factor is {factor:.4f}, that of the label {expected:.4f}"
    return ""
