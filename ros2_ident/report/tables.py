# SPDX-License-Identifier: Apache-2.0
"""Results as tables (CSV) for spreadsheets and plotting programs."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.files import make_directory, require_ours, write_table
from ros2_ident.report.files import DIAGNOSIS_SIGNALS, load, SIGNALS
from ros2_ident.report.schema import to_mapping
from ros2_ident.report.signals import load_signals, Signals

# Of a parameter, in this order, where it is known.
_FIELDS = ('value', 'low', 'high', 'unit', 'at_bound', 'state', 'note')


def write_tables(results: str | Path, directory: str | Path) -> tuple[Path, ...]:
    """Write parameters and signals of a result directory as tables.

    Args:
        results: What `ident identify` or `ident diagnose` wrote; one table each where both did.
        directory: Is made where it does not exist.

    Returns:
        The files: `parameters.csv` and `signals.csv`, those of a diagnosis with `diagnosis_`
        before their names.

    Raises:
        IdentError: NO_DATA where there is neither, BAD_VALUES where a file cannot be read.
    """
    source, folder = Path(results), make_directory(directory)
    names = 'parameters.csv', 'signals.csv'
    require_ours(folder / f'{before}{name}' for before in ('', 'diagnosis_') for name in names)
    result, diagnosis = load(source)
    files: list[Path] = []
    if result is not None:
        found = to_mapping(result)['parameters']
        files += _write(folder, '', found, source / SIGNALS)
    if diagnosis is not None:
        found = diagnosis.parameters
        files += _write(folder, 'diagnosis_', found, source / DIAGNOSIS_SIGNALS)
    return tuple(files)


def _write(
    folder: Path, before: str, found: dict[str, dict[str, Any]], signals: Path
) -> Iterator[Path]:
    fields = [f for f in _FIELDS if any(f in entry for entry in found.values())]
    rows = [[name, *(entry.get(f) for f in fields)] for name, entry in found.items()]
    yield write_table(folder / f'{before}parameters.csv', ['parameter', *fields], rows)
    if signals.exists():
        head, *curves = _signal_rows(load_signals(signals))
        yield write_table(folder / f'{before}signals.csv', head, curves)


def _signal_rows(signals: Signals) -> Iterator[Sequence[object]]:
    """Yield the names, then a row for each instant of each recording."""
    models = [f'simulated, {name}' for name in signals.models]
    yield [
        'recording',
        'time [s]',
        *(
            f'{drive} {what} [{unit}]'
            for drive in signals.drives
            for what, unit in [
                *((name, signals.unit) for name in ('measured', *models)),
                ('following error', signals.travel),
            ]
        ),
    ]
    for number, curves in enumerate(signals.recordings, 1):
        # (D, M + 2, T): what stands side by side for each drive
        blocks = np.concatenate(
            [
                curves.measured[:, None],
                curves.simulated.swapaxes(0, 1),
                curves.tracking[:, None],
            ],
            axis=1,
        )
        title = f'{number}: {curves.title}' if curves.title else str(number)
        values = blocks.reshape(-1, curves.time.size).T
        for time, row in zip(curves.time.tolist(), values.tolist(), strict=True):
            yield [title, f'{time:.9g}', *('' if x != x else f'{x:.9g}' for x in row)]
