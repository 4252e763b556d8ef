# SPDX-License-Identifier: Apache-2.0
"""Newton, as its loader makes the machine."""

from functools import partial

from common import answer, exported
from with_newton import Run


def add(builder, folder):
    """Add the URDF, and what its loader keeps."""
    exported(folder, 'newton').add(builder)


answer('newton', partial(Run, add))
