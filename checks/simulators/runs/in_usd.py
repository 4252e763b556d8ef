# SPDX-License-Identifier: Apache-2.0
"""USD, as Newton's importer reads it."""

from functools import partial

from common import answer
from with_newton import Run


def add(builder, folder):
    """Add the USD alone."""
    builder.add_usd(str(folder / 'robot.usda'))
    return lambda model, state: 0.0


answer('newton', partial(Run, add))
