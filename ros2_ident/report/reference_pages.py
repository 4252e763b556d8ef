# SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation that are made from tables in the code.

`python -m ros2_ident.report.reference_pages` writes them; a test compares them.
"""

import math
from pathlib import Path

from ros2_ident.models.machine_file import literal
from ros2_ident.models.machine_keys import Key, keys_of, KINDS

_MADE = 'Made by `python -m ros2_ident.report.reference_pages`; a test compares it with the code.'


def machine_file() -> str:
    """Return docs/machine_file.md: every key of a machine file."""
    lines = [
        '# The machine file',
        '',
        _MADE,
        '',
        '`ident new-machine --kind KIND` writes one with all keys; how to fill it in:',
        '[own_machine.md](own_machine.md). SI units throughout. What lies outside the plausible',
        'range is warned of, not refused. A key that is not in the table is refused.',
    ]
    for kind, meaning in KINDS.items():
        lines += [
            '',
            f'## `machine: {kind}`',
            '',
            f'{meaning[0].upper()}{meaning[1:]}.',
            '',
            '| key | unit | meaning | without it | plausible |',
            '| --- | --- | --- | --- | --- |',
        ]
        lines += [_row(key, kind) for key in keys_of(kind).values()]
    return '\n'.join(lines) + '\n'


def _row(key: Key, kind: str) -> str:
    units = [unit for unit in dict.fromkeys((key.unit, key.force_unit)) if unit]
    without = key.absent or ('not searched: zero' if key.section == 'parameters' else 'refused')
    if kind == 'belt_drive' and key.section == 'parameters':
        without = 'the constant above holds'
    span = f'{key.low:g} to {key.high:g}' if math.isfinite(key.high) else ''
    return (
        f'| `{".".join(key.path)}` | {" or ".join(units)} | {key.meaning}; '
        f'as `{literal(key, kind)}` | {without} | {span} |'
    )


def generated(root: Path) -> dict[Path, str]:
    """Return the pages, below the root of the source tree."""
    return {root / 'docs/machine_file.md': machine_file()}


if __name__ == '__main__':
    for path, text in generated(Path(__file__).resolve().parents[2]).items():
        path.write_text(text, encoding='utf-8')
        print(path)
