# SPDX-License-Identifier: Apache-2.0
"""Remarks on a machine file's content, by the keys of its kind."""

from collections.abc import Iterator, Mapping
import difflib
import os
from pathlib import Path
from typing import Any

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.description import description_text
from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.draft import Path as Keys
from ros2_ident.machine.keys import DESCRIPTION_TOPIC, Key
from ros2_ident.machine.kind import Kind
from ros2_ident.machine.units import effort_factors, name_of, number, plain_unit, shown

SECTIONS = ('geometry', 'drive', 'controller', 'parameters')
TEMPLATE = 'start from one that `ident new-machine` writes'
# What others are divided by; a gear may turn the other way round.
_ABOVE_ZERO = ('cycle', 'torque_limit')
_NOT_ZERO = (*_ABOVE_ZERO, 'gear_factor')
_WORDS = ('no', 'one', 'two', 'three', 'four', 'five', 'six')


def contents(data: Mapping[str, Any]) -> dict[Keys, Any]:
    """Return what a machine file holds by path; a section that is no mapping as a whole."""
    present: dict[Keys, Any] = {}
    for name, value in data.items():
        if name in SECTIONS and isinstance(value, Mapping):
            present |= {(name, name_of(key)): entry for key, entry in value.items()}
        elif name not in SECTIONS or value is not None:
            present[name_of(name),] = value
    return present


def judge(data: Any, kinds: Mapping[str, Kind], folder: Path) -> Iterator[Remark]:
    """Yield everything there is to change in a machine file's content.

    Args:
        data: What the file holds.
        kinds: Kinds of machines by name.
        folder: Where the files lie that it names.
    """
    if not isinstance(data, Mapping):
        yield Remark((), f'holds no mapping; {TEMPLATE}')
        return
    if str(data.get('machine')) not in kinds:
        yield Remark(
            ('machine',),
            f'machine is {shown(data.get("machine"))}; write one of {", ".join(kinds)}',
            code=ErrorCode.UNKNOWN_MODEL,
        )
        return
    kind = kinds[str(data['machine'])]
    draft = Draft(kind.name, kind.by_path, contents(data))
    for name in SECTIONS:
        if (name,) in draft.present:
            yield Remark((name,), f'{name} has to be a mapping of names to values')
            return
    yield from _drives(draft, kind)
    yield from _names(draft)
    for path, value in draft.present.items():
        if path in draft.keys and path not in (('machine',), ('drives',)):
            yield from _value(draft, draft.keys[path], value)
            yield from _file(draft.keys[path], value, folder)
    yield from _missing(draft)
    yield from _effort(draft, kind)
    yield from kind.judge(draft)


def _drives(draft: Draft, kind: Kind) -> Iterator[Remark]:
    drives = draft.present.get(('drives',))
    if not isinstance(drives, list) or not drives or len(set(draft.drives)) != len(drives):
        yield Remark(('drives',), 'drives has to be a list of different joint names')
    elif kind.drives is not None and len(drives) != kind.drives:
        count = _WORDS[kind.drives] if kind.drives < len(_WORDS) else kind.drives
        yield Remark(
            ('drives',),
            f'a {kind.name} has {count} drive{"s" if kind.drives != 1 else ""}, drives lists '
            f'{len(drives)}',
        )


def _names(draft: Draft) -> Iterator[Remark]:
    """Judge keys that no machine of this kind has."""
    for path in draft.present:
        if path in draft.keys:
            continue
        beside = [key[-1] for key in draft.keys if key[:-1] == path[:-1]]
        near = difflib.get_close_matches(path[-1], beside, 1)
        elsewhere = next((key for key in draft.keys if key[-1] == path[-1]), None)
        if elsewhere is not None:
            remedy = f'it belongs under {elsewhere[0] if elsewhere[1:] else "the file itself"}'
        elif near:
            remedy = f'write {near[0]}, or remove the line'
        else:
            remedy = f'choose from {", ".join(beside)}, or remove the line'
        boxed = path[0] == 'parameters'
        found = ErrorCode.UNKNOWN_PARAMETER if boxed else ErrorCode.BAD_MACHINE_FILE
        yield Remark(
            path,
            f'a {draft.kind} has no key {shown(".".join(path))}; {remedy}',
            code=found,
        )


