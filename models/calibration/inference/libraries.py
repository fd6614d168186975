"""How PyMC and ArviZ are imported: both write into the home folder when they are, and ArviZ announces what comes."""

import os
import shlex
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fast.models.solver_code import cache_folder

_MODELS = Path(__file__).parents[2]


@contextmanager
def quiet_import() -> Iterator[None]:
    """Import PyMC or ArviZ inside, also where the home cannot be written, and whatever a person set for PyTensor."""
    folder = cache_folder(_MODELS)
    compiled = shlex.quote(str(folder / "pytensor"))
    wanted = {
        "XDG_CACHE_HOME": str(folder),
        "PYTENSOR_FLAGS": f"base_compiledir={compiled}",
        "PYTENSORRC": os.devnull,
    }
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
