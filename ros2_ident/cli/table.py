# SPDX-License-Identifier: Apache-2.0
"""Results as text."""

from collections.abc import Sequence
import math
import sys

from ros2_ident.cli.progress import coloured
from ros2_ident.identify.result import Identification, Outcome, ParameterEstimate
from ros2_ident.prediction import Prediction
from ros2_ident.words.figures import compared, duration, figure, interval
from ros2_ident.words.identification import message

# A half width beyond this share of the value, in percent, is told by itself.
TELLING = 1000.0
# An interval so many times as wide as that for noise alone stands beside it.
WIDER = 1.1


def alarming(text: str) -> str:
    """Return a text in red where standard output is a terminal that shows it and is to."""
    return f'\033[1;31m{text}\033[0m' if coloured(sys.stdout) else text


def columns(rows: Sequence[Sequence[str]], sides: str) -> None:
    """Print rows in aligned columns.

    Args:
        rows: Cells, the same number in each row.
        sides: For each column `<` to set it to the left, or `>`.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (f'{x:{s}{w}}' for x, s, w in zip(row, sides, widths, strict=True))
        print('  '.join(cells).rstrip())


def _row(estimate: ParameterEstimate) -> tuple[str, ...]:
    half = 0.5 * (estimate.high - estimate.low)
    noise = 0.5 * (estimate.noise_high - estimate.noise_low)
    value = estimate.value
    share = 100.0 * half / abs(value) if value else math.inf
    alone = interval(value, estimate.noise_low, estimate.noise_high)
    return (
        estimate.name,
        f'{value:.5g}' if math.isfinite(value) else '-',
        interval(value, estimate.low, estimate.high),
        f'{figure(share)} %' if share < TELLING else '',
        alone if half > WIDER * noise else '',
        estimate.unit if estimate.unit != '1' else '',
        estimate.note,
    )


def free_run(found: Prediction | None) -> str:
    """Return a line on free runs; empty where none was made."""
    if found is None:
        return ''
    if found.hindered:
        return f'no free run: {found.hindered}\n'
    errors = [(row[0], ' → '.join(f'{e.rmse:.3g}' for e in row)) for row in found.first]
    drives = ', '.join(f'{first.drive} {told} {first.unit}' for first, told in errors)
    stages = ' → '.join(s.label for s in found.stages)
    return f'free run of the {found.on}, {found.quantity} RMSE, {stages}: {drives}\n'


def print_result(result: Identification) -> None:
    """Print a result on standard output."""
    head = ('parameter', 'value', '95 %', '', 'noise alone', 'unit', '')
    rows = [head, *map(_row, result.parameters)]
    if not any(row[4] for row in rows[1:]):
        rows = [(*row[:4], '', *row[5:]) for row in rows]
    columns(rows, '<>>>><<')
    cost = result.cost
    refined = '' if math.isnan(cost.refined) else f', refined {cost.refined:.5g} {cost.unit}'
    by = 'genetic algorithm' if result.generations else 'least squares'
    print(f'cost: {by} {cost.ga:.5g} {cost.unit}{refined}')
    held_out = {left.drive: left for left in result.validation}
    for left in result.residuals:
        unit = left.unit or cost.unit
        unseen = f'; held out {held_out[left.drive].rms:.5g} {unit}' if held_out else ''
        # a part of the log may be left out, or of its band
        whole = f', {left.rms / left.share:.3g} {unit} RMS' if left.share > 0.0 else ''
        print(
            f'{left.drive}: residual {left.rms:.5g} {unit} RMS, {100.0 * left.share:.3g} % of the '
            f'{compared(unit)} compared{whole}{unseen}'
        )
    if held_out:
        print(f'held out: {result.validated_on}')
    print(free_run(result.prediction), end='')
    print(f'{result.evaluations} candidates in {duration(result.seconds)}, seed {result.seed}')
    for warning in result.quality.warnings:
        print(f'warning: {warning}')
    code = result.outcome.error_code
    said = f'{result.outcome.value}: {message(result)}' + (f' [{code.name}]' if code else '')
    print(alarming(said) if result.outcome is Outcome.CONTRADICTED else said)
