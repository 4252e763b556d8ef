# SPDX-License-Identifier: Apache-2.0
"""How much of a machine a log may take: what is claimed in a file is held against these."""

from dataclasses import dataclass, fields
import os

from ros2_ident.errors import ErrorCode, IdentError

_MIB = 1 << 20
_PREFIX = 'ROS2_IDENT_MAX_'
# Limits that are counts; the others are bytes, and MiB in the environment.
_COUNTS = ('joints', 'name', 'ratio')


@dataclass(frozen=True)
class Limits:
    """Limits of reading, each overridden by an environment variable as docs/logs.md lists them.

    Attributes:
        chunk: Bytes that one compressed block or message may unpack to.
        unpacked: Bytes that a file compressed as a whole may unpack to on the disk.
        ratio: How many times larger than the file all its blocks together may become; files of
            less than 256 MiB unpacked are let pass.
        memory: Bytes of values in memory.
        joints: Joint names, and different sets of them, on one topic.
        name: Characters of a joint's name.
    """

    chunk: int = 128 * _MIB
    unpacked: int = 16384 * _MIB
    ratio: int = 500
    memory: int = 8192 * _MIB
    joints: int = 1000
    name: int = 256

    @classmethod
    def from_environment(cls) -> 'Limits':
        """Return the limits with what the environment overrides.

        Raises:
            IdentError: INVALID_GOAL where a variable is no positive whole number.
        """
        found: dict[str, int] = {}
        for field in fields(cls):
            variable = variable_of(field.name)
            text = os.environ.get(variable)
            if text is None:
                continue
            if not text.isdecimal() or not int(text[:12]) > 0 or len(text) > 12:
                raise IdentError(
                    ErrorCode.INVALID_GOAL,
                    f'{variable} is {text[:40]!r}; give a positive whole number',
                )
            found[field.name] = int(text) * (1 if field.name in _COUNTS else _MIB)
        return cls(**found)

    def total(self, size: int) -> int:
        """Return the bytes to which all blocks of a file of `size` bytes may unpack."""
        return max(256 * _MIB, self.ratio * size)

    def require_memory(self, what: str, size: float) -> None:
        """Refuse values that would take too much memory.

        Args:
            what: The subject of the sentence, with what it does, as `x: its grid takes`.
            size: Bytes.

        Raises:
            IdentError: BAD_VALUES with the remedy.
        """
        if size > self.memory:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{what} {size_text(size)} of memory, more than the {size_text(self.memory)} '
                'allowed; correct the stamps or cut the log, or raise '
                f'{variable_of("memory")} (MiB)',
            )


def variable_of(name: str) -> str:
    """Return the environment variable of a limit."""
    return _PREFIX + name.upper()


def size_text(size: float) -> str:
    """Return a number of bytes for a sentence."""
    for unit in ('bytes', 'KiB', 'MiB'):
        if size < 1024:
            return f'{size:.3g} {unit}'
        size /= 1024
    return f'{size:.4g} GiB'
