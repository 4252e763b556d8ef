# SPDX-License-Identifier: Apache-2.0
"""Changes between two sets of logs, in words."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
import math

from ros2_ident.change.result import Apart, Between, Change, Comparison, Size, Suspect, Visible
from ros2_ident.effects import title_at
from ros2_ident.words.figures import capital, figure, percent, quantity

# Changes that would have shown, listed in a sentence; the file has all.
_LISTED = 12
# How sentences on a way in which the sides differ begin, and what they say of it.
_NONE = 'so that it is no change of the machine for certain'
_WAYS = {
    'timing': ('timing differs: after,', f'stamps of two logs may differ by that, {_NONE}'),
    'zero': (
        'the zeros differ: after,',
        f'encoders that are homed anew may differ by that, {_NONE}',
    ),
    'friction': ('friction differs by', f'its form differs by that from log to log, {_NONE}'),
    'scatter': ('what fits best differs by', f'parts of one side differ by as much, {_NONE}'),
    'noise': ('the noise differs: of', 'something shakes one side that no model repeats'),
    'motion': ('the motions differ:', 'what the model lacks may not cancel'),
}


def sentences(c: Comparison) -> Iterator[str]:
    """Yield the answer, how the sides differ otherwise first."""
    yield from differing(c)
    yield from changed(c)
    yield from limits(c)


def differing(c: Comparison) -> Iterator[str]:
    """Yield how the sides differ beside what changed in the machine."""
    for kind, several in groupby(c.apart, key=lambda x: x.kind):
        yield from map(capital, _told_apart(kind, [*several]))


def limits(c: Comparison) -> Iterator[str]:
    """Yield what would have shown, and what these logs cannot tell."""
    yield _smallest(c.smallest, beside=bool(c.changes))
    if sum(c.logs) == 2:
        yield (
            'With one log a side nothing tells how logs of one machine differ by themselves: '
            'viscous friction falls by up to a fifth in an hour of warming up, and no change of '
            'friction below a few per cent is named. Give several logs of each side.'
        )
    if not c.complete:
        yield 'It was cut short: more may have changed.'


def differences(several: Sequence[Between]) -> Iterator[str]:
    """Yield what differs between bags of a fleet, or the smallest difference that would show."""
    for b in several:
        for text in changed(b.found) if b.found.changes else ():
            yield f'{b.machine}, {b.after} after {b.before}: {text}'
    if several and not any(b.found.changes for b in several):
        largest: dict[str, Visible] = {}
        for v in (v for b in several for v in b.found.smallest):
            known = largest.get(key := f'{title_of(v.suspect)} {v.name}')
            largest[key] = v if known is None or v.size > known.size else known
        yield f'No difference shows. {_smallest(tuple(largest.values()), beside=False)}'


def changed(c: Comparison) -> Iterator[str]:
    """Yield what changed, and how much of the difference it explains."""
    if not c.changes:
        yield 'No change shows.'
    elif not c.believed:
        why = (
            'efforts that were not commanded act in them, which no fit tells from a change; '
            'compare logs without'
            if c.pushed
            else 'nothing that was looked for explains most of it; compare logs of one motion'
        )
        yield f'The logs differ, and {why}. What fits best is no change for certain.'
    first, other = ('Changed', 'Also changed') if c.believed else ('Fits best', 'Beside it')
    for number, change in enumerate(c.changes):
        yield f'{other if number else first}: {_change(change)}.'
        if change.ties:
            names = ', '.join(title_of(x) for x in change.ties)
            yield f'These logs do not tell it from: {names}.'
    for x in c.friction:
        yield f'All changes of friction do together along these motions as one of {_other(x)}.'
    if c.changes:
        data = 'logs' if min(c.logs) > 1 else 'parts of the logs'
        share = 'nothing' if math.isnan(c.explained) else percent(c.explained)
        yield f'Explained by it: {share} of the difference, on {data} that were not fitted.'


def title_of(s: Suspect) -> str:
    """Return a suspect's name."""
    if s.kind == 'effect':
        return title_at(s.name, [s.where])
    if s.kind == 'load':
        return f'load on the link of {s.name}'
    return s.name if s.kind == 'parameter' else f'{s.name} of the machine file'


def _change(change: Change) -> str:
    s = change.suspect
    if s.kind in ('effect', 'load'):
        sizes: Sequence[Size] = change.sizes
        if s.kind == 'load':
            # What is not nothing for certain; the file has all, and what the body's inertia is.
            sure = [x for x in sizes if x.low * x.high > 0.0]
            sizes = [x for x in sure if 'inertia' not in x.name] or sure or sizes
        numbers = ', '.join(f'{x.name} {quantity(x.value, x.unit)} {_ends(x)}' for x in sizes)
        return f'{title_of(s)} is there {s.side} only, with {numbers}'
    return _other(replace(change.sizes[0], name=title_of(s)))


def _other(x: Size) -> str:
    if not math.isfinite(x.high - x.low):
        more = 'larger' if x.value > 0.0 else 'smaller'
        return f'{x.name} is {more}, by how much these logs do not tell'
    share = f' ({100.0 * x.value / abs(x.before):+.3g} %)' if x.before and not x.signed else ''
    return f'{x.name} by {quantity(x.value, x.unit)} {_ends(x)}{share}'


def _ends(x: Size) -> str:
    return f'± {figure(0.5 * (x.high - x.low))}'


def _told_apart(kind: str, several: Sequence[Apart]) -> Iterator[str]:
    """Yield how the sides differ in one way, in one sentence but for checks."""
    if kind == 'check':
        for x in several:
            yield f'only in the logs {"after" if math.isnan(x.before) else "before"}: {x.text}'
    else:
        begin, remark = _WAYS[kind]
        yield f'{begin} {", ".join(map(_difference, several))}; {remark}'


def _difference(x: Apart) -> str:
    by = x.after - x.before
    if x.kind == 'timing':
        return f'{x.text} is {1e3 * abs(by):.2g} ms {"later" if by > 0.0 else "earlier"}'
    if x.kind == 'zero':
        return f'{x.text} reads {quantity(abs(by), x.unit)} {"higher" if by > 0.0 else "lower"}'
    if x.kind in ('friction', 'scatter'):
        return f'{x.text} {quantity(by, x.unit)}'
    return f'{x.text} {quantity(x.before, x.unit)} before, {quantity(x.after, x.unit)} after'


def _smallest(visible: tuple[Visible, ...], *, beside: bool) -> str:
    texts = []
    shown = [v for v in visible if v.size < math.inf]
    # What the machine file states comes before effects, which have no share; nan has no order.
    shares = {id(v): v.size / abs(v.value) for v in shown
              if v.value and math.isfinite(v.value) and not v.signed}  # fmt: skip
    for v in sorted(shown, key=lambda v: (math.isnan(v.value), shares.get(id(v), math.inf))):
        share = f' ({figure(100.0 * shares[id(v)])} %)' if id(v) in shares else ''
        texts.append(f'{title_of(v.suspect)} {quantity(v.size, v.unit)}{share}')
    more = f' and {len(texts) - _LISTED} more' if len(texts) > _LISTED else ''
    none = ', '.join(dict.fromkeys(title_of(v.suspect) for v in visible if v not in shown))
    beyond = f' However large, these would not: {none}.' if none else ''
    return (
        f'The smallest {"other change" if beside else "change"} that would have shown: '
        f'{", ".join(texts[:_LISTED])}{more}.{beyond}'
    )
