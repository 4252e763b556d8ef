# SPDX-License-Identifier: Apache-2.0
"""What the node says: its publishers, and long series in pieces that keep it responsive."""

from collections import deque
from collections.abc import Iterable
import itertools
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros2_ident_msgs.msg import Gap, IdentificationResult, Progress, Status
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
EVENTS = QoSProfile(depth=10)
SERIES = QoSProfile(depth=5000)
# Messages of a series in one go: about a millisecond.
_PIECE = 100


class Outlet:
    """The publishers of a node.

    Args:
        node: The node.

    Attributes:
        progress: Of ~/progress.
        result: Of ~/result, for late subscribers too, as the next three.
        gap: Of ~/gap.
        status: Of ~/status.
        scene: Of ~/scene.
        diagnostics: Of /diagnostics.
    """

    def __init__(self, node: Node) -> None:
        self.progress = node.create_publisher(Progress, '~/progress', EVENTS)
        self.result = node.create_publisher(IdentificationResult, '~/result', LATCHED)
        self.gap = node.create_publisher(Gap, '~/gap', LATCHED)
        self.status = node.create_publisher(Status, '~/status', LATCHED)
        self.scene = node.create_publisher(MarkerArray, '~/scene', LATCHED)
        self.diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', EVENTS)
        self._series = {
            name: node.create_publisher(JointState, f'~/{name}', SERIES)
            for name in ('simulated', 'residual')
        }
        self._waiting: deque[tuple[Any, Iterable[bytes]]] = deque()

    def series(self, **messages: Iterable[bytes]) -> None:
        """Begin to publish series of serialised messages instead of those still waiting."""
        self._waiting = deque((self._series[name], iter(x)) for name, x in messages.items())

    @property
    def waiting(self) -> bool:
        """Whether messages of a series are left to publish."""
        return bool(self._waiting)

    def go_on(self) -> None:
        """Publish the next piece of the series, alternating between them."""
        if not self._waiting:
            return
        publisher, messages = self._waiting.popleft()
        piece = list(itertools.islice(messages, _PIECE))
        for message in piece:
            publisher.publish(message)
        if len(piece) == _PIECE:
            self._waiting.append((publisher, messages))
