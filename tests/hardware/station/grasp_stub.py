"""Physics in closed form, for tests and benchmarks of the bench rather than of grasps."""

import numpy as np

from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSimulation, Trace


def holds_to_the_top(request):
    """A hump of 8 N that ends when the tips pass the object's top."""
    setup = request.setup
    end_mm = setup.tip_below_mm + get_object(request.object_id).height_mm
    closing_s = (setup.open_gap_mm - setup.closed_gap_mm) / 2 / setup.close_speed_mm_per_s
    closing, lift_mm = np.linspace(0, 1, 30), np.linspace(0, setup.max_lift_mm, 321)[1:]
    trace = Trace(
        np.concatenate([closing * closing_s, closing_s + lift_mm / setup.lift_speed_mm_per_s]),
        np.concatenate([np.zeros(30), lift_mm]),
        np.concatenate([-(closing**3), np.where(lift_mm < end_mm, 8 * np.sin(np.pi * lift_mm / end_mm), 0.0)]),
    )
    return GraspSimulation(trace, 8.0, 5.0, 0.2, 1, 1, 1, 0.0)
