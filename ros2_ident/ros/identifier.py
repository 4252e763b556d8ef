# SPDX-License-Identifier: Apache-2.0
"""The program `identifier`: runs the node and ends it on SIGINT or SIGTERM, no run is lost."""

from collections.abc import Sequence
import gc
import signal
import sys
import time
from types import FrameType

# A run heeds its cancel event within a slice of the search; its files take the rest of this, s.
PATIENCE = 10.0
# The worker's Python parts hand the interpreter on this often; the default of 5 ms would be the
# latency of every message, s.
SWITCH_INTERVAL = 0.0001
_HINTS = {
    'ros2_ident_msgs': (
        'package ros2_ident_msgs not found; build it with `colcon build` in the folder of '
        'ros2_ident and source install/setup.bash there, or run `make setup` and `. ./env.sh`'
    ),
    'rclpy': (
        'rclpy not found; source ROS 2 Jazzy (/opt/ros/jazzy/setup.bash), or run `make setup` and '
        '`. ./env.sh`'
    ),
}


def missing(error: ModuleNotFoundError) -> str:
    """Return the sentence for a module that is not there."""
    name = (error.name or '').partition('.')[0]
    return _HINTS.get(name, f'Python package {name} not found; install it, or run `make setup`')


class Stop:
    """What SIGINT and SIGTERM set; the second one ends the program at once."""

    def __init__(self) -> None:
        self.signal = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        if self.signal:
            raise KeyboardInterrupt
        self.signal = number

    def install(self) -> 'Stop':
        """Take both signals from now on."""
        signal.signal(signal.SIGINT, self)
        signal.signal(signal.SIGTERM, self)
        return self


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal.

    Args:
        args: As on the command line.

    Returns:
        Exit code: 0 after a signal, 1 where something is missing, 2 for unusable parameters.
    """
    stop = Stop().install()
    try:
        return _run(args, stop)
    except ModuleNotFoundError as error:
        print(f'identifier: {missing(error)}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _run(args: Sequence[str] | None, stop: Stop) -> int:
    # imported here, so that what is missing can be said in a sentence
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    from ros2_ident.errors import IdentError
    from ros2_ident.ros.node import Identifier

    sys.setswitchinterval(SWITCH_INTERVAL)
    # Signals are ours: rclpy's would take the context away before the result is published.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        try:
            node = Identifier()
        except IdentError as error:
            print(f'identifier: {error.message}', file=sys.stderr)
            return 2
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # what is there now stays: the collector would look through all of it, tens of ms at a time
        gc.collect()
        gc.freeze()
        try:
            while rclpy.ok() and not stop.signal:
                executor.spin_once()  # the node's timer ends each wait
            _finish(node, executor)
        except ExternalShutdownException:
            node.stop()
        finally:
            if not node.worker.join(PATIENCE):
                print('identifier: the run did not end in time and is given up', file=sys.stderr)
            node.destroy_node()
        return 0
    finally:
        rclpy.try_shutdown()


def _finish(node: 'Identifier', executor: 'SingleThreadedExecutor') -> None:  # noqa: F821
    """End a run with the best so far and let its result out."""
    node.stop()
    deadline = time.monotonic() + PATIENCE
    while node.worker.busy and time.monotonic() < deadline:
        executor.spin_once()


if __name__ == '__main__':
    sys.exit(main())
