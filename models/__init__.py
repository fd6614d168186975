"""Pure science: design space, geometry, objects, mesh, FEM, effects, surrogate, acquisition.

Takes arrays and frozen records, returns the same. Touches no file, no network, no device.
"""

from pathlib import Path

from models.kernel_cache import use_cache_of

use_cache_of(Path(__file__).parent)
