# SPDX-License-Identifier: Apache-2.0
"""What the node is doing, said on ~/status and in the log."""

from collections.abc import Sequence
import traceback

from rclpy.node import Node
from ros2_ident_msgs.msg import Status

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.ros.capture import Capture
from ros2_ident.ros.outlet import Outlet


class Board:
    """The node's state in a number and in words.

    Args:
        node: The node.
        outlet: Where the status goes.
        capture: Whose streams it lists.

    Attributes:
        state: One of the message's states.
        sentence: The same in words.
    """

    def __init__(self, node: Node, outlet: Outlet, capture: Capture) -> None:
        self.state: int = Status.STATE_WAITING
        self.sentence = 'no data yet'
        self._error: IdentError | None = None
        self._stumbled: set[str] = set()
        self._node = node
        self._outlet = outlet
        self._capture = capture

    def change(self, state: int, sentence: str, error: IdentError | None = None) -> None:
        """Enter a state."""
        self.state = state
        self.sentence = sentence
        self._error = error
        log = self._node.get_logger()
        if error is not None and error.code != ErrorCode.CANCELLED:
            log.error(sentence)
        else:
            log.info(sentence)
        self.publish()

    def warn(self, sentence: str) -> None:
        """Say something else in the same state, once."""
        if sentence != self.sentence:
            self._node.get_logger().warning(sentence)
            self.sentence = sentence
            self.publish()

    def warnings(self, sentences: Sequence[str]) -> None:
        """Log what a result warns of, without another state."""
        for sentence in sentences:
            self._node.get_logger().warning(sentence)

    def refuse(self, error: IdentError) -> None:
        """Say why a goal was refused, without touching what runs."""
        self._node.get_logger().warning(error.message)
        self._error = error
        self.publish()

    def fault(self, error: BaseException) -> IdentError:
        """Return what the user is told; what is no user's error goes to the log in full."""
        if isinstance(error, IdentError):
            return error
        text = ''.join(traceback.format_exception(error))
        self._node.get_logger().error(f'a defect of this package:\n{text}')
        return IdentError(
            ErrorCode.INTERNAL,
            f'a defect of this package ended the run ({type(error).__name__}: {error}); '
            'please report it with the log',
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
        self._node.get_logger().error(
            f'{fault.message}; the result is published; correct that, then call ~/save_result to '
            'write it'
        )
        return fault

    def publish(self) -> None:
        """Publish the state as it is."""
        meters = self._capture.meters
        message = Status(state=self.state, sentence=self.sentence)
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.streams = list(self._capture.topics.values())
        message.received = [meter.received for meter in meters.values()]
        message.rate = [meter.rate for meter in meters.values()]
        message.missing_fraction = [meter.missing_fraction for meter in meters.values()]
        if self._error is not None:
            message.error_code = int(self._error.code)
            message.error_message = self._error.message
        self._outlet.status.publish(message)
