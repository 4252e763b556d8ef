# SPDX-License-Identifier: Apache-2.0
"""Texts made fit to be shown: one line, bounded, without control sequences."""

from collections.abc import Iterable, Sequence


def printable(text: str, limit: int = 200) -> str:
    """Return a text with all that is not printable escaped, as a terminal may be shown it.

    Args:
        text: Anything.
        limit: Characters after which it is cut off with an ellipsis.
    """
    if not text.isprintable():
        text = ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: limit + 1])
    return text if len(text) <= limit else text[: limit - 1] + '…'


def listed(texts: Iterable[str], most: int = 12) -> str:
    """Return texts as a list for a sentence, with the number of those left out.

    Args:
        most: Entries shown.
    """
    return enumerated([printable(x, 80) for x in texts], most)


def enumerated(names: Sequence[str], most: int) -> str:
    """Return names of our own as such a list, whole."""
    shown = ', '.join(names[:most])
    return shown if len(names) <= most else f'{shown} and {len(names) - most} more'
