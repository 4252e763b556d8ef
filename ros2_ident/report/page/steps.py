# SPDX-License-Identifier: Apache-2.0
"""Next steps: the equation with its numbers, lines to paste, a motion, the next command."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
import shlex
from typing import Any

from ros2_ident.change.result import Between
from ros2_ident.effects import CATALOGUE, Effect
from ros2_ident.gap.result import Cause, Diagnosis, Value
from ros2_ident.gap.verdict import REFUSED
from ros2_ident.identify.result import Identification, Outcome
from ros2_ident.machine.keys import digits, inline
from ros2_ident.models import EffectAt
from ros2_ident.recording import LIVE
from ros2_ident.report.diagnosis import Written
from ros2_ident.report.page.numbers import plus_minus, quantity, some
from ros2_ident.words import verdict as words
from ros2_ident.words.change import title_of

# Machines of a fleet that its page has steps for.
FLEET = 3
# A parameter that an effect moves by so much of its value is named; where only all numbers
# together are determined, one that moves by so much.
MOVED, MOVED_TOGETHER = 0.05, 0.005
# Of a number whose interval is wider than itself.
LOOSE = 'not determined'


@dataclass(frozen=True)
class Law:
    """An effect with its title, and symbol, name, and value with interval of its numbers."""

    effect: Effect
    title: str
    numbers: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True)
class Step:
    """Something to do, with equations for a simulation and lines to paste."""

    text: str
    laws: tuple[Law, ...] = ()
    code: str = ''

    @property
    def loose(self) -> bool:
        """Whether a number of an equation is not determined."""
        return any(LOOSE in value for law in self.laws for *_, value in law.numbers)


def _law(at: EffectAt, parameters: Mapping[str, Value]) -> Law:
    """Return an effect of the catalogue as an equation with its numbers."""
    effect = CATALOGUE[at.effect]
    rows = []
    for p in effect.parameters:
        if (v := parameters.get(f'{at.prefix}{p.name}')) is None:
            continue
        text = quantity(v.value, v.unit, 3)
        if not math.isnan(v.high - v.low + v.value):
            known = plus_minus(v.value, v.low, v.high, v.unit)
            text = f'{text}, {LOOSE}' if undetermined(v) else known
        rows.append((p.symbol, p.meaning or p.name.replace('_', ' '), text))
    return Law(effect, at.title, tuple(rows))


def undetermined(v: Value) -> bool:
    """Whether a parameter's interval is wider than its value, or all of its search."""
    everything = v.low <= v.lower_bound and v.high >= v.upper_bound
    return everything or 0.5 * (v.high - v.low) > abs(v.value)


def of_diagnosis(w: Written, out: str) -> Iterator[Step]:
    """Yield what to do after a diagnosis."""
    d, following = w.found, f'{out}_next'
    if words.named(d):
        yield from _steps_of_effects(w, out)
    elif d.effect == 'none':
        yield Step('Leave the simulation as it is: no effect has to be added.')
        code = _ident('identify', w, out)
        yield Step('Identify its parameters from the whole recording:', code=code)
    elif d.effect in REFUSED:
        text = (
            'Choose another kind of machine, or check that the recording is of this one:'
            if d.facts.cause == Cause.MODEL
            else 'Correct what is named above, in the machine file or in the recording, and check '
            'what else fits:'
        )
        yield Step(text, code=_ident('check', w))
    elif d.facts.cause == Cause.EVENTS:
        yield Step(
            'Find the cause of these instants and record without it, to see what else is missing:',
            code=_ident('diagnose', w, following, bag='NEW_BAG'),
        )
    else:
        alone = words.place(d.where) + ('' if not d.where or 'all' in d.where else ' alone')
        yield Step(
            f'Look at where the gap lies, below. Record {alone}, slowly and in both directions.'
        )
        code = _ident('diagnose', w, following, check=True)
        yield Step('Then judge on that recording:', code=code)
        yield Step(
            'If you know the cause, write it as an effect of your own and try it with '
            '`--effect FILE.py`.'
        )


