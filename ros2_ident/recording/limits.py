# SPDX-License-Identifier: Apache-2.0
"""How much of a machine a log may take: what is claimed in a file is held against these."""

from collections.abc import Iterable, Sequence
import os

from ros2_ident.errors import ErrorCode

_MIB = 1 << 20
# Each limit, and the unit in which an environment variable overrides it, as docs/logs.md lists.
_USUAL = {
    'chunk': (128, _MIB),  # bytes that one compressed block or message may unpack to
    'unpacked': (16384, _MIB),  # bytes that a file compressed as a whole may unpack to on the disk
    'ratio': (500, 1),  # how many times larger than the file all its blocks together may become
    'memory': (8192, _MIB),  # bytes of values in memory
    'joints': (1000, 1),  # joint names, and different sets of them, on one topic
    'name': (256, 1),  # bytes of a joint's name
}


def limit(name: str) -> int:
    """Return a limit by its name.

    Raises:
        IdentError: INVALID_GOAL where its environment variable is no positive whole number.
    """
    usual, unit = _USUAL[name]
    text = os.environ.get(variable_of(name), str(usual))
    if not text.isdecimal() or not int(text[:12]) > 0 or len(text) > 12:
        said = f'{variable_of(name)} is {text[:40]!r}; give a positive whole number'
        raise ErrorCode.INVALID_GOAL.error(said)
    return int(text) * unit


def total_of(size: int) -> int:
    """Return the bytes to which all blocks of a file of `size` bytes may unpack."""
    return max(256 * _MIB, limit('ratio') * size)


def require_memory(what: str, size: float) -> None:
    """Refuse values that would take too many bytes of memory.

    Args:
        what: The subject of the sentence, with what it does, as `x: its grid takes`.

    Raises:
        IdentError: BAD_VALUES with the remedy.
    """
    if size > (most := limit('memory')):
        text = f'{what} {size_text(size)} of memory, more than the {size_text(most)} allowed'
        remedy = f'correct the stamps or cut the log, or raise {variable_of("memory")} (MiB)'
        raise ErrorCode.BAD_VALUES.error(f'{text}; {remedy}')


def variable_of(name: str) -> str:
    """Return the environment variable of a limit."""
    return f'ROS2_IDENT_MAX_{name.upper()}'


def size_text(size: float) -> str:
    """Return a number of bytes for a sentence."""
    for unit in ('bytes', 'KiB', 'MiB'):
        if size < 1024:
            return f'{size:.3g} {unit}'
        size /= 1024
    return f'{size:.4g} GiB'


def unfit(name: object) -> str:
    """Return why what is read cannot be a joint's name, and the remedy; empty where it can."""
    # YAML's no, null and 1.5; Python prints no number of thousands of digits
    if type(name) not in (str, int) or isinstance(name, int) and name.bit_length() > 64:
        return 'which is no text; put it into quotes'
    name = str(name)
    size, most = len(name.encode(errors='replace')), limit('name')
    if size > most:
        text = f'whose {size} bytes are more than the {most} allowed'
        return f'{text}; shorten it, or raise {variable_of("name")}'
    if not name.isprintable():
        return 'which holds a line break or another control character; rename the joint'
    return '' if name.strip() else 'which is blank; name the joint'


def printable(text: str, limit: int = 200) -> str:
    """Return a text with all that is not printable escaped, cut off after `limit` characters."""
    if not text.isprintable():
        text = ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: limit + 1])
    return text if len(text) <= limit else text[: limit - 1] + '…'


def short(value: object) -> str:
    """Return a value as it may be shown in a sentence."""
    try:
        return printable(repr(value), 60)
    except (ValueError, RecursionError):  # a number of thousands of digits, nested without end
        return 'a value that cannot be shown'


def listed(texts: Iterable[str], most: int = 12) -> str:
    """Return at most so many texts as a list for a sentence, with the number of those left out."""
    return enumerated([printable(x, 80) for x in texts], most)


def likewise(subjects: Iterable[str]) -> str:
    """Return further subjects of which a sentence holds, in brackets; empty for none."""
    names = ', '.join(dict.fromkeys(subjects))
    return f' (likewise {names})' if names else ''


def enumerated(names: Sequence[str], most: int) -> str:
    """Return names of our own as such a list, whole."""
    shown = ', '.join(names[:most])
    return shown if len(names) <= most else f'{shown} and {len(names) - most} more'
