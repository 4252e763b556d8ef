# SPDX-License-Identifier: Apache-2.0
"""The numbers that say which findings of the paper's section 4 come again."""

from collections.abc import Mapping
import math

import numpy as np

from checks.paper.tripod_runs import Case, DriveTrial, LOUD, QUIET
from checks.share import table

Trials = Mapping[Case, list[DriveTrial]]

# The paper's two distances apart, N m.
PAPER_GAIN = 0.133413 - 0.129705
# Against the scale (1.7 kg) and the rigid-gear least squares (95.4e-6 kg m²), d_min,0 = 0.
PAPER_MASS = abs(1.762440 / 1.7 - 1.0)
PAPER_INERTIA = abs(89.0817 / 95.4 - 1.0)


def sign_test(better: int, worse: int) -> float:
    """Return how likely so uneven a split is by chance (two-sided)."""
    count = better + worse
    if count == 0:
        return 1.0
    tail = sum(math.comb(count, k) for k in range(min(better, worse) + 1)) / 2.0**count
    return min(1.0, 2.0 * tail)


def findings_table(trials: Trials, influence: Mapping[str, float]) -> str:
    """Return the findings as a table, one a row."""
    rows = [(f'a tenth of its box, N m: {k}', f'{x:.2g}', '') for k, x in influence.items()]
    rows += [_distance(trials, noise) for noise in (LOUD, QUIET)]
    rows.append(_one_minimum(trials))
    near = trials[Case(LOUD, False, 0.0)]
    rows += [
        _worst(near, 'tool_mass', f'{100 * PAPER_MASS:.1f}'),
        _worst(near, 'drive_inertia', f'{100 * PAPER_INERTIA:.1f}'),
    ]
    held = np.concatenate([t.covered for c, ts in trials.items() if c.distance == 0 for t in ts])
    share = 100 * float(held.mean())
    within = f'{held.sum()} of {held.size} ({share:.1f} %)'
    rows.append(('95 % intervals hold the truth', within, ''))
    return table(('finding', 'here', 'the paper'), rows)


def _distance(trials: Trials, noise: float) -> tuple[str, str, str]:
    """Return whether d_min,0 = 0 leaves less than 0.5 does."""
    near, far = trials[Case(noise, False, 0.0)], trials[Case(noise, False, 0.5)]
    gain = np.array([b.ga_cost - a.ga_cost for a, b in zip(near, far, strict=True)])
    better, worse = int((gain > 0.0).sum()), int((gain < 0.0).sum())
    return (
        f'd_min,0 = 0 better than 0.5, noise {noise:g} N m',
        f'{better} of {len(gain)}, worse {worse}, p = {sign_test(better, worse):.2g}, '
        f'median {1e3 * float(np.median(gain)):.2g} mN m',
        f'1 of 1, {1e3 * PAPER_GAIN:.1f} mN m',
    )


def _one_minimum(trials: Trials) -> tuple[str, str, str]:
    """Return how often both distances end within a tenth of the interval of each other."""
    apart: list[float] = []
    for noise in (LOUD, QUIET):
        for a, b in zip(
            trials[Case(noise, False, 0.0)], trials[Case(noise, False, 0.5)], strict=True
        ):
            half = np.maximum(0.5 * (a.high - a.low), 1e-12)
            apart.append(float((np.abs(a.found - b.found) / half).max()))
    same = sum(x < 0.1 for x in apart)
    return 'both distances end at one point, refined', f'{same} of {len(apart)}', ''


def _worst(trials: list[DriveTrial], name: str, paper: str) -> tuple[str, str, str]:
    """Return the median and largest error of the genetic algorithm."""
    errors = np.abs(np.concatenate([t.ga_error[t.columns(name)] for t in trials]))
    return (
        f'error of the genetic algorithm, {name}, %',
        f'{100 * float(np.median(errors)):.2g}, at worst {100 * errors.max():.1f}',
        paper,
    )
