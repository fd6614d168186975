"""Linear algebra on one thread: the same numbers on any machine, and cores left to the simulations."""

from threadpoolctl import threadpool_limits


def one_blas_thread() -> threadpool_limits:
    """Context in which BLAS and LAPACK use one thread.

    A fit factors matrices of a few hundred rows many times; threads cost ten times the CPU there and make the
    last digits depend on the number of cores.
    """
    return threadpool_limits(limits=1, user_api="blas")
