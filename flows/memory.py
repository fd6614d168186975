"""Memory of a process that works for days with many threads."""

import contextlib
import ctypes
import gc

N_ARENAS = 2  # glibc has eight for each core, and each keeps what its threads have freed
_M_ARENA_MAX = -8  # of malloc.h


def limit_arenas() -> None:
    """Have the threads of this process share few stores of freed memory; nothing where there is no glibc."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").mallopt(_M_ARENA_MAX, N_ARENAS)


def give_memory_back() -> None:
    """Return what was freed to the system; nothing but the collection of garbage where there is no glibc."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
