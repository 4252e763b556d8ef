# SPDX-License-Identifier: Apache-2.0
"""Error codes and the one exception a user of the package sees."""

import enum


class ErrorCode(enum.IntEnum):
    """What went wrong, as a number that stays the same in files, messages and exit texts.

    The interface package's ErrorCode.msg holds the same names and numbers; a test compares them.
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
    INTERNAL = 99


class IdentError(Exception):
    """An input or state the package cannot work with.

    Args:
        code: The error's number.
        message: One sentence: what was found, where, and the remedy.
    """

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
