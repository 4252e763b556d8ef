# SPDX-License-Identifier: Apache-2.0
"""Texts out of files made fit to be shown: one line, bounded, without control sequences."""

from collections.abc import Iterable


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
        texts: What to list.
        most: Entries shown.
    """
    every = list(texts)
    shown = ', '.join(printable(x, 80) for x in every[:most])
    return shown if len(every) <= most else f'{shown} and {len(every) - most} more'
