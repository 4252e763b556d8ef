# SPDX-License-Identifier: Apache-2.0
"""Values of a machine file as shown in a sentence: short, and without escapes."""

import reprlib
from typing import Any

_SHORT = reprlib.Repr()
_SHORT.maxstring, _SHORT.maxother = 120, 120


def shown(value: Any) -> str:
    """Return a value as Python writes it, at most some hundred characters of it."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # a whole number that Python does not print
        return 'a number of thousands of digits'


def name_of(value: Any) -> str:
    """Return a name as it is, where that can be shown."""
    text = value if isinstance(value, str) else shown(value)
    return text if text.isprintable() and len(text) <= _SHORT.maxstring else shown(text)
