"""Functions of a user's own, named in a config as `module:function`. This file imports no torch."""

import importlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Design
from fast.models.validation import closest

OWN = "module:function"  # how such a name is written
FOLDER = "FAST_WORKING_FOLDER"  # where a person started `fast`; set for processes that work in another folder
_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


def is_own(name: str) -> bool:
    """Return whether a config's value names a function of the user's own."""
    return _NAME.fullmatch(name) is not None


def load_own(name: str) -> Callable[..., Any]:
    """Load the function `module:function`; its module is installed, or lies in the folder that `fast` started in.

    Raises:
        UsageError: there is no such module or function, or the module cannot be imported.
    """
    module_name, _, function_name = name.partition(":")
    module = _import(module_name)
    if not hasattr(module, function_name):
        functions = [word for word, value in vars(module).items() if callable(value) and not word.startswith("_")]
        raise UsageError(f"`{module_name}` has no function `{function_name}`; {closest(function_name, functions)}")
    function = getattr(module, function_name)
    if not callable(function):
        raise UsageError(f"`{name}` is a {type(function).__name__}, not a function; name a function.")
    return function


def call_own(name: str, *arguments: object) -> Any:
    """Return what the user's function gives for these arguments.

    Raises:
        UsageError: it cannot be found, or fails.
    """
    function = load_own(name)
    try:
        return function(*arguments)
    except Exception as error:
        raise UsageError(f"`{name}` failed ({_words(error)}); correct it and start again.") from error


def load_constraint(name: str) -> Callable[[Design], bool]:
    """Load the user's function `module:function` of a design, which says whether the design may be made.

    Raises:
        UsageError: it cannot be found; when called: it fails, or its answer is neither True nor False.
    """
    load_own(name)

    def is_allowed(design: Design) -> bool:
        answer = call_own(name, design)
        if not isinstance(answer, bool | np.bool_):
            raise UsageError(f"`{name}` answered {answer!r} for a design; it must give True or False.")
        return bool(answer)

    return is_allowed


def look_here() -> str | None:
    """Find modules of the folder that `fast` was started in, after installed ones; objects of theirs can be received.

    Returns the folder; None where it was looked in before.
    """
    here = os.environ.get(FOLDER) or str(Path.cwd())
    if here in sys.path:
        return None
    sys.path.append(here)
    return here


def _import(name: str) -> ModuleType:
    new_folder = look_here()
    try:
        return importlib.import_module(name)
    except Exception as error:
        if (
            isinstance(error, ModuleNotFoundError)
            and error.name is not None
            and f"{name}.".startswith(f"{error.name}.")
        ):
            raise UsageError(
                f"There is no module `{name}`; put its file in the folder that you start `fast` in, or install it."
            ) from error
        raise UsageError(f"The module `{name}` cannot be imported ({_words(error)}); correct it.") from error
    finally:
        if new_folder is not None:
            sys.path.remove(new_folder)


def _words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
