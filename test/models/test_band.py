# SPDX-License-Identifier: Apache-2.0
"""Efforts of a slow log as they are compared where the recorded motion drives a model."""

import numpy as np

from ros2_ident.models.drives.band import Band


def test_the_instant_at_which_friction_turns_over_counts_by_itself_not_by_samples() -> None:
    logged = np.full((1, 4000), np.nan)
    logged[:, ::20] = 0.0
    band = Band(2.5, 8.75, 2e-3, logged, np.zeros(logged.shape, dtype=bool))
    # A change of sign a cycle before a sample, and a cycle after it.
    early, late = (np.where(np.arange(4000) < at, -1.0, 1.0)[None] for at in (1999, 2001))
    moved = np.abs(band.passed(early) - band.passed(late))
    # Two cycles of twice the friction, in a band whose pulse is 5/s high.
    assert moved.max() < 2.0 * (2.0 * 2.0 * 2e-3 * 5.0)
    assert moved.sum() * 2e-3 < 2.0 * (2.0 * 2.0 * 2e-3)