def _steps_of_effects(w: Written, out: str) -> Iterator[Step]:
    d = w.found
    laws = [_law(at, d.parameters) for at in words.named(d) if at.effect in CATALOGUE]
    of_log = [law for law in laws if law.effect.group == 'measurement']
    missing = [law for law in laws if law not in of_log]
    effects: list[Step] = []
    if missing:
        both = ', together with the parameters below' if moved_names(d) else ''
        effects.append(Step(f'Add to your simulation{both}:', laws=tuple(missing)))
    if of_log:
        text = 'Correct how the log is made; a simulation of the machine does not need this:'
        effects.append(Step(text, laws=tuple(of_log)))
    yield from effects
    if w.machine_lines:
        yield Step('Change the machine file:', code='\n'.join(w.machine_lines))
    loose = any(step.loose for step in effects)
    values = []
    for name in moved_names(d, together=loose):
        v = d.parameters[name]
        unit = '' if v.unit == '1' else f'{v.unit}; '
        old = _plain(d.nominal[name])
        values.append(f'{inline(name)}: {_plain(v.value)}  # {unit}{old} before')
    if values:
        them = 'them' if d.also else 'it'
        told = f'Update these parameters, which had compensated for {them}:'
        if loose:
            told = 'Set these parameters with them; they belong to the numbers above:'
        yield Step(told, code='\n'.join(values))
    if missing:
        yield from _export(w.settings, out)
    motions = [
        f'{CATALOGUE[at.effect].title}: {words.separating(at.effect, at.where, d.facts.travel)}'
        for at in (r.at for r in d.confusable[1:])
        if at.effect in CATALOGUE
    ]
    text = 'Record another motion, and see that the gap closes there, too:'
    if motions:
        rivals = '; from '.join(dict.fromkeys(motions))
        text = f'Record what tells it from {rivals}. Then judge on that recording:'
    yield Step(text, code=_ident('diagnose', w, f'{out}_next', check=True))


def moved_names(d: Diagnosis, *, together: bool = False) -> list[str]:
    """Return the nominal parameters that had made up for the effects.

    Args:
        together: Whether to return all that moved, for they are determined together only.
    """
    if not words.named(d):
        return []
    least = MOVED_TOGETHER if together else MOVED
    out = []
    for name, share in d.moved.items():
        v = d.parameters[name]
        # beyond its interval with the effects, too, where it stands for itself
        inside = v.low <= d.nominal.get(name, math.nan) <= v.high
        if abs(share) >= least and (together or not inside):
            out.append(name)
    return out


def _plain(value: float) -> str:
    """Return a number with four digits as YAML reads one."""
    rounded = float(f'{value:.4g}')
    return f'{rounded:.0f}' if 1e3 <= abs(rounded) < 1e9 else digits(rounded)


def _export(settings: Mapping[str, Any], out: str) -> Iterator[Step]:
    """Yield how the files of a simulator get the numbers; nothing without a machine file."""
    if settings.get('machine_file'):
        code = shlex.join(['ident', 'export', out, '--out', f'{out}_simulator'])
        yield Step('Or have URDF, MJCF, Isaac Lab and ros2_control files written:', code=code)


def _ident(
    verb: str, of: Written | Identification, out: str = '', *, bag: str = '', check: bool = False
) -> str:
    """Return a command for the recordings and machine of a result, or to judge on a new one."""
    settings: Mapping[str, Any] = of.settings
    source = of.provenance.source
    # What was heard on topics is in no bag: the command is for one of them.
    bags = settings.get('bags') or [source if source not in ('', LIVE) else 'BAG']
    parts = ['ident', verb, *([bag] if bag else map(str, bags)), *['--check', 'NEW_BAG'] * check]
    parts += ['--machine', str(settings.get('machine_file') or 'MACHINE.yaml')]
    if settings.get('from') and verb in ('identify', 'diagnose'):
        parts += ['--from', str(settings['from'])]
    if check:
        # The quantity compared is named only where it is not the kind's own.
        parts += [x for name in settings.get('outputs') or () for x in ('--output', name)]
    return shlex.join([*parts, *(['--out', out] if out else ())])


def of_fleet(data: Mapping[str, Any], several: Sequence[Between], out: str) -> Iterator[Step]:
    """Yield what to do after a fleet, by its file's content and its comparisons."""
    rows = {row['name']: row for row in data['rows']}
    told = [b for b in several if b.found.changes]
    for machine in list(dict.fromkeys(b.machine for b in told))[:FLEET]:
        drifts = [b for b in told if b.machine == machine and b.kind == 'drift']
        of_it = drifts or [b for b in told if b.machine == machine]
        row = max((rows[b.after] for b in of_it), key=lambda row: str(row['date']))
        names = some(
            list(dict.fromkeys(title_of(c.suspect) for b in of_it for c in b.found.changes))
        )
        bag, file = row.get('bag') or 'BAG', row.get('machine_file') or 'MACHINE.yaml'
        words = ['ident', 'diagnose', bag, '--machine', file, '--out', f'{out}/{row["name"]}']
        yield Step(
            f'Inspect {machine}, for its {names}. See where it shows:', code=shlex.join(words)
        )
    failed = [row['name'] for row in data['rows'] if row['state'] != 'done']
    if failed:
        text = f'Correct what the table says of {some(failed)}, and run the same command again: '
        yield Step(text + 'it keeps what is done.')


def of_identification(result: Identification, out: str) -> Iterator[Step]:
    """Yield what to do after an identification; the arguments are as of `of_diagnosis`."""
    if result.outcome is Outcome.IDENTIFIED:
        yield Step('Use these values; a table below has all digits.')
        yield from _export(result.settings, out)
    yield Step('Ask what the model lacks:', code=_ident('diagnose', result, out))
