# SPDX-License-Identifier: Apache-2.0
"""Meaning of a table's columns by their names, as drivers and scopes write them.

Of a path (`observation.state.elbow.pos`) the last part that names a quantity says it, any part
says whether it is a set-point, and the words that are left are the joint.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
import math
import re

from ros2_ident.recording import columns as maps
from ros2_ident.recording.limits import short

# Words of names: English, German, Romance languages, textbooks' symbols, common drivers. Where
# another word names a quantity, a faint one does not (`current_position`, `load.position`).
_WORDS = {
    'position': 'pos posn qpos position positions angle angles winkel lage weg '
    'displacement displacements posición posicion posição posizione ángulo angulo',
    'velocity': 'vel velo qvel velocity velocities speed speeds omega dq qdot dot dtheta thetadot '
    'geschwindigkeit drehzahl velocidad velocidade vitesse velocità velocita',
    'effort': 'eff effort efforts torque torques tau tor tq trq currents curr amps iq force '
    'moment momenten drehmoment drehmomenten strom kraft '
    'corriente corrente courant coppia fuerza força',
    'command': 'cmd command commands commanded ref reference references set setpoint setpoints '
    'desired des demand demanded goal target input action actions soll sollwert interpolated ipo '
    'consigna consigne referencia riferimento deseado deseada',
    'measured': 'act actual meas measured present feedback fb estimate est estimated ist istwert '
    'observation observations averaged avg '
    'real medido medida mesuré mesurée mesure misurato misurata',
    'other': 'ext external gravity grav coriolis ff feedforward err error following deviation '
    'temp temperature temperatures voltage volt pwm duty acc accel acceleration ddq qdd ddot jerk '
    'tcp pose kp kd ki gain limit scaling computed cmptd calculated calc ddtheta',
    'time': 'time times t ts stamp stamps timestamp timestamps clock zeit uhrzeit elapsed tiempo '
    'tempo temps hora heure',
    'vague': 'value values point points state states data controller control trajectory mapper '
    'foc rel header field raw cumulative',
    'treated': 'filtered filt fil gefiltert smoothed compensated compensate',
    'place': 'joint joints j axis motor servo drive id achse achs gelenk antrieb antriebs',
}
_MEANT = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_FAINT = dict.fromkeys(('q', 'theta', 'encoder', 'pulse', 'pulses'), 'position')
_FAINT |= dict.fromkeys(('current', 'cur', 'i', 'load'), 'effort')
# Those that are a current. Where no unit is stated it is in A, and a constant makes it a torque.
_CURRENTS = {
    *[
        'amps',
        'cur',
        'curr',
        'current',
        'currents',
        'i',
        'iq',
        'strom',
        'corriente',
        'corrente',
        'courant',
    ]
}
# Beside a role a letter is enough: `p_des`, `t_actual`.
_LETTERS = {'p': 'position', 'v': 'velocity', 't': 'effort'}
# What a textbook calls so, where it is all of the name: to be asked, not told.
_SYMBOLS = dict.fromkeys(('x', 'q', 's', 'p', 'phi'), 'position')
_SYMBOLS |= {'v': 'velocity', 'w': 'velocity', 'f': 'effort', 'm': 'effort'}
_QUANTITIES = ('velocity', 'effort', 'position')
_ROLES = ('command', 'measured')
_WORD = re.compile(r'[A-Z]?[^\W\d_A-Z]+|[A-Z]+(?![^\W\d_A-Z])|[A-Z]|\d+')
_BESIDE = ' _-./:'
# Of which drive a row is: `joint_idx`, `motor number`.
_NUMBERING = {'idx', 'index', 'no', 'nr', 'num', 'number'}
# What parts a name from its unit where that is in no brackets.
_BEFORE_UNIT = re.compile(r'_|\s+(?:in|/)\s+|,\s+|\s+(?=\w\w|\w/)|(?<=[a-z])(?=[A-Z][A-Za-z])')
# Units, and of what is no motion and no effort, too.
_KNOWN = maps.MOTION.keys() | maps.SPEEDS.keys() | maps.EFFORT.keys() | maps.TIME_UNITS.keys()
_UNITS = _KNOWN | {
    *['1', 'v', 'mv', 'w', 'kw', 'khz', '°c', 'kg', 'bar', 'pa', 'samples', 'minutes']
}
_OWN_UNITS = ('unit', 'units')
_NO_TIME = 'a time is in s, ms, us or ns'
_NAMES_NONE = 'names no position, velocity or effort'


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

    def left_out(self, why: str) -> 'Meaning':
        """Return it as that of a column that is not read, with the reason."""
        return replace(self, joint='', quantity='', why=why)

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
    # of `pos_a` and `tau_a` the end is a joint, though one could be in A
    joints = {row.key for row in rows if row.quantity != 'time'}
    for row in (x for x in rows if (x.unit.lower(),) in joints and x.quantity != 'time'):
        row.ends()
    # A text in brackets that is no known unit tells joints apart, or is a unit unknown: no unit
    # is one of a position and of an effort, and no quantity of one joint is there in two units.
    unknown = [x for x in rows if x.open]
    for row in [x for x in unknown if any(map(x.is_beside, unknown))]:
        row.ends()
    # the effort that was asked for stands for the effort where there is no other
    if any(row.quantity == 'effort' and not row.wanted for row in rows):
        for row in (x for x in rows if x.wanted):
            row.quantity, row.why = '', 'a set-point of the effort'
    _told_by_units(rows)
    # what has a derivative there is a position: `x` beside `x_dot`
    derivatives = {row.key for row in rows if row.derivative}
    for row in rows:
        if row.why == _NAMES_NONE and row.key in derivatives:
            row.means('position')
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
    placed = [x.joint for x in out if x.quantity == 'position']
    names = placed or [*moving] or [out[n].name for n in bare]
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
    moving = {row.key for row in rows if row.quantity in ('position', 'velocity')}
    if moving:
        # a force or torque beside the motion of one joint alone is its effort: `theta, u [N m]`
        forces = [
            row for row in rows if row.why == _NAMES_NONE
            and maps.si_unit('effort', maps.plain_unit(row.unit)) in ('N m', 'N')
        ]  # fmt: skip
        if len(moving) == len(forces) == 1 and not any(row.quantity == 'effort' for row in rows):
            forces[0].means('effort')
            (forces[0].key,) = moving
        return
    silent = ((row, _of_unit(row.unit)) for row in rows if row.why == _NAMES_NONE)
    told = {row: quantity for row, quantity in silent if quantity}
    for row, quantity in told.items():
        row.means(quantity)
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
        self.text, unit, behind = _without_unit(whole)
        stated = below.strip('[]() ')
        fits = self._read(self.text, stated or unit, derived)
        # what is no unit of it is a name's end
        plain = re.sub(r'\s*[\[(<]([^\[\]()<>]*)[\])>]\s*$', r' \1', whole)
        self._end = (plain, '', derived) if behind and not stated else None
        self.open = behind and not stated and not is_unit(unit)
        if not fits:
            self.ends()

    def ends(self) -> None:
        """Take what is in no brackets, and was taken for its unit, for its end."""
        if self._end:
            self._read(*self._end)

    @property
    def asks(self) -> int:
        """How much its owner has to state: 0 for nothing, 1 perhaps, 2 a constant, 3 a scale."""
        if math.isnan(self.scale):
            return 3
        if self.quantity != 'effort':
            return 0
        plain = maps.plain_unit(self.unit)
        return 1 if not plain else 2 * (maps.si_unit('effort', plain) in ('A', 'percent'))

    def is_beside(self, other: '_Name') -> bool:
        """Return whether both are alike with other brackets, or have one bracket but no unit."""
        kinds = {x.quantity.removeprefix('command_') for x in (self, other)}
        same = self.unit == other.unit
        return len(kinds) > 1 if same else self.text == other.text

    def means(self, quantity: str) -> None:
        """Let it be a quantity that its name does not say."""
        self.quantity, self.why = quantity, ''
        known = maps.units_of(quantity)
        self.scale = known.get(maps.plain_unit(self.unit), math.nan if self.unit else 1.0)

    def _read(self, text: str, unit: str, derived: bool) -> bool:
        """Take a name without its unit apart; return whether the unit is one of its quantity."""
        self.unit, plain = unit, maps.plain_unit(unit)
        pieces = re.split(r'([/.])', text)
        parts = [_Part(x, derived) for x in pieces[::2]]
        kinds = {kind for part in parts for kind in part.kinds}
        words = [word for part in parts for word in part.plain]
        units = [x for x in (*words, plain) if x in maps.TIME_UNITS and x != 's']
        self.treated = 'treated' in kinds
        self.derivative = 'dot' in words
        role = next((x for x in _ROLES if x in kinds), '')
        # The last part that names a quantity says it; what others name is of the joint's name.
        named = [(n, x) for n, part in enumerate(parts) if (x := part.quantity(role))]
        says, quantity = named[-1] if named else (-1, '')
        # A role alone is one of a position; its unit goes before it, as before a faint word.
        self.bare = not quantity and role != '' and 'time' not in kinds
        faint = self.bare or (says >= 0 and not {*parts[says].kinds} & {*_QUANTITIES})
        quantity = 'position' if self.bare else quantity
        fits = not quantity or not is_unit(unit) or maps.factor_of(quantity, unit) is not None
        if not fits and faint:
            of = (x for x in ('position', *_QUANTITIES) if maps.factor_of(x, unit) is not None)
            if found := next(of, ''):
                fits, quantity = True, found
        if quantity == 'effort' and says >= 0 and not unit and parts[says].current:
            self.unit, plain = 'A', 'a'
        rests = [part.rest(role, quantity if n == says else '') for n, part in enumerate(parts)]
        self.quantity, self.why, self.scale = '', '', 1.0
        if 'other' in kinds:
            self.why = 'no position, velocity or effort of a drive'
        elif not quantity and ('time' in kinds or (units and {*words} <= {*units})):
            # its unit may be one of its words: `timeMs`, `stamp.nanosec`; not of 0.1 ms
            self.unit = unit or ''.join(units[:1])
            known = maps.plain_unit(self.unit) in maps.TIME_UNITS
            known &= not re.search(rf'\d\W*{re.escape(self.unit)}', text)
            told = known if self.unit else not re.search(r'[\[(<]', text)
            self.quantity, self.why = ('time', '') if told else ('', _NO_TIME)
        elif not quantity:
            self.why = _NAMES_NONE
        elif not fits:
            self.why = f'no {quantity} is in {unit}'
        else:
            self.scale = maps.units_of(quantity).get(plain, math.nan if unit else 1.0)
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

    @property
    def current(self) -> bool:
        """Whether the effort that it names is a current."""
        pairs = zip(self.plain, self.kinds, strict=True)
        strong = [word for word, kind in pairs if kind in _QUANTITIES]
        words = strong or [word for word in self.plain if word in _FAINT]
        return bool(words) and words[-1] in _CURRENTS

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
    """Return where a word is two known ones; 0 for nowhere.

    One of them is a role (`posdes`), or says the place of a whole word (`motorstrom`).
    """
    if word in _MEANT or word in _FAINT:
        return 0
    known = {**_MEANT, **_FAINT}
    for cut in range(1, len(word)):
        both = known.get(word[:cut], ''), known.get(word[cut:], '')
        whole = 'place' in both and min(cut, len(word) - cut) > 2
        if all(both) and (whole or {*both} & {*_ROLES}):
            return cut
    return 0


def _without_unit(name: str) -> tuple[str, str, bool]:
    """Return a name without its unit, that unit, and whether it may be the name's end instead.

    A unit stands in brackets, behind a _, or as in `Angle in deg`, `s / mm`, `pos, m`, `speedRpm`.
    """
    found = re.fullmatch(r'(.*\S)\s*[\[(<]([^\[\]()<>]*)[\])>]\s*', name)
    if found and found[2].strip().isdigit():
        return f'{found[1]} {found[2].strip()}', '', False
    if found and is_unit(found[2]):
        return found[1], found[2].strip(), False
    inside = [x.lower() for x in _WORD.findall(found[2])] if found else []
    # a drive's own, as `reference unit`, or of words that say nothing else
    if found and inside and (inside[-1] in _OWN_UNITS or not any(map(_MEANT.get, inside))):
        return found[1], found[2].strip(), True
    for x in _BEFORE_UNIT.finditer(name):
        before, unit = name[: x.start()], name[x.end() :]
        if maps.plain_unit(unit) in _KNOWN and _WORD.search(before):
            return before, unit, True
    return name, '', False


def of_drive(column: Meaning) -> bool:
    """Return whether a column says of which drive its row is: `motor_id`, `Axis`."""
    words = {x.lower() for x in _WORD.findall(column.name)}
    return not column.quantity and {_MEANT.get(x) for x in words - _NUMBERING} == {'place'}


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, of whatever, or made of several, as Nm/A and m/s^2."""
    parts = re.split('[/*·]', text.strip().lower())
    plain = (re.sub(r'(\^?-?\d|[²³])$', '', x.strip()) or x.strip() for x in parts)
    return maps.plain_unit(text) in _KNOWN or all(x in _UNITS for x in plain)
