# SPDX-License-Identifier: Apache-2.0
"""The catalogue of errors, and the one exception a user of the package sees."""

import enum
from typing import Self


class ErrorCode(enum.IntEnum):
    """Kind of an error, as a number that stays the same in files, messages and exit texts.

    The interface package's ErrorCode.msg holds the same names and numbers, docs/errors.md the same
    words; tests compare them.

    Attributes:
        meaning: What was found, in general; the sentence beside a code says it in particular.
        remedy: What to do about it, in general.
        exit_code: What `ident` ends with: 1 done and not good, 2 wrong use or bad input, 3 a
            defect.
    """

    meaning: str
    remedy: str
    exit_code: int

    def __new__(cls, number: int, meaning: str, remedy: str, exit_code: int = 2) -> Self:
        """Make a member whose value is its number."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.meaning = meaning
        member.remedy = remedy
        member.exit_code = exit_code
        return member

    OK = 0, 'Nothing went wrong.', 'Nothing is to be done.', 0
    INVALID_GOAL = (
        1,
        'What was asked for contradicts itself, or names a drive, directory or range that cannot '
        'be.',
        'Correct the option or the field of the goal that the sentence names.',
    )
    NO_DATA = (
        2,
        'There is nothing to work on: no bag at that path, no message on the topics, too few '
        'samples.',
        'Check path and topics with `ident check`; record a longer motion.',
    )
    MISSING_STREAM = (
        3,
        'A stream or a drive that the model needs is not in the data.',
        'Record it, or name it: `--effort-topic`, and `drives` in the machine file.',
    )
    DAMAGED_BAG = (
        4,
        'The bag cannot be read, not even in part.',
        'Copy it again from where it was recorded, or record anew.',
    )
    BAD_VALUES = (
        5,
        'Values are NaN, infinite, of the wrong shape, or all the same.',
        'Look at the stream that the sentence names; switch its measurement on.',
    )
    UNKNOWN_MODEL = (
        6,
        'The kind of machine is not known, or has no model for this use.',
        'Write one of the kinds that the sentence lists in the line `machine:`.',
    )
    UNKNOWN_PARAMETER = (
        7,
        'A parameter or effect of this name is not known.',
        'Choose from the names that the sentence lists.',
    )
    BUSY = (
        8,
        'The node is at work on another goal.',
        'Wait for its result, or cancel it.',
    )
    CANCELLED = (
        9,
        'The run was stopped on request.',
        'The best so far is in the result; ask again for all of it.',
        1,
    )
    DIVERGED = (
        10,
        'No candidate within the bounds could be simulated.',
        'Check units, gains and geometry in the machine file, then its bounds.',
        1,
    )
    BAD_MACHINE_FILE = (
        11,
        'The machine file cannot be read, or a key in it is missing, unknown or no number.',
        'Change the line that the sentence names; `ident check --machine FILE` lists them all.',
    )
    WRONG_UNITS = (
        12,
        'A unit is not known, lacks its constant, or is not the one the package works in.',
        'State `effort_unit` with its constant; give bounds in the unit that the sentence names.',
    )
    NOT_IDENTIFIABLE = (
        13,
        'The data leave at least one parameter undetermined; from the node: all of them.',
        'Record a motion with acceleration, reversals and different speeds, or fix parameters.',
        1,
    )
    CONTRADICTED = (
        14,
        'The log contradicts the machine file, or the model does not fit the log.',
        'Write the number that the sentence gives, or correct the topic or the model it names.',
        1,
    )
    INTERNAL = (
        99,
        'A defect of this package.',
        'Report it with the text printed above the sentence.',
        3,
    )


class IdentError(Exception):
    """An input or state the package cannot work with.

    Args:
        code: The error's number.
        message: One sentence: what was found, where, and the remedy. What a terminal would not
            print but obey, in a name or a path, becomes its escape.
    """

    def __init__(self, code: ErrorCode, message: str) -> None:
        if not message.isprintable():
            message = ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in message)
        super().__init__(message)
        self.code = code
        self.message = message

    def __reduce__(self) -> 'tuple[type[IdentError], tuple[ErrorCode, str]]':
        """Pickle with both arguments, so that an error comes back whole from a worker."""
        return IdentError, (self.code, self.message)
