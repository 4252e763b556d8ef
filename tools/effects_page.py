# SPDX-License-Identifier: Apache-2.0
"""The page on the catalogue of effects, made from the catalogue.

`python tools/effects_page.py` writes docs/effects.md.
"""

import importlib
from pathlib import Path

from ros2_ident.effects import CATALOGUE, Effect, EffectParameter

# In the order in which torque goes through the machine, and what a group means.
GROUPS = {
    'structure': 'the machine as a whole: masses, geometry, frame',
    'drive': 'one drive: friction, gear, motor',
    'controller': 'between set-point and torque',
    'measurement': 'between torque and log; the machine does not feel it',
}
# What a parameter of a role holds; a size and a shape say so by their numbers.
ROLES = {'order': 'order of the turn', 'position': 'place', 'time': 'instant'}

INTRODUCTION = (
    '# The catalogue of effects',
    '',
    'Made by `python tools/effects_page.py`; a test compares it with the catalogue.',
    '',
    'An effect is one way in which a machine differs from its nominal model',
    '([models.md](models.md)). `ident diagnose` tries each at each place where it can sit,',
    'together with the nominal parameters. How to add one:',
    '[extend.md](extend.md#an-effect).',
    '',
    '- Symbols: v and z are speed and position of the motor, at the rail; s is the position of',
    '  the load side (carriage or joint), M a torque, F a force, t the time in the log. Friction',
    '  opposes the motion.',
    '- Bounds of a drive are shares of what it does in the logs, in any unit: `effort` (N m or N)',
    '  of the largest logged effort (the 99.9th percentile of the recording where it is largest),',
    '  `force` of that effort at the load, `load` (kg) of what that holds, a metre away where',
    '  joints turn, m of the stroke, m/s of the highest speed over 50 ms, W of force times speed.',
    '  A position is counted from the lowest one in strokes. Other bounds of the machine as a',
    '  whole, of masses, times and frequencies are as they stand.',
    '- *Parameters*: bounds and unit. The first are sizes: at 0, or the value in brackets, the',
    '  effect is off. Those behind a semicolon are shapes.',
    '- *Confusable*: one log may not tell these apart. *Separated by*: the motion that does.',
)


def _number(value: float) -> str:
    return f'{value:g}'


def _parameter(parameter: EffectParameter) -> str:
    name = f'`{parameter.name}`'
    symbol = f' {parameter.symbol}' if parameter.symbol else ''
    meaning = parameter.meaning or ROLES.get(parameter.role, '')
    unit = '' if parameter.unit == '1' else f' {parameter.unit}'
    off = parameter.role == 'size' and parameter.neutral
    neutral = f' ({_number(parameter.neutral)})' if off else ''
    bounds = f'[{_number(parameter.low)}, {_number(parameter.high)}]{unit}{neutral}'
    return f'{name}{symbol}{f" ({meaning})" if meaning else ""} {bounds}'


def _parameters(effect: Effect) -> str:
    parts = [
        ', '.join(_parameter(p) for p in effect.parameters if (p.role == 'size') == size)
        for size in (True, False)
    ]
    return '; '.join(part for part in parts if part)


def what_it_is(effect: Effect) -> str:
    """Return an effect in one sentence: its own, or the first line of its module's docstring."""
    if effect.about:
        return effect.about
    module = importlib.import_module(f'ros2_ident.effects.{effect.id}')
    return (module.__doc__ or '').strip().split('\n')[0]


def row(effect: Effect) -> str:
    """Return the line on one effect."""
    several = f'; up to {effect.most} at a place' if effect.most > 1 else ''
    motion = effect.separated_by.format(drive='the drive')
    cells = [
        f'`{effect.id}`',
        f'{what_it_is(effect)} `{effect.equation}` ({effect.source}){several}',
        _parameters(effect),
        ', '.join(effect.confusable) or '-',
        motion,
    ]
    return f'| {" | ".join(cell.replace("|", chr(92) + "|") for cell in cells)} |'


def markdown() -> str:
    """Return docs/effects.md."""
    lines = [*INTRODUCTION, '']
    grouped = {
        group: [e for e in CATALOGUE.values() if e.group == group and e.number == 1]
        for group in GROUPS
    }
    for group, effects in grouped.items():
        lines += [f'## {group.capitalize()}', '', f'{GROUPS[group].capitalize()}.', '']
        lines += ['| effect | what it is | parameters | confusable | separated by |']
        lines += ['| --- | --- | --- | --- | --- |', *map(row, effects), '']
    return '\n'.join(lines).rstrip('\n') + '\n'


def generated(root: Path) -> dict[Path, str]:
    """Return the file made from the catalogue, below the root of the source tree."""
    return {root / 'docs/effects.md': markdown()}


if __name__ == '__main__':
    for path, text in generated(Path(__file__).resolve().parents[1]).items():
        path.write_text(text, encoding='utf-8')
        print(path)
