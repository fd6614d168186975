"""Folders of a person on this machine, by the XDG specification."""

import os
from pathlib import Path

_NONE = Path(os.devnull)  # not a folder, and nobody can make one in it


def folder_of_person(variable: str, usual: str) -> Path:
    """Return the folder that a variable such as XDG_CACHE_HOME names, else `usual` in the home.

    A user whom the system does not know (a number given to a container) may have no home: then none can be made.
    """
    if named := os.environ.get(variable):
        return Path(named)
    try:
        return Path.home() / usual
    except RuntimeError:
        return _NONE / usual
