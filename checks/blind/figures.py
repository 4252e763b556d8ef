# SPDX-License-Identifier: Apache-2.0
"""Pictures of a table: detection curve, reliability diagram, confusion matrix."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

from matplotlib import pyplot as plt  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.ticker import NullLocator  # noqa: E402
import numpy as np  # noqa: E402

from checks.blind.score import calibration, CRASH, detected, exact, Row, verdict_of  # noqa: E402
from checks.share import share_interval  # noqa: E402
from ros2_ident.files import replacing  # noqa: E402
from ros2_ident.gap.verdict import NONE, UNKNOWN  # noqa: E402

EDGES = (0.2, 0.45, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 12.0)
LEVELS = ((0.7, 0.5), (1.5, 0.9), (3.0, 0.98))


def detection(rows: Sequence[Row], path: Path) -> Path:
    """Draw how many single effects are detected, and named, by their true size."""
    singles = [r for r in rows if r['sort'] == 'single' and r['effects']]
    fig, ax = plt.subplots(figsize=(6.5, 3.8))
    for test, label, shift in (
        (detected, 'something is missing', 1.0),
        (exact, 'right name first', 1.04),
    ):
        parts = [[r for r in singles if a <= r['rho'] < b] for a, b in pairwise(EDGES)]
        parts = [part for part in parts if part]
        middle = [shift * float(np.exp(np.mean([np.log(r['rho']) for r in p]))) for p in parts]
        hits = [(sum(test(r) for r in part), len(part)) for part in parts]
        _shares(ax, middle, hits, fmt='o-', label=label)
    ax.plot(*zip(*LEVELS, strict=True), 'k^', label='level for the first')
    ax.set_xscale('log')
    ticks = (0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
    ax.set_xticks(ticks, [f'{t:g}' for t in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xlim(EDGES[0], EDGES[-1])
    ax.set_xlabel('true size after the nominal fit, in units of the noise')
    ax.set_ylabel('share of the cases')
    ax.set_ylim(-0.03, 1.03)
    ax.grid(alpha=0.3)
    ax.legend(loc='lower right')
    return _save(fig, path)


def reliability(rows: Sequence[Row], path: Path) -> Path:
    """Draw how often verdicts of a stated probability are right."""
    _, error, table = calibration(rows)
    fig, ax = plt.subplots(figsize=(4.6, 4.2))
    ax.plot([0, 1], [0, 1], 'k:', lw=1)
    hits = [(round(share * count), count) for _, share, count in table]
    _shares(ax, [p for p, _, _ in table], hits, fmt='o', color='C0')
    ax.set_xlabel('stated probability')
    ax.set_ylabel('share that is right')
    ax.set_title(f'calibration error {error:.3f}', fontsize=10)
    ax.set_xlim(-0.02, 1.02)
    ax.set_ylim(-0.02, 1.02)
    ax.grid(alpha=0.3)
    return _save(fig, path)


def confusion(rows: Sequence[Row], path: Path) -> Path:
    """Draw truth against verdict for cases with at most one effect."""
    part = [r for r in rows if r['sort'] in ('single', 'none', 'ideal', 'outside')]

    def truth(row: Row) -> str:
        if row['sort'] == 'outside':
            return UNKNOWN
        return str(row['effects'][0]['effect']) if row['effects'] else NONE

    names = sorted({truth(r) for r in part} - {NONE, UNKNOWN})
    extra = sorted({verdict_of(r) for r in part} - {*names, NONE, UNKNOWN, CRASH})
    rowsn = [*names, UNKNOWN, NONE]
    columns = [*names, *extra, UNKNOWN, NONE, CRASH]
    table = np.zeros((len(rowsn), len(columns)))
    for r in part:
        table[rowsn.index(truth(r)), columns.index(verdict_of(r))] += 1
    total = np.maximum(table.sum(axis=1, keepdims=True), 1.0)
    fig, ax = plt.subplots(figsize=(0.27 * len(columns) + 3.0, 0.24 * len(rowsn) + 2.4))
    ax.imshow(table / total, cmap='Blues', vmin=0.0, vmax=1.0, aspect='auto')
    for i, j in zip(*np.nonzero(table), strict=True):
        dark = table[i, j] / total[i, 0] > 0.6
        text = ax.text(j, i, f'{table[i, j]:.0f}', ha='center', va='center', fontsize=7)
        text.set_color('w' if dark else 'k')
    ax.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    ax.set_yticks(range(len(rowsn)), rowsn, fontsize=7)
    ax.set_xlabel('verdict')
    ax.set_ylabel('truth')
    return _save(fig, path)


def _shares(ax: Axes, x: list[float], hits: list[tuple[int, int]], **how: Any) -> None:
    """Draw shares, hits of counts, with their intervals."""
    y = np.array([n / count for n, count in hits])
    ends = np.array([share_interval(n, count) for n, count in hits]).reshape(-1, 2).T
    ax.errorbar(x, y, np.maximum(0.0, [y - ends[0], ends[1] - y]), capsize=3, **how)


def _save(fig: Figure, path: Path) -> Path:
    fig.tight_layout()
    with replacing(path, replace=True) as file:
        fig.savefig(file, format='png', dpi=110)
    plt.close(fig)
    return path
