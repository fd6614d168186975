from pathlib import Path

from models.kernel_cache import use_cache_of

use_cache_of(Path(__file__).parent)
