# SPDX-License-Identifier: Apache-2.0
"""One thread for the long work, and the way back into the executor's thread.

The thread never publishes: what it has to say goes through a queue, and a guard condition wakes
the executor to fetch it. So a message costs the thread nothing, nothing in rclpy is used from two
threads, and a node can be destroyed as soon as the thread has been joined.
"""

from collections import deque
from collections.abc import Callable
import contextlib
import os
import queue
import threading
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.clock import Clock
from rclpy.node import Node

from ros2_ident.threads import give_back_memory

# As `nice` does by default.
NICE = 10

Say = Callable[[Any], None]
Job = Callable[[threading.Event, Say], Any]
Done = Callable[[Any, BaseException | None], None]


class Worker:
    """Runs one job at a time, and chores between them.

    Attributes:
        busy: Whether a job runs or its end has not been told yet; chores do not count.
    """

    def __init__(self, node: Node, clock: Clock) -> None:
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._guard = node.create_guard_condition(self._fetch)
        self._cancel = threading.Event()
        self.busy = False
        self._utter: Callable[[], None] = lambda: None
        self._timer = node.create_timer(1.0, lambda: self._utter(), clock=clock)
        self._timer.cancel()
        # a daemon: a job that does not heed its cancel event cannot keep the process alive
        self._thread = threading.Thread(target=self._live, name='identify', daemon=True)
        self._thread.start()

    def start(self, job: Job, on_said: Say, on_done: Done, *, rate: float = 5.0) -> None:
        """Run a job in the thread.

        Args:
            job: Gets the cancel event and a function that tells what it has to say.
            on_said: Gets that in the executor's thread, `rate` times a second and at the end.
            on_done: Gets the job's value or its exception, in the executor's thread.
            rate: Most messages per second, Hz.
        """
        if self.busy:
            raise RuntimeError('the worker is busy')
        self.busy = True
        self._cancel = cancel = threading.Event()
        unsaid: deque[Any] = deque(maxlen=1)

        def utter() -> None:
            if unsaid:
                on_said(unsaid.popleft())

        def finish(value: Any, error: BaseException | None) -> None:
            self.busy = False
            self._timer.cancel()
            on_done(value, error)

        def work() -> None:
            value, error = attempt(lambda: job(cancel, unsaid.append))
            self.post(utter)
            self.post(lambda: finish(value, error))

        self._utter = utter
        self._timer.timer_period_ns = round(1e9 / rate)
        self._timer.reset()
        self._work.put(work)

    def chore(self, task: Callable[[], Any], on_done: Done) -> None:
        """Do something short in the thread when its turn comes; a job may be started meanwhile."""

        def work() -> None:
            value, error = attempt(task)
            self.post(lambda: on_done(value, error))

        self._work.put(work)

    def cancel(self) -> None:
        """Ask the job to end with the best so far."""
        self._cancel.set()

    def join(self, timeout: float) -> bool:
        """End the thread after its work; return whether it ended. What it said is fetched."""
        self._work.put(None)
        self._thread.join(timeout)
        self._fetch()
        return not self._thread.is_alive()

    def _live(self) -> None:
        # Linux keeps a niceness for each thread, and the threads that simulate inherit this one:
        # where all processors are busy, the thread that receives messages goes first.
        with contextlib.suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (work := self._work.get()) is not None:
            work()
            if self._work.empty():
                give_back_memory()

    def post(self, event: Callable[[], None]) -> None:
        """Have something done in the executor's thread; for a job that has more to give."""
        self._events.put(event)
        # the node may be gone; the joining thread fetches the rest
        with contextlib.suppress(InvalidHandle, RCLError):
            self._guard.trigger()

    def _fetch(self) -> None:
        failed: Exception | None = None
        while True:
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                break
            try:
                event()
            except Exception as error:  # what comes after it is told all the same
                failed = failed or error
        if failed is not None:
            raise failed


def attempt(task: Callable[[], Any]) -> tuple[Any, BaseException | None]:
    """Return what a task returns, or what it raises."""
    try:
        return task(), None
    except Exception as error:  # whatever it is, the user hears of it
        return None, error
