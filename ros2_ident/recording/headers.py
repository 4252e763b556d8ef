# SPDX-License-Identifier: Apache-2.0
"""Meaning of a table's columns by their names, as drivers and scopes write them.

Of a path (`observation.state.elbow.pos`) the last part that names a quantity says it, any part
says whether it is a set-point, and the words that are left are the joint.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
import csv
from dataclasses import dataclass, replace
import io
from itertools import chain, islice, pairwise
import math
from os.path import commonprefix
from pathlib import Path
import re
import shlex

from ros2_ident.errors import ErrorCode
from ros2_ident.recording import columns as maps
from ros2_ident.recording.limits import listed, printable, short
from ros2_ident.recording.table import array_sizes, ARRAYS, text_of

# Words of names: English and German, textbooks' symbols, common drivers. Where another word names
# a quantity, a faint one does not (`current_position`, `load.position`).
_WORDS = {
    'position': 'pos posn qpos position positions angle angles winkel lage weg '
    'displacement displacements',
    'velocity': 'vel velo qvel velocity velocities speed speeds omega dq qdot geschwindigkeit '
    'drehzahl',
    'effort': 'eff effort efforts torque torques tau tor tq trq currents curr amps iq force '
    'moment momenten drehmoment drehmomenten strom kraft',
    'command': 'cmd command commands commanded ref reference references set setpoint setpoints '
    'desired des demand demanded goal target input action actions soll sollwert interpolated ipo',
    'measured': 'act actual meas measured present feedback fb estimate est estimated ist istwert '
    'observation observations averaged avg',
    'other': 'ext external gravity grav coriolis ff feedforward err error following deviation '
    'temp temperature temperatures voltage volt pwm duty acc accel acceleration ddq qdd jerk tcp '
    'pose kp kd ki gain limit scaling computed cmptd calculated calc',
    'time': 'time times t stamp stamps timestamp timestamps clock zeit sec secs seconds',
    'vague': 'value values state states data controller control trajectory mapper foc rel header '
    'field raw',
    'treated': 'filtered filt fil gefiltert smoothed compensated compensate',
    'place': 'joint joints j axis motor servo drive id',
}
_MEANT = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_FAINT = dict.fromkeys(('q', 'theta', 'encoder'), 'position')
_FAINT |= dict.fromkeys(('current', 'i', 'load'), 'effort')
# Beside a role a letter is enough: `p_des`, `t_actual`.
_LETTERS = {'p': 'position', 'v': 'velocity', 't': 'effort'}
# What a textbook calls so, where it is all of the name: to be asked, not told.
_SYMBOLS = dict.fromkeys(('x', 'q', 's', 'p', 'phi'), 'position')
_SYMBOLS |= {'v': 'velocity', 'w': 'velocity', 'f': 'effort', 'm': 'effort'}
_QUANTITIES = ('velocity', 'effort', 'position')
_ROLES = ('command', 'measured')
_WORD = re.compile(r'[A-Z]?[^\W\d_A-Z]+|[A-Z]+(?![^\W\d_A-Z])|[A-Z]|\d+')
_BESIDE = ' _-./:'
# Units, and of what is no motion and no effort, too.
_KNOWN = maps.MOTION.keys() | maps.SPEEDS.keys() | maps.EFFORT.keys() | maps.TIME_UNITS.keys()
_UNITS = _KNOWN | {*['1', 'v', 'mv', 'w', 'kw', 'khz', '°c', 'kg', 'bar', 'pa']}
# Units of a time by what one of it is in s.
_SECONDS = {1.0: 's', 1e-3: 'ms', 1e-6: 'us', 1e-9: 'ns'}
# Lines that are looked at.
_HEAD = 200
_HOLDS_WORDS = 'holds words'
_NAMES_NONE = 'names no position, velocity or effort'
_LONG = (
    'holds one value a row; make it a table with a column for each of its quantities, as by the '
    'pivot of pandas'
)
_NO_ROWS = 'it has no row of numbers for each time'


@dataclass(frozen=True)
class Meaning:
    """Meaning of one column."""

    name: str  # of the column
    joint: str = ''  # empty for the time
    quantity: str = ''  # `time`, a quantity of a joint, or empty where it is left out
    unit: str = ''  # as the header writes it; empty for none
    scale: float = 1.0  # to the unit that is read; NaN where the header's unit does not say it
    why: str = ''  # it is left out
    perhaps: str = ''  # JOINT.QUANTITY, were it told by the columns' order, or by a symbol
    stated: bool = False  # whether an option says the scale, and the header's unit no more

    @property
    def plain(self) -> str:
        """Its unit, as column maps have it."""
        return maps.plain_unit(self.unit)


def meanings(names: Sequence[str], units: Sequence[str] = ()) -> list[Meaning]:
    """Return the meaning of each column by its name, and its unit in a line of their own."""
    # `qd` is the velocity, but where that is `dq`, the desired position.
    derived = any(re.search(r'(?<![a-z])(dq|qdot)(?![a-z])', name.lower()) for name in names)
    pairs = zip(names, units or [''] * len(names), strict=True)
    rows = [_Name(name, unit, derived) for name, unit in pairs]
    # the effort that was asked for stands for the effort where there is no other
    if any(row.quantity == 'effort' and not row.wanted for row in rows):
        for row in (x for x in rows if x.wanted):
            row.quantity, row.why = '', 'a set-point of the effort'
    _told_by_units(rows)
    for row in rows:
        partners = [x for x in rows if x.quantity and x.key == row.key and x is not row]
        if row.bare and row.quantity and not row.unit and not partners:
            row.quantity, row.why = '', _NAMES_NONE
    spelled: dict[tuple[str, ...], Counter[str]] = {}
    for row in rows:
        if row.quantity:
            spelled.setdefault(row.key, Counter())[row.joint] += 1
    found, taken = dict[int, Meaning](), dict[str, str]()
    # what was made of a quantity stands for it where it is not there itself, and what a constant
    # of the drive turns into it, as a current into a torque
    for n, row in sorted(enumerate(rows), key=lambda x: (x[1].treated, x[1].asks)):
        joint, quantity, why = '', row.quantity, row.why
        if quantity not in ('', 'time'):
            joint = spelled[row.key].most_common(1)[0][0]
            joint = f'joint_{joint}' if joint.isdigit() else joint or 'joint_1'
        place = f'{joint}.{quantity}'.lstrip('.')
        if quantity and place in taken:
            joint, quantity, why = '', '', f'{place} is {taken[place]} already'
        elif quantity:
            taken[place] = row.name
        found[n] = Meaning(row.name, joint, quantity, row.unit, row.scale, why)
    out = [found[n] for n in range(len(rows))]
    # An effort beside joints that move is none of a joint of which no motion is there.
    moving = dict.fromkeys(x.joint for x in out if x.quantity in ('position', 'velocity'))
    efforts = {x.joint: n for n, x in enumerate(out) if x.quantity == 'effort'}
    apart = [n for joint, n in efforts.items() if joint not in moving]
    bare = [n for n, x in enumerate(out) if x.why == _NAMES_NONE and not moving]
    names = [*moving] or [out[n].name for n in bare]
    if apart and len(names) == len(efforts):
        for n, name in zip(efforts.values(), names, strict=True):
            out[n] = replace(out[n], perhaps=f'{name}.effort')
        for n in bare:
            out[n] = replace(out[n], perhaps=f'{out[n].name}.position')
    if not moving and not efforts:
        # the letters of a textbook, each once
        letters = {n: q for n, x in enumerate(out) if (q := _SYMBOLS.get(x.name.lower()))}
        if len({*letters.values()}) == len(letters):
            for n, quantity in letters.items():
                out[n] = replace(out[n], perhaps=f'joint_1.{quantity}')
    for n in apart if moving else ():
        why = f'no column says how {short(out[n].joint)} moves'
        out[n] = replace(out[n], joint='', quantity='', why=why)
    return out


def _told_by_units(rows: Sequence['_Name']) -> None:
    """Let units say the quantities where no name says a motion, as of `x [mm], v [mm/s], F [N]`.

    Where each is there once they are one joint's; else the names are those of joints.
    """
    if any(row.quantity in ('position', 'velocity') for row in rows):
        return
    silent = ((row, _of_unit(row.unit)) for row in rows if row.why == _NAMES_NONE)
    told = {row: quantity for row, quantity in silent if quantity}
    for row, quantity in told.items():
        row.quantity, row.why = quantity, ''
        row.scale = maps.units_of(quantity)[maps.plain_unit(row.unit)]
    alone = len({*told.values()}) == len(told)
    named = [row for row in rows if row.quantity not in ('', 'time')]
    if told and alone and {row.key for row in named} <= {(), *(row.key for row in told)}:
        for row in named:
            row.key, row.joint = (), ''


def _of_unit(unit: str) -> str:
    """Return the quantity that alone has a unit; percent, counts and Hz are of anything."""
    plain = maps.plain_unit(unit)
    if plain == 'hz' or maps.si_unit('effort', plain) == 'percent':
        return ''
    factors = ((x, maps.factor_of(x, unit)) for x in ('position', 'velocity', 'effort'))
    return next((x for x, factor in factors if math.isfinite(factor or math.nan)), '')


class _Name:
    """Name of a column, taken apart.

    The words of `key` tell the joint from others, in lower case; `joint` is as spelled here.
    """

    def __init__(self, name: str, below: str, derived: bool) -> None:
        self.name = name
        whole = re.sub(r'^#\s+', '', name)
        text, unit, behind = _without_unit(whole)
        stated = below.strip('[]() ')
        if not self._read(text, stated or unit, derived) and behind and not stated:
            # what is no unit of it is a name's end
            self._read(whole, '', derived)

    @property
    def asks(self) -> int:
        """How much its owner has to state: 0 for nothing, 1 perhaps, 2 a constant, 3 a scale."""
        if math.isnan(self.scale):
            return 3
        if self.quantity != 'effort':
            return 0
        plain = maps.plain_unit(self.unit)
        return 1 if not plain else 2 * (maps.si_unit('effort', plain) in ('A', 'percent'))

    def _read(self, text: str, unit: str, derived: bool) -> bool:
        """Take a name without its unit apart; return whether the unit is one of its quantity."""
        self.unit, plain = unit, maps.plain_unit(unit)
        pieces = re.split(r'([/.])', text)
        parts = [_Part(x, derived) for x in pieces[::2]]
        kinds = {kind for part in parts for kind in part.kinds}
        self.treated = 'treated' in kinds
        role = next((x for x in _ROLES if x in kinds), '')
        # The last part that names a quantity says it; what others name is of the joint's name.
        named = [(n, x) for n, part in enumerate(parts) if (x := part.quantity(role))]
        says, quantity = named[-1] if named else (-1, '')
        # A role alone is one of a position; its unit goes before it, as before a faint word.
        self.bare = not quantity and role != '' and 'time' not in kinds
        faint = self.bare or (says >= 0 and not {*parts[says].kinds} & {*_QUANTITIES})
        quantity = 'position' if self.bare else quantity
        fits = not quantity or not _is_unit(unit) or maps.factor_of(quantity, unit) is not None
        if not fits and faint:
            of = (x for x in ('position', *_QUANTITIES) if maps.factor_of(x, unit) is not None)
            if found := next(of, ''):
                fits, quantity = True, found
        rests = [part.rest(role, quantity if n == says else '') for n, part in enumerate(parts)]
        self.quantity, self.why, self.scale = '', '', 1.0
        if 'other' in kinds:
            self.why = 'no position, velocity or effort of a drive'
        elif not quantity and ('time' in kinds or (not kinds and plain in maps.TIME_UNITS)):
            self.quantity = 'time'
        elif not quantity:
            self.why = _NAMES_NONE
        elif not fits:
            self.why = f'no {quantity} is in {unit}'
        else:
            self.scale = maps.units_of(quantity).get(plain, 1.0)
            asked = role == 'command' and quantity != 'effort'
            self.quantity = f'command_{quantity}' if asked else quantity
        self.wanted = role == 'command' and self.quantity == 'effort'
        self.key = tuple(word for _, key in rests for word in key)
        self.joint, last = '', -2
        for n, (spelled, key) in enumerate(rests):
            if key:
                between = '' if not self.joint else pieces[2 * n - 1] if last == n - 1 else '_'
                self.joint, last = f'{self.joint}{between}{spelled}', n
        return fits


class _Part:
    """Part of a path: its words, and what each stands for."""

    def __init__(self, text: str, derived: bool) -> None:
        self.text = text
        self.words: list[tuple[int, int, str]] = []
        for found in _WORD.finditer(text):
            cut = _glued(found[0].lower())
            ends = [found.start(), *([found.start() + cut] if cut else []), found.end()]
            self.words += [(a, b, text[a:b].lower()) for a, b in pairwise(ends)]
        self.plain = [word for *_, word in self.words]
        self.kinds = [_MEANT.get(word, '') for word in self.plain]
        for i, word in enumerate(self.plain):
            # of `q_d`, and of `q1_d` where it stands apart from the number
            parted = i > 1 and self.words[i][0] > self.words[i - 1][1]
            last = i - 2 if parted and self.plain[i - 1].isdigit() else i - 1
            if word == 'd' and i and (self.kinds[last] or self.plain[last] in _FAINT):
                self.kinds[i] = 'command'
            elif word == 'qd':
                self.kinds[i] = 'command' if derived else 'velocity'
        self._desired = derived

    def quantity(self, role: str) -> str:
        """Return the quantity that it names last; by a letter only beside a role."""
        known = {**_FAINT, 'qd': 'position'} if self._desired else _FAINT
        faint = [known.get(word, '') for word in self.plain]
        letters = [_LETTERS.get(word, '') for word in self.plain] if role else []
        for kinds in (self.kinds, faint, letters):
            if found := [kind for kind in kinds if kind in _QUANTITIES]:
                return found[-1]
        return ''

    def rest(self, role: str, named: str) -> tuple[str, list[str]]:
        """Return what is left of it for the joint, as spelled, and the words that tell it.

        Of a name with a `role`; `named` is the quantity, where this part says it.
        """
        letter = bool(self.quantity(role)) and not self.quantity('')
        strong = [n for n, kind in enumerate(self.kinds) if kind in _QUANTITIES]
        says = {strong[-1]} if named and strong else set()
        kept, key = [], []
        for n, (kind, word) in enumerate(zip(self.kinds, self.plain, strict=True)):
            quantity = kind in _QUANTITIES or word in _FAINT
            # The load's own position is one of the load.
            faint = named and word in _FAINT and (word != 'load' or named == 'effort')
            gone = n in says or faint or (named and letter and word in _LETTERS)
            kept.append(kind == 'place' or not (gone or (kind and not quantity)))
            if kept[-1] and not kind and (named or not quantity or word == 'load'):
                key.append(word)
        whole = [w for w, keep in zip(self.words, kept, strict=True) if keep]
        if key and not named:
            kinds = zip(self.plain, kept, self.kinds, strict=True)
            key = [word for word, keep, kind in kinds if keep and kind != 'place']
        if not self.words:
            return self.text.strip(), [self.text.strip()]
        if not key:
            return '', []
        first, last = self.words.index(whole[0]), self.words.index(whole[-1])
        if last - first + 1 > len(whole):
            return '_'.join(self.text[a:b] for a, b, _ in whole), key
        # as it stands, but for what joins it to the words before and after
        begin = self.words[first - 1][1] if first else 0
        text = self.text[begin : self.words[last + 1][0] if last + 1 < len(kept) else None]
        # what stands first may be an item of a list
        text = text.lstrip(_BESIDE if first else '- ')
        return (text.rstrip(_BESIDE) if last + 1 < len(kept) else text).strip(), key


def _glued(word: str) -> int:
    """Return where a word is two known ones, one of them a role (`posdes`); 0 for nowhere."""
    if word in _MEANT or word in _FAINT:
        return 0
    known = {**_MEANT, **_FAINT}
    cuts = range(1, len(word))
    pairs = ((cut, known.get(word[:cut]), known.get(word[cut:])) for cut in cuts)
    return next((cut for cut, *both in pairs if all(both) and set(both) & {*_ROLES}), 0)


def _without_unit(name: str) -> tuple[str, str, bool]:
    """Return a name without its unit, that unit, and whether it may be the name's end instead.

    A unit stands in brackets, behind the last _, or as in `Angle in deg`, `s / mm`, `pos, m`.
    """
    found = re.fullmatch(r'(.*\S)\s*[\[(<]([^\[\]()<>]*)[\])>]\s*', name)
    if found and found[2].strip().isdigit():
        return f'{found[1]} {found[2].strip()}', '', False
    behind = re.fullmatch(r'(.+?)(?:_|\s+(?:in|/)\s+|,\s+)([A-Za-zµ%°]+(?:_s|/s|_per_s)?)', name)
    if found and _is_unit(found[2]):
        return found[1], found[2].strip(), False
    if behind and maps.plain_unit(behind[2]) in _KNOWN and _WORD.search(behind[1]):
        return behind[1], behind[2], True
    return name, '', False


def _is_unit(text: str) -> bool:
    """Return whether a text is a unit, of whatever, or made of several, as Nm/A and m/s^2."""
    parts = re.split('[/*·]', text.strip().lower())
    plain = (re.sub(r'(\^?-?\d|[²³])$', '', x.strip()) or x.strip() for x in parts)
    return maps.plain_unit(text) in _KNOWN or all(x in _UNITS for x in plain)


def _option(text: str) -> tuple[str, str, str, str]:
    """Return name, joint, quantity and scale of NAME=JOINT.QUANTITY*SCALE; empty for none."""
    name, _, place = text.rpartition('=')
    place, _, factor = place.partition('*')
    joint, _, quantity = place.rpartition('.')
    return name, joint, quantity, factor


@dataclass(frozen=True)
class Header:
    """Layout of a table, and the meaning of its columns."""

    columns: tuple[Meaning, ...]
    cells: tuple[str | int, ...]  # their names, or numbers from 1 where a name is not unique
    delimiter: str  # between cells; empty for arrays
    decimal: str  # the decimal mark
    skip: int  # lines before the names
    units: bool  # whether a line of units follows the names
    named: bool = True  # whether a line of names is there; else numbers stand for them
    words: str = ''  # said where what lacks is in a column of words
    rate: float = 0.0  # rows per second where they have no time, Hz

    def map(self) -> dict[str, object]:
        """Return the column map as a YAML mapping."""
        joints: dict[str, dict[str, object]] = {}
        time: dict[str, object] = {'rate': self.rate}
        for cell, x in zip(self.cells, self.columns, strict=True):
            if x.quantity == 'time':
                time = {'column': cell, 'unit': maps.TIME_UNITS.get(x.plain, 's')}
            elif x.quantity:
                by: dict[str, object] = {'scale': x.scale}
                if not x.stated and x.scale == maps.units_of(x.quantity).get(x.plain):
                    by = {'unit': x.plain}
                entry = cell if by == {'scale': 1.0} else {'column': cell, **by}
                joints.setdefault(x.joint, {})[x.quantity] = entry
        if not self.delimiter:
            return {'time': time, 'joints': joints}
        layout = {'delimiter': self.delimiter, 'decimal': self.decimal, 'skip': self.skip}
        below = {'skip_below': int(self.units)} if self.named else {'header': False}
        return {'time': time, 'joints': joints} | layout | below

    def timed(self, rate: float) -> 'Header':
        """Return the header of rows that follow each other at a rate, Hz; 0 for their own time."""
        if not rate:
            return self
        columns = (
            replace(x, quantity='', why='the rate is stated') if x.quantity == 'time' else x
            for x in self.columns
        )
        return replace(self, columns=tuple(columns), rate=rate)

    def lines(self) -> list[str]:
        """Return each column and what it is read as, a line each, for a terminal."""
        wide = min(40, max(len(printable(x.name, 40)) for x in self.columns))
        out = []
        for x in self.columns:
            read = f'{x.joint}.{x.quantity}'.lstrip('.')
            if x.quantity not in ('', 'time'):
                rate = x.plain != x.unit.strip().lower() or x.plain in maps.SPEEDS
                per = '/s' * (x.quantity.endswith('velocity') and not rate)
                plain = ', as it stands' if x.scale == 1.0 else ''
                read += f', in {x.unit}{per}' if x.unit else plain
                if math.isnan(x.scale):
                    read += ': its scale has to be stated'
                elif x.scale != 1.0:
                    read += f', times {x.scale:.7g}'
            out.append(f'  {printable(x.name, 40):{wide}}  {read or f"- ({x.why})"}')
        return out

    def in_order(self) -> str:
        """Return the options by which columns are read in the order of the joints; or nothing."""
        asked = (('--column', f'{x.name}={x.perhaps}') for x in self.columns if x.perhaps)
        return shlex.join(chain(*asked))

    def assigned(self, given: Sequence[str]) -> 'Header':
        """Return the header with columns read as NAME=JOINT.QUANTITY, NAME=time, or that *SCALE.

        Raises:
            IdentError: INVALID_GOAL for another text, or a column or quantity that is not there.
        """
        columns, names = list(self.columns), [x.name for x in self.columns]
        for text in given:
            name, joint, quantity, factor = _option(text)
            scale = math.nan
            with suppress(ValueError):
                scale = float(factor or 1.0)
            known = bool(joint) and quantity in maps.QUANTITIES
            unit = _SECONDS.get(scale, '') if (joint, quantity) == ('', 'time') else ''
            if name not in names or not (known or unit) or not math.isfinite(scale) or not scale:
                form = 'write NAME=JOINT.QUANTITY, NAME=JOINT.QUANTITY*SCALE or NAME=time (of ms, '
                form += 'time*1e-3), with a quantity of '
                able = f'{", ".join(maps.QUANTITIES)} and a column of {listed(names, 30)}'
                raise ErrorCode.INVALID_GOAL.error(f'--column {short(text)}: {form}{able}')
            at = names.index(name)
            before = columns[at]
            if unit:
                before = replace(before, unit=unit)
            for n, x in enumerate(columns):
                if before.quantity == quantity and x.joint == before.joint:
                    columns[n] = x = replace(x, joint=joint)  # as its other columns
                if (x.joint, x.quantity) == (joint, quantity):
                    other = 'another column was given for it'
                    columns[n] = replace(x, joint='', quantity='', why=other)
            columns[at] = Meaning(name, joint, quantity, before.unit, scale, stated=bool(factor))
        moving = dict.fromkeys(x.joint for x in columns if x.quantity in ('position', 'velocity'))
        stated = {_option(text)[0] for text in given}
        for n, x in enumerate(columns):
            if x.quantity != 'effort' or not moving or x.joint in moving:
                continue
            if x.name in stated:
                text = (
                    f'--column: {short(x.name)} is to be the effort of {short(x.joint)}, which no '
                )
                text += f'column moves; write one of {listed(moving, 30)}'
                raise ErrorCode.INVALID_GOAL.error(text)
            why = f'no column says how {short(x.joint)} moves'
            columns[n] = replace(x, joint='', quantity='', why=why)
        return replace(self, columns=tuple(columns))

    def called(self, drives: Sequence[str]) -> 'Header':
        """Return the header with joints that have numbers for names called as the drives are.

        Where they are as many, in the order of their numbers.
        """
        joints = {x.joint for x in self.columns} - {''}
        numbers = {x: found[1] for x in joints if (found := re.fullmatch(r'joint_(\d+)', x))}
        if not len(joints) == len(numbers) == len(drives) or joints & {*drives}:
            return self
        ordered = sorted(numbers, key=lambda x: int(numbers[x]))
        names = {'': '', **dict(zip(ordered, drives, strict=True))}
        return replace(self, columns=tuple(replace(x, joint=names[x.joint]) for x in self.columns))

    def driven(self, given: Sequence[str], named: Collection[str]) -> 'Header':
        """Return the header without joints that have no effort and no set-point beside efforts.

        Poses of a tool are such. Those of columns that are `given`, as to `assigned`, and those
        `named` stay.
        """
        of: dict[str, set[str]] = {}
        for x in self.columns:
            of.setdefault(x.joint, set()).add(x.quantity)
        if not any('effort' in kinds for kinds in of.values()):
            return self
        idle = {x for x, kinds in of.items() if kinds <= {'position', 'velocity'}}
        idle -= {*named, *(_option(text)[1] for text in given)}
        columns = list(self.columns)
        for n, x in enumerate(columns):
            if x.joint in idle:
                why = f'no effort and no set-point of {short(x.joint)}'
                columns[n] = replace(x, joint='', quantity='', why=why)
        return replace(self, columns=tuple(columns))

    def require_told(self, path: Path) -> None:
        """Refuse a table of whose columns none is known as a time, or as a quantity of a joint.

        Raises:
            IdentError: INVALID_GOAL with the options that tell it.
        """
        there = {x.quantity for x in self.columns} - {''}
        timed, moved = bool(self.rate or 'time' in there), bool(there - {'time'})
        if timed and moved:
            return
        if self.words:
            raise maps.refuse(path, self.words)
        names = [x.name for x in self.columns]
        if all(x.why == _NO_ROWS for x in self.columns):
            others = f', but {listed(names, 20)}' * bool(names)
            text = f'holds no array with a row of numbers for each time{others}; save such: of a '
            raise maps.refuse(path, f'{text}timeseries of MATLAB its Time and its Data')
        if not self.named:
            form = ('1=time', '2=joint_1.position', '3=joint_1.effort')[timed:]
            text = f'has {self.columns[0].why}; say what its columns are by their numbers, as by '
            rate = '' if timed else '; --rate HZ stands for a time'
            raise maps.refuse(path, f'{text}--column {" --column ".join(form)}{rate}')
        kinds = ['time'] * (not timed) + ['position, velocity or effort'] * (not moved)
        ways = [] if timed else ['--column NAME=time or --rate HZ, of rows without one']
        ways += [] if moved else [self.in_order() or '--column NAME=JOINT.QUANTITY']
        text = f'no column is named as a {", or as a ".join(kinds)}: {listed(names, 20)}'
        raise maps.refuse(path, f'{text}; say which is, by {", and ".join(ways)}')

    def require_scales(self, effort: bool = False) -> None:
        """Refuse columns whose unit does not tell their scale.

        Args:
            effort: Whether the effort has to be a force or torque, and no current or share.

        Raises:
            IdentError: INVALID_GOAL with the option that states it.
        """
        for x in self.columns:
            asked = effort and x.quantity == 'effort' and not x.stated
            asked = asked and maps.si_unit('effort', x.plain) in ('A', 'percent')
            if x.quantity and (math.isnan(x.scale) or asked):
                per = 'N m or N' if asked else 'N m, N, A or percent'
                per = per if x.quantity == 'effort' else 'rad or m'
                option = shlex.quote(f'{x.name}={x.joint}.{x.quantity}*SCALE')
                text = f'the column {short(x.name)} is in {x.unit}; say how many {per} one is'
                raise ErrorCode.INVALID_GOAL.error(f'{text}: --column {option}')


def header_of(path: Path) -> Header:
    """Return the layout of a table, or of a file of arrays, and its columns by their names.

    Raises:
        IdentError: INVALID_GOAL where the table holds words only, one value a row, a row for each
            quantity, or a time for each channel.
    """
    if path.is_dir() or path.suffix.lower() in ARRAYS:
        return _of_arrays(path)
    lines = list(islice(io.StringIO(text_of(path), newline=''), _HEAD))
    delimiter = max(',;\t', key=lambda x: sum(line.count(x) for line in lines))
    if not any(delimiter in line for line in lines):
        delimiter = ' '
    decimal = ',' if delimiter != ',' and re.search(r'\d,\d', ''.join(lines[-3:])) else '.'
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    try:
        rows = [[x.strip() for x in row] for row in reader]
    except csv.Error as exc:
        text = f'{path}: its first lines cannot be read ({exc}); correct them'
        raise ErrorCode.BAD_VALUES.error(text) from None
    rows = [row[:-1] if row and not row[-1] and delimiter == ' ' else row for row in rows]
    # Among more words than numbers a row holds values where it is like the last one.
    last = [_is_number(x, decimal) for x in rows[-1]] if rows else []
    held = []
    for number, row in enumerate(rows):
        known = [_is_number(x, decimal) for x in row]
        filled = [known[n] for n, x in enumerate(row) if x]
        # two numbers at least, the first cell among them or most
        plain = sum(filled) > 1 and (filled[0] or 2 * sum(filled) > len(filled))
        held += [number] if plain or (sum(last) > 1 and known == last) else []
    # A property above may have several numbers, but not as many in each row as the table.
    widths = [len(rows[n]) for n in held]
    usual = max(widths, key=widths.count, default=0)
    first = next((n for n in held if len(rows[n]) == usual), 0)
    values = [row for row in rows[first:] if len(row) == len(rows[first])]
    # A line of names may begin with the mark of a comment.
    above = [row[1:] if len(row) > 1 and row[0] == '#' else row for row in rows[:first]]
    wide = [n for n, row in enumerate(above) if values and len(row) == len(values[0])]
    if any(len(row) > 3 and len({*row[::2]}) == 1 and row[0] for row in above):
        text = 'has a block of properties above a time for each channel'
        where = f'{path.stem}{maps.MAP_SUFFIX}, as in docs/logs.md'
        raise maps.refuse(path, f'{text}; export it with one common time, or write {where}')
    if not wide:
        if not held:
            said = 'is empty; record again'
            ends = [row for row in rows if row and _is_number(row[-1], decimal)]
            if len(ends) > 1 and 2 * len({row[0] for row in ends}) <= len(ends) == len(rows):
                said = _LONG
            elif len(rows) > 1:
                said = _wordy(zip(rows[0], rows[1], strict=False), decimal)
            raise maps.refuse(path, said)
        if usual > len(rows):  # fewer times than quantities
            text = f'has {len(rows)} rows of {usual} numbers, as with a row for each quantity'
            raise maps.refuse(path, f'{text}; turn it over, so that each time has a row')
        said = 'no line of names above its numbers'
        if any(filter(None, above[-1:])):
            said = f'{usual} columns and {len(above[-1])} of names, {listed(above[-1])}'
        columns = [Meaning(str(n + 1), why=said) for n in range(usual)]
        at = (tuple(columns), tuple(range(1, usual + 1)))
        return Header(*at, delimiter, decimal, first, units=False, named=False)
    # Of two lines the lower one may hold units.
    units = above[wide[-1]] if wide[1:] and any(map(_is_unit, above[wide[-1]])) else []
    top = wide[-2 if units else -1]
    names = above[top]
    below = list(zip(*values, strict=True))
    wordy = [n for n, x in enumerate(below) if not all(_is_number(y, decimal) for y in x if y)]
    columns = meanings(['' if n in wordy else name for n, name in enumerate(names)], units)
    for n in wordy:
        columns[n] = Meaning(names[n], why=_HOLDS_WORDS)
    _require_wide(path, columns, values)
    unread = meanings(names, units)
    told = next((n for n in wordy if unread[n].quantity), None)
    words = '' if told is None else _wordy(((names[told], x) for x in below[told]), decimal)
    unique = {x for x in names if x and names.count(x) == 1 and names is rows[top]}
    cells = tuple(x if x in unique else n for n, x in enumerate(names, 1))
    return Header(tuple(columns), cells, delimiter, decimal, top, bool(units), words=words)


def _of_arrays(path: Path) -> Header:
    """Return the meaning of arrays by their names, each column of several by its number."""
    sizes = array_sizes(path)
    # as many rows as there are times, or as most arrays have
    times = [sizes[x.name][0] for x in meanings([*sizes]) if x.quantity == 'time']
    often = Counter(rows for rows, _ in sizes.values() if rows > 1)
    rows = next((x for x in times if x > 1), max(often, key=lambda x: often[x], default=0))
    each = {
        name: [name] if width == 1 else [f'{name}[{n}]' for n in range(width)]
        for name, (long, width) in sizes.items()
        if long == rows > 0
    }
    cells = [x for name in each for x in each[name]]
    # The structure or group that all lie in is none of a joint.
    within = re.match('(.*[./])?', commonprefix([*each]))
    begin = within.end() if within else 0
    read = zip(meanings([x[begin:] for x in cells]), cells, strict=True)
    columns = [replace(x, name=cell) for x, cell in read]
    others = [x for x in sizes if x not in each]
    columns += [Meaning(x, why=_NO_ROWS) for x in others]
    return Header(tuple(columns), (*cells, *others), '', '.', 0, False)


def _require_wide(path: Path, columns: Sequence[Meaning], values: Sequence[Sequence[str]]) -> None:
    """Refuse a table with a row for each quantity or joint instead of one for each time."""
    words = [n for n, x in enumerate(columns) if x.why == _HOLDS_WORDS]
    others = [x for x in columns if x.why != _HOLDS_WORDS and x.quantity != 'time' and x.name]
    times = [n for n, x in enumerate(columns) if x.quantity == 'time'][:1]
    if words and len(others) == 1 and not others[0].quantity:
        raise maps.refuse(path, _LONG)
    held = [{row[n] for row in values} for n in range(len(columns))]
    kinds = [n for n in words if len(held[n]) > 1]
    if kinds and any(len(held[n]) <= len(values) / 2 for n in times):
        name, shown = columns[kinds[0]].name, listed(sorted(held[kinds[0]]), 5)
        text = f'holds several rows for each time, by {short(name)}: {shown}; write a column map '
        raise maps.refuse(path, f'{text}that chooses one by `where`, as in docs/logs.md')


def _wordy(cells: Iterable[tuple[str, str]], decimal: str) -> str:
    """Return which of some cells, each after its column's name, holds words: one does."""
    name, cell = next(x for x in cells if x[1] and not _is_number(x[1], decimal))
    said = f'holds words where numbers belong, {short(cell)} below {short(name)}: write numbers '
    return f'{said}alone, a time in s from any instant and units in the names'


def _is_number(text: str, decimal: str) -> bool:
    try:
        float(text.replace(decimal, '.'))
    except ValueError:
        return False
    return True
