# SPDX-License-Identifier: Apache-2.0
"""The catalogue of errors, and the one exception a user of the package sees."""

import enum


class ErrorCode(enum.IntEnum):
    """Kind of an error, as a number that stays the same in files, messages and exit texts.

    The interface package's ErrorCode.msg holds the same names and numbers; docs/errors.md says
    what each means and what to do. The sentence beside a code says it in particular.
    """

    OK = 0
    INVALID_GOAL = 1
    NO_DATA = 2
    MISSING_STREAM = 3
    DAMAGED_BAG = 4
    BAD_VALUES = 5
    UNKNOWN_MODEL = 6
    UNKNOWN_PARAMETER = 7
    BUSY = 8
    CANCELLED = 9
    DIVERGED = 10
    BAD_MACHINE_FILE = 11
    WRONG_UNITS = 12
    NOT_IDENTIFIABLE = 13
    CONTRADICTED = 14
    INTERNAL = 99

    @property
    def exit_code(self) -> int:
        """Exit code of `ident`: 1 where a run is not good, 2 for wrong input, 3 for a defect."""
        return _EXIT_CODES.get(self, 2)

    def error(self, message: str) -> 'IdentError':
        """Return an error of this kind; its message is as of `IdentError`."""
        return IdentError(self, message)

    def at(self, where: object, text: str) -> 'IdentError':
        """Return an error of this kind whose sentence begins with where it is: a file, say."""
        return IdentError(self, f'{where}: {text}')


# After a cancel and the like there is a result all the same.
_EXIT_CODES = {
    ErrorCode.OK: 0,
    ErrorCode.CANCELLED: 1,
    ErrorCode.DIVERGED: 1,
    ErrorCode.NOT_IDENTIFIABLE: 1,
    ErrorCode.CONTRADICTED: 1,
    ErrorCode.INTERNAL: 3,
}


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
