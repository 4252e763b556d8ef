# SPDX-License-Identifier: Apache-2.0
"""Layout of a table, or of arrays, and its column map: by the names there, and by options."""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
import csv
from dataclasses import dataclass, replace
import io
from itertools import chain, islice
import math
from os.path import commonprefix
from pathlib import Path
import re
import shlex

from ros2_ident.errors import ErrorCode
from ros2_ident.recording import columns as maps
from ros2_ident.recording.limits import listed, printable, short
from ros2_ident.recording.names import is_unit, Meaning, meanings, of_drive
from ros2_ident.recording.table import array_sizes, ARRAYS, is_number, text_of

# Units of a time by what one of it is in s.
_SECONDS = {1.0: 's', 1e-3: 'ms', 1e-6: 'us', 1e-9: 'ns'}
# Lines that are looked at.
_HEAD = 200
_HOLDS_WORDS = 'holds words'
_LONG = (
    'holds one value a row; make it a table with a column for each of its quantities, as by the '
    'pivot of pandas'
)
_EXPORT = 'export it with names and one common time'
_TIMES = f'time for each channel; {_EXPORT}, or interpolate to one'
_LYING = (
    '{} rows of {} numbers, as with a row for each quantity; turn it over, so that each time has '
    'a row'
)
_NO_ROWS = 'it has no row of numbers for each time'


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
    below: int  # lines between the names and the values
    named: bool = True  # whether a line of names is there; else numbers stand for them
    words: str = ''  # said where what lacks is in a column of words
    rate: float = 0.0  # rows per second where they have no time, Hz
    stated: tuple[str, ...] = ()  # joints of options, in their order, which is that of the map

    def map(self) -> dict[str, object]:
        """Return the column map as a YAML mapping."""
        there = {x.joint for x in self.columns}
        joints: dict[str, dict[str, object]] = {x: {} for x in self.stated if x in there}
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
        below = {'skip_below': self.below} if self.named else {'header': False}
        return {'time': time, 'joints': joints} | layout | below

    def timed(self, rate: float) -> 'Header':
        """Return the header of rows that follow each other at a rate, Hz; 0 for their own time."""
        if not rate:
            return self
        columns = (
            x.left_out('the rate is stated') if x.quantity == 'time' else x for x in self.columns
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
        stated = set[int]()
        for text in given:
            name, joint, quantity, factor = _option(text)
            scale = math.nan
            with suppress(ValueError):
                scale = float(factor or 1.0)
            known = bool(joint) and quantity in maps.QUANTITIES
            unit = _SECONDS.get(scale, '') if (joint, quantity) == ('', 'time') else ''
            at = names.index(name) if names.count(name) == 1 else -1
            if name.isdecimal() and name not in names:
                at = int(name) - 1 if int(name) <= len(names) else -1
            if at < 0 or not (known or unit) or not math.isfinite(scale) or not scale:
                form = 'write NAME=JOINT.QUANTITY, NAME=JOINT.QUANTITY*SCALE or NAME=time (of ms, '
                form += 'time*1e-3), with a quantity of '
                able = f'{", ".join(maps.QUANTITIES)} and a column of {listed(names, 30)}'
                able += ', by its number where several are called alike'
                raise ErrorCode.INVALID_GOAL.error(f'--column {short(text)}: {form}{able}')
            before = columns[at]
            if unit:
                before = replace(before, unit=unit)
            for n, x in enumerate(columns):
                if before.quantity == quantity and x.joint == before.joint:
                    columns[n] = x = replace(x, joint=joint)  # as its other columns
                if (x.joint, x.quantity) == (joint, quantity):
                    columns[n] = x.left_out('another column was given for it')
            stated.add(at)
            columns[at] = Meaning(
                names[at], joint, quantity, before.unit, scale, stated=bool(factor)
            )
        moving = dict.fromkeys(x.joint for x in columns if x.quantity in ('position', 'velocity'))
        for n, x in enumerate(columns):
            if x.quantity != 'effort' or not moving or x.joint in moving:
                continue
            if n in stated:
                text = f'--column: {short(x.name)} is to be the effort of {short(x.joint)}, which '
                text += f'no column moves; write one of {listed(moving, 30)}'
                raise ErrorCode.INVALID_GOAL.error(text)
            columns[n] = x.left_out(f'no column says how {short(x.joint)} moves')
        joints = filter(None, (_option(text)[1] for text in given))
        return replace(self, columns=tuple(columns), stated=tuple(dict.fromkeys(joints)))

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
        """Return the header without joints that have no effort and no set-point beside such.

        Poses of a tool are such. Those of columns that are `given`, as to `assigned`, and those
        `named` stay.
        """
        of: dict[str, set[str]] = {}
        for x in self.columns:
            of.setdefault(x.joint, set()).add(x.quantity)
        idle = {x for x, kinds in of.items() if kinds <= {'position', 'velocity'}}
        if idle == of.keys() - {''}:
            return self
        idle -= {*named, *(_option(text)[1] for text in given)}
        columns = (
            x.left_out(f'no effort and no set-point of {short(x.joint)}') if x.joint in idle else x
            for x in self.columns
        )
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
        if lost := [x.name for x in self.columns if x.why == _NO_ROWS]:
            text += f', of which {listed(lost, 20)} has no row of numbers for each time'
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
                rest = '; by 1 masses and friction come divided by it' * asked
                raise ErrorCode.INVALID_GOAL.error(f'{text}: --column {option}{rest}')


def header_of(path: Path) -> Header:
    """Return the layout of a table, or of a file of arrays, and its columns by their names.

    Raises:
        IdentError: INVALID_GOAL where the table holds words only, one value a row, a row for each
            quantity, or a time for each channel.
    """
    if path.is_dir() or path.suffix.lower() in ARRAYS:
        return _of_arrays(path)
    lines = list(islice(io.StringIO(text_of(path), newline=''), _HEAD))
    bottom = [line for line in lines if line.strip()][-3:]
    delimiter = _delimiter(bottom)
    decimal = ',' if delimiter != ',' and re.search(r'\d,\d', ''.join(bottom)) else '.'
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    try:
        rows = [[x.strip() for x in row] for row in reader]
    except csv.Error as exc:
        text = f'{path}: its first lines cannot be read ({exc}); correct them'
        raise ErrorCode.BAD_VALUES.error(text) from None
    rows = [row[:-1] if row and not row[-1] and delimiter == ' ' else row for row in rows]
    # Among more words than numbers a row holds values where it is like the last one.
    last = [is_number(x, decimal) for x in next(filter(any, reversed(rows)), [])]
    held = []
    for number, row in enumerate(rows):
        known = [is_number(x, decimal) for x in row]
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
    # Each line of a block of properties begins anew before each channel, or each group of them;
    # below one the column of its names is empty.
    again = Counter(tuple(n for n, x in enumerate(row) if x == row[0] != '') for row in above)
    grouped = any(len(at) > 1 and n > 1 for at, n in again.items())
    nameless = bool(above) and not wide and not any(row[0] for row in values)
    if grouped:
        raise maps.refuse(path, f'has a block of properties above a {_TIMES}')
    if nameless or (held and last[0] and not is_number(values[0][0] or '0', decimal)):
        where = f', or write {path.stem}{maps.MAP_SUFFIX}, as in docs/logs.md' * (not nameless)
        raise maps.refuse(path, f'has a block of properties above its values; {_EXPORT}{where}')
    if not wide:
        if not held:
            said = 'is empty; record again'
            ends = [row for row in rows if row and is_number(row[-1], decimal)]
            if len(ends) > 1 and 2 * len({row[0] for row in ends}) <= len(ends) == len(rows):
                said = _LONG
            elif len(rows) > 1:
                said = _wordy(zip(rows[0], rows[1], strict=False), decimal)
            raise maps.refuse(path, said)
        if usual > len(rows):  # fewer times than quantities
            raise maps.refuse(path, _LYING.format(f'has {len(rows)}', usual))
        said = 'no line of names above its numbers'
        if any(filter(None, above[-1:])):
            said = f'{usual} columns and {len(above[-1])} of names, {listed(above[-1])}'
        columns = [Meaning(str(n + 1), why=said) for n in range(usual)]
        at = (tuple(columns), tuple(range(1, usual + 1)))
        return Header(*at, delimiter, decimal, first, 0, named=False)
    # Of several lines the one that tells most holds the names, the lowest of such; units may
    # follow, and what a device writes beside them, as its addresses.
    of_units = [n for n in wide[1:] if _units(above[n])]
    named = [n for n in wide if n not in of_units]
    top = max(named, key=lambda n: (sum(bool(x.quantity) for x in meanings(above[n])), n))
    units = next((above[n] for n in of_units if n > top), [])
    names = above[top]
    # pandas tells names apart that stand there again, as those of a time for each channel
    again_at = [n for n, x in enumerate(names) if n and re.sub(r'\.\d+$', '', x) == names[0] != '']
    if any(row[n] != row[0] for row in values for n in again_at):
        raise maps.refuse(path, f'has a {_TIMES}')
    below = list(zip(*values, strict=True))
    wordy = [n for n, x in enumerate(below) if not all(is_number(y, decimal) for y in x if y)]
    columns = meanings(['' if n in wordy else name for n, name in enumerate(names)], units)
    for n in wordy:
        columns[n] = Meaning(names[n], why=_HOLDS_WORDS)
    for n in again_at:
        columns[n] = columns[n].left_out('the first column again')
    _require_wide(path, columns, values)
    unread = meanings(names)
    told = next((n for n in wordy if unread[n].quantity), None)
    words = '' if told is None else _wordy(((names[told], x) for x in below[told]), decimal)
    unique = {x for x in names if x and names.count(x) == 1 and names is rows[top]}
    cells = tuple(x if x in unique else n for n, x in enumerate(names, 1))
    return Header(tuple(columns), cells, delimiter, decimal, top, first - top - 1, words=words)


def _units(row: Sequence[str]) -> bool:
    """Return whether most cells of a line that are not empty are units."""
    told = [is_unit(x.strip('[]()')) for x in row if x]
    return 2 * sum(told) >= len(told) > 0


def _delimiter(lines: Sequence[str]) -> str:
    """Return what cuts lines of a table into numbers; a blank only into nothing else."""

    def share(mark: str) -> tuple[float, int]:
        parts = [x for line in lines for x in line.split(None if mark == ' ' else mark)]
        cells, decimal = [x.strip(' \r\n"') for x in parts], '.' if mark == ',' else ','
        read = [is_number(x, '.') or is_number(x, decimal) for x in cells]
        told = sum(read) / max(1, len(read)) if mark != ' ' or all(read) else -1.0
        return told, sum(line.count(mark) for line in lines)

    there = [x for x in ',;\t' if any(x in line for line in lines)]
    return max([*there, ' '], key=share)


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
    lying = [x for x in each if sizes[x][1] > rows]
    if lying and len(lying) == len(each):  # as Simulink writes a signal to a file
        shown = f'holds {short(lying[0])} of {rows}'
        raise maps.refuse(path, _LYING.format(shown, sizes[lying[0]][1]))
    cells = [x for name in each for x in each[name]]
    # The structure or group that all lie in is none of a joint.
    within = re.match('(.*[./])?', commonprefix([*each]))
    begin = within.end() if within else 0
    read = zip(meanings([x[begin:] for x in cells]), cells, strict=True)
    columns = [replace(x, name=cell) for x, cell in read]
    others = [x for x in sizes if x not in each]
    columns += [Meaning(x, why=_NO_ROWS) for x in others]
    return Header(tuple(columns), (*cells, *others), '', '.', 0, 0)


def _require_wide(path: Path, columns: Sequence[Meaning], values: Sequence[Sequence[str]]) -> None:
    """Refuse a table with a row for each quantity or joint instead of one for each time."""
    words = [n for n, x in enumerate(columns) if x.why == _HOLDS_WORDS]
    others = [x for x in columns if x.why != _HOLDS_WORDS and x.quantity != 'time' and x.name]
    times = [n for n, x in enumerate(columns) if x.quantity == 'time'][:1]
    if words and len(others) == 1 and not others[0].quantity:
        raise maps.refuse(path, _LONG)
    held = [{row[n] for row in values} for n in range(len(columns))]
    few = [n for n, x in enumerate(held) if 1 < len(x) <= len(values) / 2]
    # What says whose row it is: words beside times that repeat, or the number of a drive.
    kinds = [n for n in words if n in few and {*times} & {*few}]
    kinds += [n for n in few if of_drive(columns[n]) and all(x.isdigit() for x in held[n])]
    if kinds:
        name, shown = columns[kinds[0]].name, listed(sorted(held[kinds[0]]), 5)
        text = f'holds rows of several drives or quantities, by {short(name)}: {shown}; write a '
        raise maps.refuse(
            path, f'{text}column map that chooses one by `where`, as in docs/logs.md'
        )


def _wordy(cells: Iterable[tuple[str, str]], decimal: str) -> str:
    """Return which of some cells, each after its column's name, holds words: one does."""
    name, cell = next(x for x in cells if x[1] and not is_number(x[1], decimal))
    said = f'holds words where numbers belong, {short(cell)} below {short(name)}: write numbers '
    return f'{said}alone, a time in s from any instant and units in the names'
