"""Linear algebra on one thread: the same numbers on any machine, and cores left to the simulations."""

import sys
from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController

_BRING_BLAS = {"numpy", "scipy.linalg", "torch"}


def one_blas_thread() -> AbstractContextManager[object]:
    """Make a context in which BLAS and LAPACK use one thread.

    A fit factors matrices of a few hundred rows many times; threads cost ten times the CPU there and make the
    last digits depend on the number of cores.
    """
    return _controller(frozenset(_BRING_BLAS & sys.modules.keys())).limit(limits=1, user_api="blas")


@cache
def _controller(brought: frozenset[str]) -> ThreadpoolController:
    """Make the controller of libraries these packages loaded; a look takes 5 ms, longer than many a small problem."""
    return ThreadpoolController()
