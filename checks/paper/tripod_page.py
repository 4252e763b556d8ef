# SPDX-License-Identifier: Apache-2.0
"""The tripod's part of the page: its numbers beside the paper's."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from checks.paper.tripod_findings import findings_table
from checks.paper.tripod_runs import Case, DriveTrial, LOUD, Plan, QUIET, TRUTH
from checks.share import table

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


def _pooled(trials: list[DriveTrial], name: str, what: Callable[[DriveTrial], Any]) -> Any:
    return np.concatenate([what(t)[t.columns(name)] for t in trials])


def values_table(trials: Mapping[Case, list[DriveTrial]]) -> str:
    """Return Table 5 again: the genetic algorithm's values beside the truth and the paper's."""
    near, far = trials[Case(LOUD, False, 0.0)], trials[Case(LOUD, False, 0.5)]
    head = ('parameter', 'truth', 'GA, d_min,0 = 0', 'GA, d_min,0 = 0.5', 'refined, 95 % interval',
            'the paper, d_min,0 = 0', 'the paper, d_min,0 = 0.5')  # fmt: skip
    first, rows = near[0], []
    for name, truth in TRUTH.items():
        i = first.columns(name)[0]
        numbers = [f'{x:.6g}' for x in (truth, first.ga[i], far[0].ga[i], first.found[i])]
        numbers[-1] += f' ± {0.5 * (first.high[i] - first.low[i]):.2g}'
        rows.append((LABELS[name], *numbers, *(f'{x:.6g}' for x in REPORTED[name])))
    costs = (f'{x:.6f}' for x in (first.ga_cost, far[0].ga_cost, first.cost))
    rows.append(('residual e_min, N m', f'{LOUD:g} (noise)', *costs, '0.129705', '0.133413'))
    return table(head, rows)


def errors_table(trials: Mapping[Case, list[DriveTrial]], noise: float) -> str:
    """Return the errors of the one drive over all seeds at one noise."""
    near, far = trials[Case(noise, False, 0.0)], trials[Case(noise, False, 0.5)]
    head = ('parameter', 'GA, d_min,0 = 0, %', 'GA, d_min,0 = 0.5, %', 'refined, %',
            '95 % interval, ± %', 'holds the truth')  # fmt: skip
    rows = []
    for name in TRUTH:
        ga, *others = _cells(near, name)
        of_far = spread(_pooled(far, name, lambda t: t.ga_error))
        rows.append((LABELS[name].split(',')[0], ga, of_far, *others))
    costs = _costs(near)
    rows.append(('residual, N m', costs[0], _costs(far)[0], costs[1], '', ''))
    return table(head, rows)


def three_table(trials: Mapping[Case, list[DriveTrial]]) -> str:
    """Return the errors where all drives are identified, those of equal parameters together."""
    cases = [trials[Case(noise, True, 0.0)] for noise in (LOUD, QUIET)]
    each = 'GA, {:g} N m, %', 'refined, %', 'interval, ± %', 'holds the truth'
    head = ['parameter', *(x.format(noise) for noise in (LOUD, QUIET) for x in each)]
    rows = [
        [LABELS[name].split(',')[0], *(x for case in cases for x in _cells(case, name))]
        for name in TRUTH
    ]
    rows.append(['residual, N m', *(x for case in cases for x in (*_costs(case), '', ''))])
    return table(head, rows)


def _cells(trials: list[DriveTrial], name: str) -> list[str]:
    """Return errors of the genetic algorithm, refined, the interval, and how often it holds."""
    held = _pooled(trials, name, lambda t: t.covered)
    return [
        spread(_pooled(trials, name, lambda t: t.ga_error)),
        spread(_pooled(trials, name, lambda t: t.error)),
        percent(float(np.median(_pooled(trials, name, lambda t: t.half_width)))),
        f'{int(held.sum())} of {held.size}',
    ]


def _costs(trials: list[DriveTrial]) -> list[str]:
    """Return the median residuals of the genetic algorithm and refined."""
    both = zip(*((t.ga_cost, t.cost) for t in trials), strict=True)
    return [f'{np.median(x):.5f}' for x in both]


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
    return '\n\n'.join(part.rstrip() for part in parts) + '\n'
