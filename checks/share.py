# SPDX-License-Identifier: Apache-2.0
"""Shares with their intervals, and tables, for the figures of all checks."""

from collections.abc import Iterable, Sequence
import math

from scipy.stats import binomtest


def share_interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share; NaN where nothing was counted.

    Reference:
        Wilson (1927), Journal of the American Statistical Association 22.
    """
    if count == 0:
        return math.nan, math.nan
    interval = binomtest(hits, count).proportion_ci(0.95, method='wilson')
    return float(interval.low), float(interval.high)


def told_share(hits: Sequence[bool]) -> str:
    """Return how many hold, with the interval of their share in percent."""
    low, high = share_interval(sum(hits), len(hits)) if hits else (0.0, 1.0)
    return f'{sum(hits)} of {len(hits)} [{100.0 * low:.0f}, {100.0 * high:.0f} %]'


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = ['| ' + ' | '.join(head) + ' |', '|' + ' --- |' * len(head)]
    lines += ['| ' + ' | '.join(str(cell) for cell in row) + ' |' for row in rows]
    return '\n'.join(lines) + '\n'