def _missing(draft: Draft) -> Iterator[Remark]:
    """Judge what is not there; what is to be found need not be known."""
    for key in draft.keys.values():
        if key.absent or key.section == 'parameters' or key.path in draft.present:
            continue
        if not draft.states('parameters', key.name) and key.path != ('drives',):
            yield Remark(
                key.path,
                f'{".".join(key.path)} is missing; add the line `{draft.line(*key.path)}`',
            )
    if not any(path[0] == 'parameters' for path in draft.present):
        example = next(k for k in draft.keys.values() if k.section == 'parameters')
        yield Remark(
            ('parameters',),
            f'parameters is empty: name at least one, as `{draft.line(*example.path)}`',
        )


def _effort(draft: Draft, kind: Kind) -> Iterator[Remark]:
    if draft.effort_unit in kind.logs:
        return
    try:
        effort_factors(
            draft.effort_unit,
            draft.present.get(('torque_constant',)),
            draft.present.get(('rated_torque',)),
        )
    except IdentError as error:
        yield Remark(('effort_unit',), error.message, code=error.code)


# ---------------------------------------------------------------------- one value


def _value(draft: Draft, key: Key, value: Any) -> Iterator[Remark]:
    """Judge what stands at one key: one value, or one for each drive."""
    entries = [value]
    several = isinstance(value, list) and (
        key.section != 'parameters' or bool(value) and isinstance(value[0], list)
    )
    if several and key.each:
        entries = value
        if len(value) != len(draft.drives):
            yield Remark(
                key.path,
                f'{".".join(key.path)} has {len(value)} values for {len(draft.drives)} drives; '
                'write one for all, or one for each drive',
            )
            return
    for entry in entries:
        if key.section == 'parameters':
            yield from _interval(draft, key, entry)
        elif key.unit:
            yield from _quantity(draft, key, entry)
        elif key.choices and entry not in (*key.choices, *dict(key.aliases)):
            yield Remark(
                key.path,
                f'{key.name} is {shown(entry)}; write one of {", ".join(key.choices)}',
            )


def _file(key: Key, value: Any, folder: Path) -> Iterator[Remark]:
    if not key.file or value == DESCRIPTION_TOPIC:
        return
    # False, too, for what can be no path
    if isinstance(value, str) and os.path.isfile(folder / value):
        try:
            description_text(folder / value)
        except IdentError as error:
            yield Remark(key.path, error.message)
    else:
        yield Remark(
            key.path,
            f'{key.name} names {name_of(value)}, and there is no such file; give its way from the '
            'folder of the machine file',
        )


def _quantity(draft: Draft, key: Key, value: Any) -> Iterator[Remark]:
    found = number(value)
    if found is None:
        yield Remark(
            key.path,
            f'{".".join(key.path)} is {shown(value)}; write a number{_in_unit(draft, key)}',
        )
    elif found == 0.0 and key.name in _NOT_ZERO or found < 0.0 and key.name in _ABOVE_ZERO:
        yield Remark(
            key.path,
            f'{".".join(key.path)} is {found:g}, by which nothing can be divided; write a number '
            f'above 0{_in_unit(draft, key)}',
        )
    elif not key.low <= found <= key.high:
        yield Remark(key.path, _implausible(draft, key, f'{found:g}'), 'warn')


def _interval(draft: Draft, key: Key, value: Any) -> Iterator[Remark]:
    """Judge the box of one parameter."""
    ends = [number(end) for end in value[:2]] if isinstance(value, list) else []
    if len(ends) != 2 or len(value) != 3 or None in ends:
        yield Remark(
            key.path,
            f'parameter {key.name}: write [min, max, unit], found {shown(value)}',
        )
        return
    low, high = (end for end in ends if end is not None)
    if not low < high:
        yield Remark(
            key.path,
            f'parameter {key.name}: min has to be below max, found {shown(value)}',
        )
    elif not (key.low <= low and high <= key.high):
        yield Remark(key.path, _implausible(draft, key, f'[{low:g}, {high:g}]'), 'warn')
    if draft.turns:
        known = [draft.unit(key)]
    else:
        known = [unit for unit in (key.unit, key.force_unit) if unit]
    if plain_unit(value[2]) not in [plain_unit(unit) for unit in known]:
        yield Remark(
            key.path,
            f'parameter {key.name} is in {shown(value[2])} but read as {draft.unit(key)}; convert '
            'the bounds and write that unit',
            code=ErrorCode.WRONG_UNITS,
        )


def _in_unit(draft: Draft, key: Key) -> str:
    unit = draft.unit(key)
    return '' if unit in ('', '1') else f' in {unit}'


def _implausible(draft: Draft, key: Key, found: str) -> str:
    return (
        f'{key.name} is {found} {draft.unit(key)}, {key.low:g} to {key.high:g} would be '
        f'plausible; {key.remedy}'
    )
