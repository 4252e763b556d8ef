# SPDX-License-Identifier: Apache-2.0
"""How many processors this process may use."""

import os


def processors() -> int:
    """Return the number of processors this process may run on; a container's limit counts."""
    try:
        return max(1, len(os.sched_getaffinity(0)))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1
