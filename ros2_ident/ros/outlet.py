# SPDX-License-Identifier: Apache-2.0
"""Output of the node: its publishers, its state in words, and the pages on its runs."""

from collections import deque
from collections.abc import Iterable, Sequence
import itertools
from pathlib import Path
import shlex
import subprocess
import sys
import traceback
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros2_ident_msgs.msg import Comparison, Gap, IdentificationResult, Progress, Status
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from ros2_ident.errors import ErrorCode, IdentError

LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
EVENTS, SERIES = 10, 5000  # depths
# Messages of a series in one go: about a millisecond.
_PIECE = 100
# Pages that wait: some minutes of work.
_MOST_PAGES = 100
# The process goes behind everything else, as the worker does.
_REPORT = ['nice', '-n', '10', sys.executable, '-m', 'ros2_ident.cli.main', 'report']


class Outlet:
    """The publishers of a node, and long series in pieces that keep it responsive."""

    def __init__(self, node: Node, clock: Clock) -> None:
        self.progress = node.create_publisher(Progress, '~/progress', EVENTS)
        self.result = node.create_publisher(IdentificationResult, '~/result', LATCHED)
        self.gap = node.create_publisher(Gap, '~/gap', LATCHED)
        self.comparison = node.create_publisher(Comparison, '~/comparison', LATCHED)
        self.status = node.create_publisher(Status, '~/status', LATCHED)
        self.scene = node.create_publisher(MarkerArray, '~/scene', LATCHED)
        self.diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', EVENTS)
        self._series = [
            node.create_publisher(JointState, name, SERIES)
            for name in ('~/simulated', '~/residual')
        ]
        self._waiting: deque[tuple[Any, Iterable[bytes]]] = deque()
        self._timer = node.create_timer(0.01, self._go_on, clock=clock)
        self._timer.cancel()

    def series(self, *messages: Iterable[bytes]) -> None:
        """Publish simulated and residual effort, serialised, instead of those still waiting."""
        self._waiting = deque(zip(self._series, map(iter, messages), strict=True))
        self._timer.reset()

    def _go_on(self) -> None:
        publisher, messages = self._waiting.popleft()
        piece = list(itertools.islice(messages, _PIECE))
        for message in piece:
            publisher.publish(message)
        if len(piece) == _PIECE:
            self._waiting.append((publisher, messages))
        if not self._waiting:
            self._timer.cancel()


class Board:
    """The node's state, one of the message's and in words, on ~/status and in the log."""

    def __init__(self, node: Any) -> None:
        self.state: int = Status.STATE_WAITING
        self.sentence = 'no data yet'
        self._error: IdentError | None = None
        self._stumbled: set[str] = set()
        self._node = node
        self._log = node.get_logger()

    def change(self, state: int, sentence: str, error: IdentError | None = None) -> None:
        """Enter a state."""
        self.state = state
        self.sentence = sentence
        self._error = error
        if error is not None and error.code != ErrorCode.CANCELLED:
            self._log.error(sentence)  # rclpy allows one severity a line
        else:
            self._log.info(sentence)
        self.publish()

    def warn(self, sentence: str) -> None:
        """Say something else in the same state, once."""
        if sentence != self.sentence:
            self._log.warning(sentence)
            self.sentence = sentence
            self.publish()

    def refuse(self, error: IdentError) -> None:
        """Say why a goal was refused, without touching what runs."""
        self._log.warning(error.message)
        self._error = error
        self.publish()

    def fault(self, error: BaseException) -> IdentError:
        """Return what the user is told; what is no user's error goes to the log in full."""
        if isinstance(error, IdentError):
            return error
        text = ''.join(traceback.format_exception(error))
        self._log.error(f'a defect of this package:\n{text}')
        return ErrorCode.INTERNAL.error(
            f'a defect of this package ended the run ({type(error).__name__}: {error}); '
            'please report it with the log'
        )

    def stumbled(self, error: BaseException) -> None:
        """Log what a callback raised, once for each place and kind."""
        frame = traceback.extract_tb(error.__traceback__)[-1]
        what = f'{type(error).__name__} in {frame.filename}:{frame.lineno}'
        if what not in self._stumbled:
            self._stumbled.add(what)
            self.fault(error)

    def unwritten(self, error: BaseException) -> IdentError:
        """Say that the files of a run could not be written; return what the user is told."""
        fault = self.fault(error)
        self._log.error(
            f'{fault.message}; the result is published; correct that, then call ~/save_result to '
            'write it'
        )
        return fault

    def publish(self) -> None:
        """Publish the state as it is."""
        meters = self._node.capture.meters.values()
        message = Status(
            state=self.state,
            sentence=self.sentence,
            streams=list(self._node.capture.topics.values()),
            received=[meter.received for meter in meters],
            rate=[meter.rate for meter in meters],
            missing_fraction=[meter.missing_fraction for meter in meters],
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        if self._error is not None:
            message.error_code = int(self._error.code)
            message.error_message = self._error.message
        self._node.outlet.status.publish(message)


class PageWriter:
    """Writes pages on runs, one after the other, in a process of its own, beside the node."""

    def __init__(self) -> None:
        self._waiting: deque[str] = deque()
        self._process: subprocess.Popen[str] | None = None
        self._sentences: list[str] = []

    def start(self, result_file: str) -> None:
        """Have the page on a run written, after those that wait; none where it has no file."""
        if result_file:
            self._waiting.append(str(Path(result_file).parent))
            self._go_on()
        if len(self._waiting) > _MOST_PAGES:
            self._sentences.append(unwritten_pages([self._waiting.popleft()]))

    def left(self) -> list[str]:
        """Return the folders of runs whose pages have not been begun."""
        return list(self._waiting)

    def failures(self) -> list[str]:
        """Return a sentence for each page that could not be written since the last call."""
        process = self._process
        if process is not None and process.poll() is not None:
            said = (process.communicate()[1] or '').strip()
            if process.returncode:
                self._sentences.append(
                    f'the page on a run was not written ({said}); its other files are there, and '
                    '`ident report` writes the page from them'
                )
            self._process = None
            self._go_on()
        sentences, self._sentences = self._sentences, []
        return sentences

    def _go_on(self) -> None:
        if self._process is None and self._waiting:
            self._process = subprocess.Popen(
                [*_REPORT, self._waiting.popleft()],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C ends the node, and this page is still written
            )


def unwritten_pages(folders: Sequence[str]) -> str:
    """Return the sentence for runs whose pages are left to the user."""
    runs = ' '.join(map(shlex.quote, folders))
    return (
        f'runs came faster than their pages are written, {len(folders)} are left out; to write '
        f'them: for run in {runs}; do ident report "$run"; done'
    )
