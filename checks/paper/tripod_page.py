# SPDX-License-Identifier: Apache-2.0
"""The tripod's part of the page: its numbers beside the paper's."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from checks.paper.tripod_findings import findings_table
from checks.paper.tripod_runs import (
    Case,
    DriveTrial,
    LOUD,
    Plan,
    QUIET,
    TRUTH,
)

Array = NDArray[np.float64]

# Table 5: found with d_min,0 = 0 and with 0.5.
REPORTED: Mapping[str, tuple[float, float]] = {
    'measurement_delay': (0.024903, 0.025876),
    'gear_stiffness': (232139.0, 265586.0),
    'gear_damping_ratio': (0.396306, 0.423061),
    'tool_mass': (1.762440, 1.68633),
    'drive_inertia': (89.0817e-6, 89.3439e-6),
}
LABELS: Mapping[str, str] = {
    'measurement_delay': 'measurement delay ΔT, s',
    'gear_stiffness': 'gear stiffness c_G, N/m',
    'gear_damping_ratio': 'rel. gear damping ζ_G, 1',
    'tool_mass': 'tool mass m_t, kg',
    'drive_inertia': 'drive inertia J_D, kg m²',
}


@dataclass(frozen=True)
class TripodFindings:
    """What section 4 gave.

    Attributes:
        plan: What was run.
        spans: (D, 2) lowest and highest torque of each drive without noise, N m.
        speeds: (D,) largest speed of each drive, m/s.
        trials: Trials of each case, the same seeds in the same order.
        influence: Parameter -> what its shift by a tenth of the box costs, N m.
    """

    plan: Plan
    spans: Array
    speeds: Array
    trials: Mapping[Case, list[DriveTrial]]
    influence: Mapping[str, float]


def percent(value: float) -> str:
    """Return a share in % with two significant digits, without needless ones."""
    value *= 100.0
    if not math.isfinite(value):
        return '-'
    # Limits at which rounding adds a digit.
    digits = sum(abs(value) < limit for limit in (9.95, 0.995, 0.0995))
    return f'{value:.{digits}f}'


def spread(errors: Array) -> str:
    """Return signed relative errors as median and range, in %."""
    low, high = float(np.min(errors)), float(np.max(errors))
    return f'{percent(float(np.median(errors)))} ({percent(low)} to {percent(high)})'


def _pooled(trials: list[DriveTrial], name: str, what: Callable[[DriveTrial], Array]) -> Array:
    return np.concatenate([what(t)[t.columns(name)] for t in trials])


def _number(value: float) -> str:
    return f'{value:.6g}'


def values_table(trials: Mapping[Case, list[DriveTrial]]) -> str:
    """Return Table 5 again: the genetic algorithm's values beside the truth and the paper's."""
    near, far = trials[Case(LOUD, False, 0.0)], trials[Case(LOUD, False, 0.5)]
    rows = [
        '| parameter | truth | GA, d_min,0 = 0 | GA, d_min,0 = 0.5 | refined, 95 % interval '
        '| the paper, d_min,0 = 0 | the paper, d_min,0 = 0.5 |',
        '| --- | --- | --- | --- | --- | --- | --- |',
    ]
    for name, truth in TRUTH.items():
        i = near[0].columns(name)[0]
        first = near[0]
        half = 0.5 * (first.high[i] - first.low[i])
        rows.append(
            f'| {LABELS[name]} | {_number(truth)} '
            f'| {_number(first.ga[i])} | {_number(far[0].ga[i])} '
            f'| {_number(first.found[i])} ± {half:.2g} '
            f'| {_number(REPORTED[name][0])} | {_number(REPORTED[name][1])} |'
        )
    rows.append(
        f'| residual e_min, N m | {LOUD:g} (noise) | {near[0].ga_cost:.6f} | {far[0].ga_cost:.6f} '
        f'| {near[0].cost:.6f} | 0.129705 | 0.133413 |'
    )
    return '\n'.join(rows)


def errors_table(trials: Mapping[Case, list[DriveTrial]], noise: float) -> str:
    """Return the errors of the one drive over all seeds at one noise."""
    near, far = trials[Case(noise, False, 0.0)], trials[Case(noise, False, 0.5)]
    rows = [
        '| parameter | GA, d_min,0 = 0, % | GA, d_min,0 = 0.5, % | refined, % '
        '| 95 % interval, ± % | holds the truth |',
        '| --- | --- | --- | --- | --- | --- |',
    ]
    for name in TRUTH:
        half = float(np.median(_pooled(near, name, lambda t: t.half_width)))
        rows.append(
            f'| {LABELS[name].split(",")[0]} '
            f'| {spread(_pooled(near, name, lambda t: t.ga_error))} '
            f'| {spread(_pooled(far, name, lambda t: t.ga_error))} '
            f'| {spread(_pooled(near, name, lambda t: t.error))} '
            f'| {percent(half)} | {_covered(near, name)} |'
        )
    rows.append(
        f'| residual, N m | {_median_cost(near, ga=True)} | {_median_cost(far, ga=True)} '
        f'| {_median_cost(near, ga=False)} | | |'
    )
    return '\n'.join(rows)


def three_table(trials: Mapping[Case, list[DriveTrial]]) -> str:
    """Return the errors where all drives are identified, those of equal parameters together."""
    loud, quiet = trials[Case(LOUD, True, 0.0)], trials[Case(QUIET, True, 0.0)]
    head = ''.join(
        f'| GA, {noise:g} N m, % | refined, % | interval, ± % | holds the truth '
        for noise in (LOUD, QUIET)
    )
    rows = [f'| parameter {head}|', '| --- ' * 9 + '|']
    for name in TRUTH:
        cells = ''
        for case in (loud, quiet):
            half = float(np.median(_pooled(case, name, lambda t: t.half_width)))
            cells += (
                f'| {spread(_pooled(case, name, lambda t: t.ga_error))} '
                f'| {spread(_pooled(case, name, lambda t: t.error))} '
                f'| {percent(half)} | {_covered(case, name)} '
            )
        rows.append(f'| {LABELS[name].split(",")[0]} {cells}|')
    costs = ''.join(
        f'| {_median_cost(case, ga=True)} | {_median_cost(case, ga=False)} | | '
        for case in (loud, quiet)
    )
    rows.append(f'| residual, N m {costs}|')
    return '\n'.join(rows)


def _covered(trials: list[DriveTrial], name: str) -> str:
    held = np.concatenate([t.covered[t.columns(name)] for t in trials])
    return f'{int(held.sum())} of {held.size}'


def _median_cost(trials: list[DriveTrial], *, ga: bool) -> str:
    return f'{np.median([t.ga_cost if ga else t.cost for t in trials]):.5f}'


def tripod_text(findings: TripodFindings) -> str:
    """Return section 4 as Markdown: its numbers and pictures."""
    trials = findings.trials
    spans = ', '.join(f'{a:.1f} to {b:.1f}' for a, b in findings.spans)
    parts = [
        '## Section 4: the tripod',
        (
            f'{findings.plan.seconds:g} s of pick-and-place, up to {findings.speeds.max():.2f} '
            f'm/s, torques of {spans} N m.'
        ),
        findings_table(trials, findings.influence),
        'Table 5, one drive, noise 0.13 N m, seed 0:',
        values_table(trials),
    ]
    for noise in (LOUD, QUIET):
        parts += [
            f'Errors over all seeds, median (smallest to largest), noise {noise:g} N m:',
            errors_table(trials, noise),
        ]
    parts += ['All three drives at once:', three_table(trials)]
    parts += [f'![Figure {n}](paper/figure_{n}.png)' for n in (11, 12, 13)]
    return '\n\n'.join(parts) + '\n'
