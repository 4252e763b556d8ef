# SPDX-License-Identifier: Apache-2.0
"""The belt drive's part of the page: its numbers beside the paper's."""

from dataclasses import dataclass
import math

import numpy as np

from checks.paper.belt import Trial, TRUTH
from checks.share import share_interval, table

FAR = 0.1  # relative error of EA that is another place altogether

# What the paper reports: found, EA [N], P [Nm/rad]; None where it gives no number.
REPORTED: dict[tuple[int, float], str] = {
    (8, 0.0): 'found "correctly", no numbers',
    (8, 0.5): 'trapped: EA = 244e3 N, P = 53 Nm/rad',
    (20, 0.0): 'not reported',
    (20, 0.5): 'found: EA = 200056 N (0.028 %), P = 45.0145 Nm/rad (0.032 %)',
}


@dataclass(frozen=True)
class BeltFindings:
    """What section 3 gave.

    Attributes:
        frequencies: Lowest and highest first eigenfrequency over x0, Hz.
        modes: The eigenfrequencies at x0 = 0.2 m, Hz.
        minima: Local minima of the cost along EA.
        largest_torque: Largest magnitude of M1, Nm.
        close_torque: The same from 0.2 to 0.26 s, Nm.
        rates: (survivors, distance) or None for our settings -> trials at the paper's truth, and
            at truths anywhere in the box.
    """

    frequencies: tuple[float, float]
    modes: tuple[float, ...]
    minima: int
    largest_torque: float
    close_torque: float
    rates: dict[tuple[int, float] | None, tuple[list[Trial], list[Trial]]]


def _hits(found: list[Trial]) -> int:
    return sum(t.success for t in found)


def _share(found: list[Trial]) -> str:
    low, high = share_interval(_hits(found), len(found))
    share = 100 * _hits(found) / len(found)
    return f'{share:.0f} % ({100 * low:.0f} to {100 * high:.0f})'


def _table(findings: BeltFindings) -> str:
    found = 'found, truth of the paper', 'found, truth anywhere'
    head = *('survivors', 'd_min,0', 'simulations', *found), 'median error where found, EA and P'
    rows = []
    for key, (middle, anywhere) in findings.rates.items():
        errors = [t.error for t in middle if t.success]
        error = 100.0 * np.median(errors, axis=0) if errors else np.full(2, math.nan)
        rows.append(
            (
                *(('40 (`MANY_MINIMA`)', 0.05) if key is None else key),
                max(t.evaluations for t in middle),
                _share(middle),
                _share(anywhere),
                f'{error[0]:.3f} %, {error[1]:.3f} %',
                '-' if key is None else REPORTED[key],
            )
        )
    return table((*head, 'the paper'), rows)


def _good(findings: BeltFindings) -> str:
    """Return how many seeds come as near as the paper's run with 20 survivors."""
    many = findings.rates[20, 0.5][0]
    good = sum(t.success and t.error[0] <= 2.8e-4 and t.error[1] <= 3.3e-4 for t in many)
    return f'{good} of {len(many)}'


def _far(findings: BeltFindings) -> str:
    """Return how many trapped seeds end at another place altogether, as the paper's does."""
    trapped = [t for t in findings.rates[8, 0.5][0] if not t.success]
    far = sum(abs(t.found[0] / TRUTH[0] - 1) > FAR for t in trapped)
    return f'{far} of {len(trapped)}'


def belt_section(findings: BeltFindings) -> str:
    """Return section 3 as Markdown: its numbers and pictures."""
    low, high = findings.frequencies
    facts = {
        'first eigenfrequency over x0, Hz': (f'{low:.1f} to {high:.1f}', '65 to 85 (axis)'),
        'modes at x0 = 0.2 m, Hz': (', '.join(f'{f:.1f}' for f in findings.modes), ''),
        'largest torque, N m': (f'{findings.largest_torque:.2f}', '0.4 (axis)'),
        'the same from 0.2 to 0.26 s': (f'{findings.close_torque:.3f}', '0.08 (axis)'),
        'local minima along EA': (findings.minima, '"high number"'),
        "20 survivors, as near as the paper's run": (_good(findings), ''),
        '8 survivors, trapped, farther than 10 % from EA': (_far(findings), '1 of 1'),
    }
    seeds = len(findings.rates[20, 0.0][0])
    parts = [
        '## Section 3: the belt drive',
        table(('quantity', 'here', 'the paper'), [(name, *x) for name, x in facts.items()]),
        f'Table 2 over {seeds} seeds, found within 1 % without refinement [95 %]:',
        _table(findings),
        *(f'![Figure {n}](paper/figure_{n}.png)' for n in range(4, 10)),
    ]
    return '\n\n'.join(part.rstrip() for part in parts) + '\n'
