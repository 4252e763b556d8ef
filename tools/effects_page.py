# SPDX-License-Identifier: Apache-2.0
"""The page on the catalogue of effects, made from the catalogue.

`python tools/effects_page.py` writes docs/effects.md.
"""

from collections.abc import Iterable
import importlib
from pathlib import Path

from ros2_ident.effects import CATALOGUE, Effect, EffectParameter, Hook

# In the order in which torque goes through the machine, and what a group means.
GROUPS = {
    'structure': 'the machine as a whole: masses, geometry, frame',
    'drive': 'one drive: friction, gear, motor',
    'controller': 'between set-point and torque',
    'measurement': 'between torque and log; the machine does not feel it',
}
ROLES = {
    'size': 'size',
    'shape': 'shape',
    'order': 'shape, an order of the turn',
    'position': 'shape, a place',
    'time': 'shape, an instant',
}

INTRODUCTION = (
    '# The catalogue of effects',
    '',
    'Made by `python tools/effects_page.py`; a test compares it with the catalogue.',
    '',
    'An effect is one way in which a machine differs from its nominal model',
    '([models.md](models.md)). `ident diagnose` tries each at each place where it can sit,',
    'together with the nominal parameters.',
    'How to add one: [adding_an_effect.md](adding_an_effect.md).',
    '',
    'How to read an entry:',
    '',
    "- Symbols: v is the motor's speed and z its position, both at the rail; s the position of",
    '  the load side, a carriage or a joint; M a torque; t the time since the log began.',
    '  Friction opposes the motion.',
    '- A unit with `effort` is N m, or N on a machine that logs a force. Its numbers are shares',
    "  of the size of the drive's logged effort, which one sample in a thousand exceeds in the",
    '  liveliest recording: 0.25 means a quarter of it. Numbers in 1/W are shares of the inverse',
    '  of its power at 1 m/s. A limit in the machine file does not matter.',
    '- Of a joint that turns, a metre means 20 rad (a lever of 0.05 m), in every unit: bounds of',
    '  0.005 to 0.2 m/s are 0.1 to 4 rad/s, and 1/m becomes 1/20 rad.',
    '- At its neutral value a parameter of the role *size* switches the effect off. A *shape*',
    '  means nothing while the size is neutral.',
    '- *Place*: each drive can have its own, or the machine has one.',
    '- Effects of one *family* look alike on ordinary motions.',
    '- *Confusable*: one log may not tell these apart. *Separated by* is the motion that does.',
)


def _number(value: float) -> str:
    return f'{value:g}'


def _row(parameter: EffectParameter, hook: Hook) -> str:
    starts = ', '.join(map(_number, parameter.starts)) or '-'
    cells = [
        f'`{parameter.name}`',
        parameter.meaning or '-',
        parameter.unit,
        parameter.symbol or '-',
        f'{_number(parameter.low)} to {_number(parameter.high)}',
        _number(parameter.neutral),
        ROLES[parameter.role],
        starts,
    ]
    if hook is Hook.PARAMETER:
        verb = {'add': 'added to', 'scale': 'multiplied with', 'set': 'replaces'}[parameter.how]
        cells.append(f'{verb} `{parameter.target}`')
    return '| ' + ' | '.join(cells) + ' |'


def _table(effect: Effect) -> list[str]:
    head = ['parameter', 'meaning', 'unit', 'symbol', 'bounds', 'neutral', 'role', 'starts']
    if effect.hook is Hook.PARAMETER:
        head.append('acts on')
    return [
        '| ' + ' | '.join(head) + ' |',
        '| ' + ' | '.join(['---'] * len(head)) + ' |',
        *(_row(parameter, effect.hook) for parameter in effect.parameters),
    ]


def _links(names: Iterable[str]) -> str:
    return ', '.join(f'[{name}](#{name})' for name in names) or '-'


def what_it_is(effect: Effect) -> str:
    """Return an effect in one sentence: the first line of its module's docstring."""
    module = importlib.import_module(f'ros2_ident.effects.{effect.id}')
    return (module.__doc__ or '').strip().split('\n')[0]


def section(effect: Effect) -> list[str]:
    """Return the lines on one effect."""
    place = 'each drive' if effect.place == 'drive' else 'the machine'
    acts_on = 'numbers the model has anyway' if effect.kernel is None else effect.hook.value
    motion = effect.separated_by.format(drive='the drive')
    return [
        f'### {effect.id}',
        '',
        what_it_is(effect),
        '',
        f'- equation: `{effect.equation}`',
        f'- acts on: {acts_on}',
        f'- place: {place}; family: {effect.family}',
        f'- confusable with: {_links(effect.confusable)}',
        f'- separated by: {motion}',
        f'- source: {effect.source}',
        '',
        *_table(effect),
        '',
    ]


def markdown() -> str:
    """Return docs/effects.md."""
    lines = [*INTRODUCTION, '']
    grouped = {
        group: [effect for effect in CATALOGUE.values() if effect.group == group]
        for group in GROUPS
    }
    lines += ['| group | what it sits on | effects |', '| --- | --- | --- |']
    for group, effects in grouped.items():
        lines.append(f'| {group} | {GROUPS[group]} | {_links(e.id for e in effects)} |')
    lines += ['', f'{len(CATALOGUE)} effects.', '']
    for group, effects in grouped.items():
        lines += [f'## {group.capitalize()}', '']
        for effect in effects:
            lines += section(effect)
    return '\n'.join(lines).rstrip('\n') + '\n'


def generated(root: Path) -> dict[Path, str]:
    """Return the file made from the catalogue, below the root of the source tree."""
    return {root / 'docs/effects.md': markdown()}


if __name__ == '__main__':
    for path, text in generated(Path(__file__).resolve().parents[1]).items():
        path.write_text(text, encoding='utf-8')
        print(path)
