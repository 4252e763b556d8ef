# SPDX-License-Identifier: Apache-2.0
"""The program `replay`: plays a bag's JointState topics where there is no `ros2 bag play`."""

import argparse
from collections.abc import Sequence
import signal
import sys
import time

from ros2_ident.errors import IdentError
from ros2_ident.ros.identifier import missing, Stop
from ros2_ident.ros.playback import Bag, Message, play

# A publisher knows of a subscriber a little before that one knows of it; what is sent in between
# is lost, and nothing tells when it is over.
SETTLE = 0.5
# Time for the last messages to leave this process: what reliable subscribers may take to confirm
# them, and what comes on top for the others.
PATIENCE, LINGER = 1.0, 0.3

EXAMPLES = (
    'examples:\n'
    '  replay bags/tripod_mixed                   at the recorded pace\n'
    '  replay bags/tripod_mixed -r 2 --clock      twice as fast, with /clock at 40 Hz\n'
    '  replay log.mcap --wait-for-subscribers     not before someone listens to every topic\n'
    '  replay log.mcap --remap /joint_states:=/arm/joint_states\n'
    '\n'
    'exit codes: 0 played to its end, 1 not played, 2 wrong arguments, 130 interrupted\n'
)


def positive(text: str) -> float:
    """Return a number above 0."""
    value = float(text)
    if not 0.0 < value < float('inf'):
        raise argparse.ArgumentTypeError(f'{text} is not above 0')
    return value


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = argparse.ArgumentParser(
        prog='replay',
        description='Play the JointState topics of a bag. Header stamps stay as recorded.',
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = found.add_argument
    add('bag', help='bag directory, or a single .mcap, .db3 or .bag file')
    add('-r', '--rate', type=positive, default=1.0, metavar='FACTOR', help='times faster (1.0)')
    add(
        '--clock',
        type=positive,
        nargs='?',
        const=40.0,
        metavar='HZ',
        help='publish /clock (40 Hz)',
    )
    add(
        '--wait-for-subscribers',
        type=positive,
        nargs='?',
        const=10.0,
        metavar='S',
        help='wait until every topic has a subscriber; give up after S seconds (10)',
    )
    add('--topics', nargs='+', metavar='TOPIC', help='play only these')
    add('-m', '--remap', nargs='+', default=[], metavar='OLD:=NEW', help='other names for topics')
    add('-q', '--quiet', action='store_true', help='say nothing of what is played')
    return found


def main(args: Sequence[str] | None = None) -> int:
    """Play a bag.

    Args:
        args: As on the command line, without the program's name.

    Returns:
        The exit code.
    """
    stop = Stop().install()
    given = list(sys.argv[1:] if args is None else args)
    own, ros = given, []
    if '--ros-args' in given:
        at = given.index('--ros-args')
        own, ros = given[:at], given[at:]
    options = parser().parse_args(own)
    try:
        return _play(options, ros, stop)
    except IdentError as error:
        print(f'replay: {error.message}', file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        print(f'replay: {missing(error)}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _play(options: argparse.Namespace, ros: list[str], stop: Stop) -> int:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    bag = Bag(options.bag, options.topics)
    if not options.quiet:
        left = f'; not {", ".join(bag.skipped)}, no JointState' if bag.skipped else ''
        print(
            f'replay: {bag.count} messages of {", ".join(bag.topics)}, '
            f'{bag.duration / options.rate:.1f} s{left}',
            file=sys.stderr,
            flush=True,
        )
    remaps = [x for pair in options.remap for x in ('-r', pair)]
    ros = (ros or ['--ros-args']) + remaps
    rclpy.init(args=ros, signal_handler_options=SignalHandlerOptions.NO)
    try:
        station = Station(bag, options)
        try:
            return station.run(stop)
        finally:
            station.close()
    finally:
        bag.close()
        rclpy.try_shutdown()


class Station:
    """The node that plays, and its publishers.

    Args:
        bag: What to play.
        options: The command line.
    """

    def __init__(self, bag: Bag, options: argparse.Namespace) -> None:
        from rclpy.node import Node
        from rclpy.qos import QoSProfile
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState

        self._bag = bag
        self._options = options
        self._node = Node('replay')
        qos = QoSProfile(depth=5000)  # reliable: matches every subscriber
        self._publishers = {
            topic: self._node.create_publisher(JointState, topic, qos) for topic in bag.topics
        }
        self._clock = None
        if options.clock:
            self._clock = self._node.create_publisher(Clock, '/clock', QoSProfile(depth=10))
            self._clock_type = Clock
        self._next_clock = 0

    def run(self, stop: Stop) -> int:
        """Play as the options say; return the exit code."""
        options = self._options
        if options.wait_for_subscribers and not self._wait(options.wait_for_subscribers, stop):
            if stop.signal:
                return 128 + stop.signal
            names = [t for t, p in self._publishers.items() if not p.get_subscription_count()]
            print(
                f'replay: nobody listened to {", ".join(names)} within '
                f'{options.wait_for_subscribers:g} s; start the subscriber first, or choose with '
                '--topics',
                file=sys.stderr,
            )
            return 1
        whole = play(
            self._bag.messages(),
            self._publish,
            rate=options.rate,
            stopped=lambda: bool(stop.signal),
            between=self._tick_clock,
        )
        return 0 if whole else 128 + stop.signal

    def _publish(self, message: Message) -> None:
        self._tick_clock(message.log_time)
        self._publishers[message.topic].publish(message.data)

    def _tick_clock(self, log_time: int) -> None:
        if self._clock is None or log_time < self._next_clock:
            return
        self._next_clock = log_time + round(1e9 / self._options.clock * self._options.rate)
        message = self._clock_type()
        message.clock.sec, message.clock.nanosec = divmod(log_time, 1_000_000_000)
        self._clock.publish(message)

    def _wait(self, seconds: float, stop: Stop) -> bool:
        """Wait for a subscriber on each topic; return whether they came."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not stop.signal:
            if all(p.get_subscription_count() for p in self._publishers.values()):
                _sleep(SETTLE, stop)
                return True
            time.sleep(0.02)
        return False

    def close(self) -> None:
        """Let the last messages out and take the node off the air."""
        from rclpy.duration import Duration

        deadline = time.monotonic() + PATIENCE
        for publisher in self._publishers.values():
            left = max(0.0, deadline - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left))
        time.sleep(LINGER)
        self._node.destroy_node()


def _sleep(seconds: float, stop: Stop) -> None:
    deadline = time.monotonic() + seconds
    while not stop.signal and (left := deadline - time.monotonic()) > 0.0:
        time.sleep(min(left, 0.05))


if __name__ == '__main__':
    sys.exit(main())
