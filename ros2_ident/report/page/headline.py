# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis found: the headline of its page, and what goes below it where it is long."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ros2_ident.gap.facts import Cause
from ros2_ident.report.page import sentences
from ros2_ident.report.page.numbers import quantity
from ros2_ident.report.page.sentences import capital, effect_name, effects_named
from ros2_ident.report.page.steps import effects_found, places, REFUSALS

# A headline of more letters than this ends after the first effect: three lines of a page.
_LONG = 110


def headline(data: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Return what is missing and where, and the rest of it where one sentence would be long.

    Args:
        data: The content of `diagnosis.json`.
    """
    verdict = data['verdict']
    if verdict['effect'] == 'none':
        return _nothing(data), ()
    if verdict['effect'] in REFUSALS:
        return REFUSALS[verdict['effect']][0], ()
    if verdict['effect'] == 'unknown':
        return _unknown(data), ()
    found = effects_found(data)
    of_log = [at for at in found if sentences.of_log(at['effect'])]
    missing = [at for at in found if at not in of_log]
    text = _one_sentence(missing, of_log)
    if len(text) <= _LONG:
        return text, ()
    return _short(missing), tuple(_rest(missing, of_log))


def _unknown(data: Mapping[str, Any]) -> str:
    where = places(data['verdict']['where'])
    cause = data['verdict']['cause']
    if cause == Cause.CUT_SHORT:
        return f'Cut short: the simulation of {where} is off, and no cause was found yet.'
    if cause == Cause.EVENTS:
        return f'{capital(where)} produced effort that was not commanded.'
    if cause == Cause.SLOW:
        return f'The residual of {where} is too large and too slow for noise.'
    return f'Something is missing in the simulation of {where}, and no known effect explains it.'


def _one_sentence(
    missing: Sequence[Mapping[str, Any]], of_log: Sequence[Mapping[str, Any]]
) -> str:
    distorted = effects_named(of_log) if of_log else ''
    if not missing:
        return f'The logged effort is off, not the simulation: {distorted}.'
    verb = 'is' if len(missing) == 1 else 'are'
    too = f'; the logged effort is off, too: {distorted}' if of_log else ''
    return f'{capital(effects_named(missing))} {verb} missing in the simulation{too}.'


def _short(missing: Sequence[Mapping[str, Any]]) -> str:
    """Return the first of several effects, the one that closes most, and how many there are."""
    if not missing:
        return 'The logged effort is off, not the simulation.'
    first, more = capital(effect_name(missing[0])), len(missing) - 1
    if not more:
        return f'{first} is missing in the simulation.'
    others = 'another effect' if more == 1 else f'{more} more effects'
    return f'{first} and {others} are missing in the simulation.'


def _rest(
    missing: Sequence[Mapping[str, Any]], of_log: Sequence[Mapping[str, Any]]
) -> Iterator[str]:
    if missing[1:]:
        yield f'Also missing: {effects_named(missing[1:])}.'
    if of_log:
        too = ', too' if missing else ''
        yield f'The logged effort is off{too}: {effects_named(of_log)}.'


def _nothing(data: Mapping[str, Any]) -> str:
    """Return the headline where no effect is named: how large one could be and not be found."""
    if (data['evidence']['size'] or 0.0) >= (data['evidence']['material'] or 0.0):
        return 'Nothing can be named: what is left is too small to tell its cause.'
    limit = quantity(_limit(data), data['gap']['unit'], 2)
    if data['facts']['hidden']:
        return f'Nothing found missing above {limit}, but slow noise may hide more.'
    return f'Nothing found missing: what is left is noise, in which a gap of {limit} would show.'


def _limit(data: Mapping[str, Any]) -> float:
    """Return the gap, RMS, that counts on every drive."""
    floors = [d['noise_floor'] or 0.0 for d in data['gap']['per_drive'].values()]
    return float(data['evidence']['material'] or 0.0) * max(floors, default=0.0)
