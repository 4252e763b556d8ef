# SPDX-License-Identifier: Apache-2.0
"""How many processors this process may use, and how much memory."""

import contextlib
import ctypes
import gc
import os

# What the libraries of linear algebra go by; read when they are loaded.
ONE_THREAD = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')

# What says otherwise, and mallopt's number and value: heaps, and the bytes from which on a block
# comes from the system and goes back to it.
_HEAP = ('MALLOC_ARENA_MAX', -8, 1), ('MALLOC_MMAP_THRESHOLD_', -3, 2**20)


def processors() -> int:
    """Return the number of processors this process may run on; a container's limit counts."""
    try:
        return max(1, len(os.sched_getaffinity(0)))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def free_memory() -> float:
    """Return the bytes of memory that are free, without what the system can give back; or inf."""
    try:
        with open('/proc/meminfo', encoding='ascii') as file:
            lines = dict(line.split(':', 1) for line in file)
        return 1024.0 * int(lines['MemAvailable'].split()[0])
    except (OSError, KeyError, ValueError):  # not on every system
        return float('inf')


def give_back_memory() -> None:
    """Give memory that is of no use any more back to the system.

    Much of what a run leaves refers to itself in a circle, and glibc keeps what threads have freed
    (malloc_trim(3)): a node held gigabytes between its runs.
    """
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):  # other C libraries
        ctypes.CDLL(None).malloc_trim(0)


def one_heap() -> None:
    """Let all threads take memory from one heap, and from 1 MiB on from the system (mallopt(3)).

    glibc gives each thread a heap of its own and lets ever larger blocks stay in it: between its
    runs a node held 400 to 450 MiB, and now 360. To be called before there are threads; what the
    user's environment says goes before.
    """
    for name, number, value in _HEAP:
        if name not in os.environ:
            with contextlib.suppress(AttributeError, OSError):  # other C libraries
                ctypes.CDLL(None).mallopt(number, value)


def one_thread_for_linear_algebra() -> None:
    """Let a program's linear algebra use one thread, unless the user says otherwise.

    More of them give other bits on other machines, and wait for each other where other programs
    run. To be called before NumPy is loaded.
    """
    for name in ONE_THREAD:
        os.environ.setdefault(name, '1')
