# SPDX-License-Identifier: Apache-2.0
"""The program `identifier`: runs the node and ends it on SIGINT or SIGTERM, no run is lost."""

import argparse
from collections.abc import Sequence
import gc
import itertools
import os
import re
import signal
import sys
import time
from types import FrameType
from typing import Any

from ros2_ident.threads import one_heap, one_thread_for_linear_algebra

# A run heeds its cancel event within a second of processor time. Other programs go before its
# thread and can make that long; a second signal ends at once, s.
PATIENCE = 30.0
# Wait for an overlay that is being written; its first simulation ever is compiled, s.
FILES_PATIENCE = 120.0
DESCRIPTION = """\
The node `identifier`: identifies drives and diagnoses gaps between simulation and measurement,
from what it hears on joint_states, effort and joint_command or from bags.
"""
EPILOG = """\
parameters (docs/parameters.md lists all; `ros2 param describe` shows them as well):
  identifier --ros-args -p machine_file:=my_machine.yaml
  identifier --ros-args --params-file my_parameters.yaml

other names of topics, of the node, and its namespace:
  identifier --ros-args -r joint_command:=/joint_trajectory_controller/controller_state
  identifier --ros-args -r __node:=left_arm -r __ns:=/cell

exit codes:
  0  ended by a signal, with every result out
  1  something is missing that it needs
  2  the command line or a parameter cannot be used
"""
# The worker hands the interpreter on this often, s; 5 ms, the default, would delay every message.
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
    """Event that SIGINT and SIGTERM set from now on; the second one ends the program at once."""

    def __init__(self) -> None:
        self.signal = 0
        signal.signal(signal.SIGINT, self)
        signal.signal(signal.SIGTERM, self)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        if self.signal:
            os._exit(128 + number)  # files are written whole or not at all
        self.signal = number


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal.

    Returns:
        Exit code: 0 after a signal, 1 where something is missing, 2 for unusable parameters.
    """
    one_thread_for_linear_algebra()
    one_heap()
    stop = Stop()
    try:
        _own_arguments(sys.argv[1:] if args is None else args)
        return _run(args, stop)
    except ModuleNotFoundError as error:
        print(f'identifier: {missing(error)}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _own_arguments(args: Sequence[str]) -> None:
    """Answer --help, and refuse all else before --ros-args."""
    parser = argparse.ArgumentParser(
        prog='identifier',
        description=DESCRIPTION,
        epilog=EPILOG,
        usage='identifier [--help] [--ros-args ...]',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.parse_args(list(itertools.takewhile(lambda x: x != '--ros-args', args)))


def _refused(error: Exception) -> str:
    """Return what is wrong with the arguments that ROS does not take, in a sentence."""
    # without the places in rcl's sources
    text = re.sub(r', at \S+:\d+', '', str(error).strip()).splitlines()[0]
    text = text.removeprefix('failed to initialize rcl: ').rstrip('. ')
    return f'{text}; see identifier --help, and config/identifier.yaml for parameter files'


def _run(args: Sequence[str] | None, stop: Stop) -> int:
    # imported here, so that what is missing can be said in a sentence
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    from ros2_ident.errors import IdentError
    from ros2_ident.ros.node import Identifier

    sys.setswitchinterval(SWITCH_INTERVAL)
    # Signals are ours: rclpy's would take the context away before the result is published.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        print(f'identifier: {_refused(error)}', file=sys.stderr)
        return 2
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
                node.spin(executor)  # the node's timer ends each wait
            _finish(node, executor)
        except ExternalShutdownException:
            node.stop()
        finally:
            if not node.worker.join(1.0) and not node.worker.busy:
                print(
                    'identifier: files of the last run are being written; a second signal ends '
                    'at once',
                    file=sys.stderr,
                )
                node.worker.join(FILES_PATIENCE)
            node.destroy_node()
        return 0
    finally:
        rclpy.try_shutdown()


def _finish(node: Any, executor: Any) -> None:
    """End a run with the best so far and let its result out, to its client too."""

    def answered_within(seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not node.answered and time.monotonic() < deadline:
            node.spin(executor)
        for _ in range(20):  # rclpy sends a result in a task of its own, when its client has asked
            node.spin(executor, 0.01)
        return bool(node.answered)

    node.stop()
    if not answered_within(PATIENCE):
        print('identifier: the run did not end in time and is given up', file=sys.stderr)
        node.give_up()
        answered_within(1.0)


if __name__ == '__main__':
    sys.exit(main())
