# SPDX-License-Identifier: Apache-2.0
"""Pages on several runs: result directories side by side, two sets of logs, and a fleet."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import plain
from ros2_ident.change.result import Between, Comparison
from ros2_ident.effects import CATALOGUE, title_at
from ros2_ident.errors import ErrorCode
from ros2_ident.identify.result import half_of_difference, smallest_shown
from ros2_ident.models import EffectAt
from ros2_ident.report.estimate import load
from ros2_ident.report.files import CHANGE, content, FLEET, PAGE
from ros2_ident.report.page import answer, steps
from ros2_ident.report.page.numbers import change, percent, quantity, some
from ros2_ident.report.page.render import write_page
from ros2_ident.report.schema import intact, read
from ros2_ident.words.change import changed, differences, sentences, title_of
from ros2_ident.words.figures import capital
from ros2_ident.words.verdict import named

COMPARISON = 'comparison.html'
# Parameters of a fleet that are shown at once; the others are folded away.
OPEN = 6
# What the colour of the answer says: of a fleet, and of two sets of logs.
STATES: Mapping[answer.Level, str] = {
    'good': 'No difference shows',
    'doubtful': 'To be inspected',
    'bad': 'Not every recording could be judged',
}
CHANGED: Mapping[answer.Level, str] = {
    'good': 'No change shows',
    'doubtful': 'Changed',
    'bad': 'Different, and not explained',
}


@dataclass(frozen=True)
class Mark:
    """A value on a strip, with where it and its interval stand, 0 to 100; None where unknown."""

    label: str
    text: str
    at: float
    low: float | None = None
    width: float | None = None
    note: str = ''


@dataclass(frozen=True)
class Strip:
    """One parameter of several runs on a scale, and whether some differ beyond their intervals."""

    name: str
    ends: tuple[str, str]
    marks: tuple[Mark, ...]
    differs: bool


Parameters = Mapping[str, Mapping[str, Any]]
# Label and parameter of a value that differs.
Told = Collection[tuple[str, str]]


def strips(runs: Sequence[tuple[str, Parameters]], told: Told) -> list[Strip]:
    """Return a strip for each parameter, those that differ first.

    Args:
        runs: Label and parameters of each run; a parameter has value, low, high (None where not
            known) and unit.
    """
    made = [_strip(name, known, told) for name, known in _by_name(runs) if known]
    return sorted(made, key=lambda s: not s.differs)


def _strip(name: str, known: Sequence[tuple[str, Mapping[str, Any]]], told: Told) -> Strip:
    unit = known[0][1]['unit']
    rows = [[v[k] for k in ('value', 'low', 'high')] for _, v in known]
    value, low, high = np.array(rows, dtype=np.float64).T
    reaches = np.maximum(value - low, high - value)
    # An interval as wide as all of the values twice over would hide how they lie; a scale finer
    # than the finest of them would show what no run knows.
    finest = min(reaches[np.isfinite(reaches)], default=0.0)
    reach = max(2.0 * np.ptp(value), 1.01 * finest) or math.inf
    ends = np.concatenate([low, high, value])
    ends = ends[(ends >= value.min() - reach) & (ends <= value.max() + reach)]
    least, most = float(ends.min()), float(ends.max())
    span = (most - least) or abs(most) or 1.0
    at = np.clip(100.0 * (np.stack([value, low, high]) - least) / span, 0.0, 100.0).round(2)
    marks = []
    for k, (label, v) in enumerate(known):
        notes = [change(value[k] / value[0] - 1.0)] if k and value[0] else []
        notes += ['differs'] * ((label, name) in told)
        ended = bool(np.isfinite(reaches[k]))
        low_at, width = (at[1, k], at[2, k] - at[1, k]) if ended else (None, None)
        text = quantity(v['value'], v['unit'], 4)
        marks.append(Mark(label, text, at[0, k], low_at, width, ', '.join(notes)))
    scale = quantity(least, unit, 4), quantity(least + span, unit, 4)
    return Strip(name, scale, tuple(marks), any((label, name) in told for label, _ in known))


def _by_name(
    runs: Sequence[tuple[str, Parameters]],
) -> Iterator[tuple[str, list[tuple[str, Mapping[str, Any]]]]]:
    """Yield each parameter with the runs, by label, that know its value."""
    for name in dict.fromkeys(name for _, values in runs for name in values):
        known = [(label, v[name]) for label, v in runs if name in v]
        yield name, [(label, x) for label, x in known if x.get('value') is not None]


def _pairs(
    runs: Sequence[tuple[str, Parameters]],
) -> list[tuple[str, str, Mapping[str, Any], Mapping[str, Any]]]:
    """Return label, parameter, the first run's value and the run's, where both are known."""
    return [(x[0], name, known[0][1], x[1]) for name, known in _by_name(runs) for x in known[1:]]


def differing(runs: Sequence[tuple[str, Parameters]]) -> Told:
    """Return what differs from the first run beyond the 95 % interval of the difference."""
    return {
        (label, name)
        for label, name, first, v in _pairs(runs)
        if abs(v['value'] - first['value']) > half_of_difference(first, v)
    }


def _would_show(smallest: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the smallest differences that would have shown, the largest share first."""
    texts = []
    for name, x in sorted(smallest.items(), key=lambda x: -(x[1]['share'] or math.inf)):
        share = '' if x['share'] is None else f' ({percent(x["share"])})'
        texts.append(f'{name} {quantity(x["change"], x["unit"], 2)}{share}')
    return f'the smallest that would have: {some(texts)}' if texts else ''


