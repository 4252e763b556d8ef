# SPDX-License-Identifier: Apache-2.0
"""Newton, as its loader makes the machine."""

from functools import partial

from common import answer, exported
from with_newton import Run


def add(builder, folder):
    """Add the URDF, and what its loader keeps."""
    loaded = exported(folder, 'newton')
    loaded.add(builder)
    return loaded.effort


answer('newton', partial(Run, add))
