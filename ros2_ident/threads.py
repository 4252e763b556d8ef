# SPDX-License-Identifier: Apache-2.0
"""How many processors this process may use, and how much memory."""

import os


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
