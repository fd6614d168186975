"""Pure science: designs, objects, the grasp simulator, the Bayesian scientist, traces, calibration, gap discovery.

Takes arrays and frozen records, returns the same. Touches no file, no network, no device.
"""

from pathlib import Path

from fast.models.solver_code import use_cache_of

use_cache_of(Path(__file__).parent)