@dataclass(frozen=True)
class _Run:
    """A result directory; with a diagnosis, the parameters beside its effects."""

    label: str
    answer: answer.Answer
    parameters: Parameters
    effects: frozenset[EffectAt] = frozenset()


def write_comparison(directories: Sequence[str | Path], page: str | Path | None = None) -> Path:
    """Write a page that holds several result directories against each other.

    Args:
        page: The file to write; `comparison.html` in the first directory where None.

    Raises:
        IdentError: As `write_report`.
    """
    runs = []
    for folder in map(Path, directories):
        label = str(folder)
        with intact(folder):
            result, diagnosis = load(folder)
            if diagnosis is not None:
                said = answer.of_diagnosis(diagnosis, label)
                values = {name: vars(v) for name, v in diagnosis.found.parameters.items()}
                runs.append(_Run(label, said, plain(values), frozenset(named(diagnosis.found))))
            elif result is not None:
                said = answer.of_identification(result, label)
                values = {p.name: vars(p) for p in result.parameters}
                runs.append(_Run(label, said, plain(values)))
    alike = [(r.label, r.parameters) for r in runs if r.effects == runs[0].effects]
    made, pairs = strips([(r.label, r.parameters) for r in runs], differing(alike)), _pairs(alike)
    shared = len({name for _, name, _, _ in pairs})
    smallest = smallest_shown((name, v, first) for _, name, first, v in pairs)
    differ = [s.name for s in made if s.differs]
    text = f'{len(differ) or "None"} of {shared} parameters differ{"s" * (len(differ) < 2)}'
    text = text if shared else 'The runs share no parameter'
    rest = some(differ) if differ else _would_show(smallest)
    text += f': {rest}.' if rest else '.'
    others = [r.label for r in runs if r.effects != runs[0].effects]
    if others:
        text += f' Not compared, for other effects in the model: {some(others)}; '
        text += '`ident diff` compares their logs.'
    lead = ', '.join(run.label for run in runs)
    context = {'title': 'Comparison', 'lead': lead, 'headline': text, 'runs': runs, 'strips': made}
    return write_page(Path(page or Path(directories[0]) / COMPARISON), 'comparison.html', context)


def write_difference(directory: str | Path, page: str | Path | None = None) -> Path:
    """Write the page on what changed between two sets of logs.

    Args:
        directory: Where `ident diff` wrote.
        page: The file to write; `report.html` in the directory where None.

    Raises:
        IdentError: NO_DATA or BAD_VALUES where `change.json` cannot be read, INVALID_GOAL where
            the page cannot be written.
    """
    data = content(Path(directory) / CHANGE, '`ident diff` wrote')
    found, asked = read(Comparison, data), data['settings']
    headline, *_ = changed(found)
    level: answer.Level = 'good'
    if found.changes:
        level = 'doubtful' if found.believed else 'bad'
    context = {
        'title': 'What changed',
        'lead': f'{some(asked["bags"])}; after: {some(asked["after_bags"])}',
        'level': level,
        'state_of': CHANGED[level],
        'headline': headline,
        'sentences': [text for text in sentences(found) if text != headline],
        'smallest': [
            {**vars(v), 'what': title_of(v.suspect)} for v in found.smallest if v.size < math.inf
        ],
    }
    return write_page(Path(page or Path(directory) / PAGE), 'change.html', context)


