"""What a measured or simulated grasp's trace says in numbers: docs/explanation/trace-features.md.

The scalars of one trace are here; the features of many traces at once, compiled, in `models.traces.batch`.
"""

from fast.models.traces.scalars import initial_force_n, peak_force_n, work_j

__all__ = ["initial_force_n", "peak_force_n", "work_j"]
