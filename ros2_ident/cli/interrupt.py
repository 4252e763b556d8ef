# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C ends a run and keeps what it found; a second one ends the process."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
import signal
import threading
from types import FrameType


@contextmanager
def interrupts() -> Iterator[threading.Event]:
    """Give an event that SIGINT and SIGTERM set while the block runs."""
    event = threading.Event()

    def stop(number: int, frame: FrameType | None) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()
        # The signal may have come in the middle of a `print`, which cannot be entered twice.
        os.write(2, b'stopping; the best so far is kept\n')

    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