def _effects(data: Mapping[str, Any]) -> Iterator[str]:
    for effect, places in data['effects'].items():
        count = 'once' if len(places) == 1 else f'{len(places)} times'
        yield f'{title_at(effect)}: found {count} ({"; ".join(places)})'


def write_fleet(directory: str | Path, page: str | Path | None = None) -> Path:
    """Write the page on a fleet.

    Args:
        directory: Where `ident fleet` wrote.
        page: The file to write; `report.html` in the directory where None.

    Raises:
        IdentError: NO_DATA or BAD_VALUES where `fleet.json` cannot be read, INVALID_GOAL where
            the page cannot be written.
    """
    path = Path(directory) / FLEET
    data = content(path, '`ident fleet` wrote')
    kind = isinstance(data, dict) and (data.get('schema'), data.get('version'))
    if kind != ('ros2_ident.fleet', 2):
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is no fleet of this version; run `ident fleet` again'
        )
    done = [row for row in data['rows'] if row['state'] == 'done']
    several = [read(Between, row) for row in data['comparisons'] if 'found' in row]
    told = {
        (b.after, c.suspect.name) for b in several if b.found.believed for c in b.found.changes
    }
    made = strips([(row['name'], row['parameters']) for row in done], told)
    machines = {row['machine'] for row in data['rows']}
    failed = [
        f'{x["after"]} could not be compared with {x["before"]}: {x["message"]}'
        for x in data['comparisons']
        if x['state'] != 'done'
    ]
    lost, level = len(data['rows']) - len(done), _fleet_level(data, several)
    context = {
        'title': f'Fleet: {Path(directory).resolve().name}',
        'lead': f'{len(data["rows"])} recordings of {len(machines)} machines'
        + (f', {lost} not done' if lost else ''),
        'level': level,
        'state_of': STATES[level],
        'headline': _fleet_headline(data, several),
        'differences': [*differences(several), *failed, *_effects(data)],
        'steps': list(steps.of_fleet(data, several, str(directory))),
        'rows': [{**row, 'found': _found(row)} for row in data['rows']],
        'dated': any(row['date'] for row in data['rows']),
        'open': [s for s in made if s.differs][:OPEN] or made[:OPEN],
        'strips': made,
    }
    return write_page(Path(page or Path(directory) / PAGE), 'fleet.html', context)


def _found(row: Mapping[str, Any]) -> str:
    """Return a row's verdict, with its probability where it names an effect."""
    if row.get('effect') == 'none' and row['code'] == 'OK':
        return 'nothing found missing above the noise'
    sure = f' Probability: {percent(row["probability"])}.' if row.get('probability') else ''
    return f'{row.get("verdict") or row["message"]}{sure * (row.get("effect") in CATALOGUE)}'


def _fleet_level(data: Mapping[str, Any], several: Sequence[Between]) -> answer.Level:
    rows = [*data['rows'], *data['comparisons']]
    if any(row['state'] != 'done' or row['code'] != 'OK' for row in rows):
        return 'bad'
    found = any(row.get('effect', 'none') != 'none' for row in data['rows'])
    return 'doubtful' if found or any(b.found.changes for b in several) else 'good'


def _fleet_headline(data: Mapping[str, Any], several: Sequence[Between]) -> str:
    drifted, other = (
        sorted({b.machine for b in several if b.kind == kind and b.found.changes})
        for kind in ('drift', 'machine')
    )
    found = [row for row in data['rows'] if row.get('effect', 'none') in CATALOGUE]
    parts = [f'{some(drifted)} {"have" if drifted[1:] else "has"} drifted'] if drifted else []
    if other:
        parts.append(f'{some(other)} {"differ" if other[1:] else "differs"} from the others')
    if found:
        kinds = {title_at(row['effect']) for row in found}
        # a single name is told at once, several are listed below
        what = f'the simulation lacks {kinds.pop()}' if len(kinds) == 1 else 'effects are missing'
        parts.append(f'{what} in {some(sorted({row["name"] for row in found}))}')
    if not (drifted or other):
        parts.append('no difference shows' if several else 'nothing to compare')
    text = '; '.join(parts)
    return f'{text if drifted or other else capital(text)}.'
