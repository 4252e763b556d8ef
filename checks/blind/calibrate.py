# SPDX-License-Identifier: Apache-2.0
"""Proposes the diagnosis's constants from the table of a development run.

Never from the run that is reported: its seed has to be another one. Prints what it proposes; a
person changes `gap.rules.Rules` and `gap.rules.Temperatures`.

Example: python -m checks.blind.calibrate blind_1 blind_2
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
import sys
from typing import Any

import numpy as np
import numpy.typing as npt

from checks.blind.score import named, Row, same
from checks.blind.store import Store
from ros2_ident.gap.rules import Rules, Temperatures

Array = npt.NDArray[np.float64]

FALSE_ALARMS = 0.025
MISFLAGGED = 0.05
UNFLAGGED = 0.15
COVERED = 0.97
MOST = 3.0
# Smaller gaps drown in the imperfections of every log, however small those of a table are.
LEAST = 0.3
TINY = 1e-4


@dataclass(frozen=True)
class Proposal:
    """Constants with what they rest on.

    Attributes:
        rules: The thresholds.
        temperatures: The temperatures.
        lines: What was found, as sentences.
    """

    rules: Rules
    temperatures: Temperatures
    lines: tuple[str, ...]


def log_score(p: Array, good: Array) -> float:
    """Return the mean negative log-likelihood of yes/no outcomes."""
    p = np.clip(p, TINY, 1.0 - TINY)
    return float(-np.mean(np.where(good > 0.5, np.log(p), np.log(1.0 - p))))


def temperature(distance: Array, good: Array, grid: Array) -> float:
    """Return the scale that makes sigmoid(distance / scale) the best probability of `good`."""
    scores = [
        log_score(1.0 / (1.0 + np.exp(-np.clip(distance / t, -60.0, 60.0))), good) for t in grid
    ]
    return float(grid[int(np.argmin(scores))])


def material_size(nulls: Array, start: float) -> float:
    """Return a size that a share of at most `FALSE_ALARMS` of the cases without effect reaches.

    With few cases the largest null counts, and a twentieth above it.
    """
    if not nulls.size:
        return start
    order = np.sort(nulls)
    allowed = int(FALSE_ALARMS * order.size)
    return max(LEAST, float(1.05 * order[order.size - 1 - allowed]))


def closed_share(known: Array, unknown: Array, start: float) -> float:
    """Return the share that tells known effects from unknown ones best."""
    if not known.size or not unknown.size:
        return start
    grid = np.linspace(0.3, 0.98, 137)
    # Each kind of error counts by how much of it is allowed.
    wrong = [np.mean(unknown >= x) / UNFLAGGED + np.mean(known < x) / MISFLAGGED for x in grid]
    return float(grid[int(np.argmin(wrong))])


def _shares(row: Row) -> list[tuple[str, Sequence[str], float]]:
    """Return the candidates of a case with the share each closes, the best first."""
    gap = row['gap']
    floor = gap['noise_floor'] ** 2
    explainable = gap['before'] ** 2 - floor
    out = []
    for entry in row['ranking']:
        share = entry.get('share')
        if share is None and entry.get('gap_after') is not None and explainable > 0.0:
            share = (gap['before'] ** 2 - entry['gap_after'] ** 2) / explainable
        if share is not None and math.isfinite(share):
            out.append((entry['effect'], entry['where'], float(share)))
    return sorted(out, key=lambda x: -x[2])


def power(rows: Sequence[Row], mismatch: float, grid: Array) -> float:
    """Return the exponent of what candidates leave open that gives the truth the best score."""
    cases = []
    for row in rows:
        shares = _shares(row)
        at = [
            i for i, (n, w, _) in enumerate(shares) if any(same(n, w, e) for e in row['effects'])
        ]
        if shares and at:
            left = np.array([max(1.0 - s, 0.0) + mismatch for _, _, s in shares])
            cases.append((np.log(left / left.min()), at))
    if not cases:
        return Temperatures().power

    def total(exponent: float) -> float:
        loss = 0.0
        for far, at in cases:
            weights = np.exp(-exponent * far)
            loss -= math.log(max(TINY, float(weights[at].sum() / weights.sum())))
        return loss

    return float(grid[int(np.argmin([total(float(x)) for x in grid]))])


def rival_share(rows: Sequence[Row], start: float) -> float:
    """Return the smallest width of the confusable set that covers, if the set stays small."""
    cases = []
    for row in rows:
        shares = _shares(row)
        at = [i for i, (n, w, _) in enumerate(shares) if same(n, w, row['effects'][0])]
        if shares and at and shares[0][2] > 0.0:
            # Share missing against the best, of each candidate and of the true one.
            missing = np.array([1.0 - s / shares[0][2] for _, _, s in shares])
            cases.append((missing, float(missing[at[0]])))
    if not cases:
        return start
    best = start
    for width in np.linspace(0.01, 0.4, 79):
        size = np.mean([np.sum(missing <= width) for missing, _ in cases])
        cover = np.mean([own <= width for _, own in cases])
        if size > MOST:
            break
        best = float(width)
        if cover >= COVERED:
            break
    return best


def propose(rows: Sequence[Row]) -> Proposal:
    """Return constants that suit a table."""
    rules, t = Rules(), Temperatures()
    seen = [r for r in rows if 'evidence' in r]
    grid = np.geomspace(0.01, 0.5, 80)

    def of(key: str, test: Callable[[Row], bool]) -> Array:
        return np.array([float(r['evidence'][key]) for r in seen if test(r)])

    nulls = of('size', lambda r: r['sort'] in ('none', 'ideal'))
    material = material_size(nulls, rules.material)
    size = np.array([float(r['evidence']['size']) for r in seen])
    there = np.array([r['rho_all'] >= rules.material for r in seen], dtype=float)
    strong: list[Any] = [r for r in seen if r['evidence']['size'] >= material]
    known = np.array([r['evidence']['closed'] for r in strong if r['sort'] in ('single', 'pair')])
    unknown = np.array([r['evidence']['closed'] for r in strong if r['sort'] == 'outside'])
    closed = closed_share(known, unknown, rules.closed)
    both = np.concatenate([known, unknown])
    inside = np.concatenate([np.ones(len(known)), np.zeros(len(unknown))])
    singles = [r for r in strong if r['sort'] == 'single' and named(r)]
    temperatures = replace(
        t,
        size=temperature(size - material, there, grid) if size.size else t.size,
        closed=temperature(both - closed, inside, grid) if both.size else t.closed,
        power=power([r for r in strong if r['effects']], rules.alike, np.linspace(1, 12, 45)),
    )
    rival = rival_share(singles, rules.rival)
    lines = [
        f'{len(rows)} cases, {len(seen)} diagnosed',
        f'size of cases without effect: {_range(nulls)}',
        f'share closed, known effects: {_range(known)}; outside the catalogue: {_range(unknown)}',
        f'Rules.material {material:.3f} (now {rules.material}), closed {closed:.3f} '
        f'(now {rules.closed}), rival {rival:.3f} (now {rules.rival})',
        f'Temperatures(size={temperatures.size:.3f}, closed={temperatures.closed:.3f}, '
        f'power={temperatures.power:.1f}); now {t}',
    ]
    chosen = replace(rules, material=material, closed=closed, rival=rival)
    return Proposal(chosen, temperatures, tuple(lines))


def _range(values: Array) -> str:
    if not values.size:
        return 'no case'
    q = np.quantile(values, (0.0, 0.05, 0.5, 0.95, 1.0))
    return (
        f'least {q[0]:.2f}, 5 % {q[1]:.2f}, median {q[2]:.2f}, 95 % {q[3]:.2f}, most {q[4]:.2f} '
        f'of {values.size}'
    )


def main(roots: Sequence[str]) -> int:
    """Print what the tables of some runs propose."""
    rows = [row for root in roots for row in Store(root).rows()]
    for line in propose(rows).lines:
        print(line)
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
