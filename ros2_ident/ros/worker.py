# SPDX-License-Identifier: Apache-2.0
"""One thread for the long work, and the way back into the executor's thread.

The thread never publishes: what it has to say goes through a queue, and a guard condition wakes the
executor to fetch it. So a message costs the thread nothing, nothing in rclpy is used from two
threads, and a node can be destroyed as soon as the thread has been joined.
"""

from collections.abc import Callable
import queue
import threading
import time
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.node import Node

Say = Callable[[Any], None]
Job = Callable[[threading.Event, Say], Any]


class Worker:
    """Runs one job at a time.

    Args:
        node: Whose executor is woken.
    """

    def __init__(self, node: Node) -> None:
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._guard = node.create_guard_condition(self._fetch)
        self._thread: threading.Thread | None = None
        self._cancel = threading.Event()

    @property
    def busy(self) -> bool:
        """Whether a job runs or its end has not been told yet."""
        return self._thread is not None

    def start(
        self,
        job: Job,
        on_said: Say,
        on_done: Callable[[Any, BaseException | None], None],
        *,
        rate: float = 5.0,
    ) -> None:
        """Run a job in the thread.

        Args:
            job: Gets the cancel event and a function that tells what it has to say.
            on_said: Gets that, in the executor's thread, at most `rate` times a second.
            on_done: Gets the job's value or its exception, in the executor's thread.
            rate: Most messages per second, Hz.
        """
        if self.busy:
            raise RuntimeError('the worker is busy')
        self._cancel = cancel = threading.Event()
        interval, last = 1.0 / rate, -1e9
        unsaid: list[Any] = []

        def say(what: Any) -> None:
            nonlocal last
            now = time.monotonic()
            unsaid[:] = [what]
            if now - last >= interval:
                last = now
                unsaid.clear()
                self._post(lambda: on_said(what))

        def finish(value: Any, error: BaseException | None) -> None:
            self._thread = None
            on_done(value, error)

        def run() -> None:
            value, error = None, None
            try:
                value = job(cancel, say)
            except Exception as exc:  # whatever it is, the user hears of it
                error = exc
            if unsaid:
                self._post(lambda: on_said(unsaid[0]))
            self._post(lambda: finish(value, error))

        # a daemon: a job that does not heed its cancel event cannot keep the process alive
        self._thread = threading.Thread(target=run, name='identify', daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """Ask the job to end with the best so far."""
        self._cancel.set()

    def join(self, timeout: float) -> bool:
        """Wait for the thread; return whether it ended. What it said last is fetched."""
        thread = self._thread
        if thread is not None:
            thread.join(timeout)
            if thread.is_alive():
                return False
            self._fetch()
        return True

    def _post(self, event: Callable[[], None]) -> None:
        self._queue.put(event)
        try:
            self._guard.trigger()
        except (InvalidHandle, RCLError):
            pass  # the node is gone; whoever joins the thread fetches the rest

    def _fetch(self) -> None:
        while True:
            try:
                event = self._queue.get_nowait()
            except queue.Empty:
                return
            event()
