# SPDX-License-Identifier: Apache-2.0
"""The program `replay`: plays a bag's JointState topics where there is no `ros2 bag play`."""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
import signal
import sys
import time
from typing import Any, NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from ros2_ident.cli.arguments import positive
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.ros.identifier import missing, Stop

TYPE = 'sensor_msgs/msg/JointState'
# A publisher knows of a subscriber a little before that one knows of it; what is sent in between
# is lost, and nothing tells when it is over.
SETTLE = 0.5
# Time for the last messages to leave this process: what reliable subscribers may take to confirm
# them, and what comes on top for the others.
PATIENCE, LINGER = 1.0, 0.3
# The longest sleep [s]: a signal is noticed after it.
_NAP = 0.05

EXAMPLES = (
    'examples:\n'
    '  replay bags/tripod_mixed                   at the recorded pace\n'
    '  replay bags/tripod_mixed -r 2 --clock      twice as fast, with /clock at 40 Hz\n'
    '  replay log.mcap --wait-for-subscribers     not before someone listens to every topic\n'
    '  replay log.mcap --remap /joint_states:=/arm/joint_states\n'
    '\n'
    'exit codes: 0 played to its end, 1 not played, 2 wrong arguments, 130 interrupted\n'
)


class Message(NamedTuple):
    """One serialised message."""

    topic: str
    log_time: int
    data: bytes


class Bag:
    """The JointState topics of a bag, read as they are needed.

    Args:
        path: A bag directory or a single file.
        topics: Topics to take; all of the type where None.

    Attributes:
        topics: Topics and how many messages each has.
        skipped: Topics of other types.
        duration: From the first to the last log time of the bag, s.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM or DAMAGED_BAG.
    """

    def __init__(self, path: str | Path, topics: Sequence[str] | None = None) -> None:
        path = Path(path).expanduser()
        if not path.exists():
            raise IdentError(
                ErrorCode.NO_DATA, f'{path}: does not exist; give a bag directory or an .mcap file'
            )
        try:
            reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            reader.open()
        except Exception as exc:  # rosbags lets errors of its decoders through
            reason = ' '.join(str(exc).split()).rstrip('.') or type(exc).__name__
            raise IdentError(
                ErrorCode.DAMAGED_BAG,
                f'{path}: cannot be played ({reason}); try `mcap recover` or `ros2 bag reindex`',
            ) from None
        self._reader = reader
        counts: Counter[str] = Counter()
        for connection in reader.connections:
            if connection.msgtype == TYPE:
                counts[connection.topic] += connection.msgcount
        self.skipped = sorted({x.topic for x in reader.connections if x.msgtype != TYPE})
        if absent := [topic for topic in topics or () if topic not in counts]:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                f'{path}: has no JointState topic {", ".join(absent)}; '
                f'it has {", ".join(sorted(counts)) or "none"}',
            )
        self.topics = {x: n for x, n in counts.items() if topics is None or x in topics}
        if not any(self.topics.values()):
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{path}: holds no message of type {TYPE}; '
                f'its other topics are {", ".join(self.skipped) or "none"}',
            )
        self.duration = 1e-9 * (int(reader.end_time) - int(reader.start_time))

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of log time, in the CDR of ROS 2."""
        reader = self._reader
        wanted = [x for x in reader.connections if x.msgtype == TYPE and x.topic in self.topics]
        for connection, log_time, data in reader.messages(connections=wanted):
            raw = data if reader.is2 else reader.typestore.ros1_to_cdr(data, TYPE)
            yield Message(connection.topic, int(log_time), bytes(raw))

    def close(self) -> None:
        """Close the files."""
        self._reader.close()


def play(
    messages: Iterable[Message],
    publish: Callable[[Message], None],
    *,
    rate: float = 1.0,
    stopped: Callable[[], Any] = lambda: False,
    between: Callable[[int], None] = lambda log_time: None,
) -> bool:
    """Hand out messages at the recorded pace; return whether the end was reached.

    Args:
        messages: In the order of log time.
        publish: Takes a message when it is due.
        rate: Times faster than recorded.
        stopped: Whether to end now.
        between: Called with the log time now, ns, between the messages; has to be quick.
    """
    first, start = None, time.monotonic_ns()
    for message in messages:
        if first is None:
            first, start = message.log_time, time.monotonic_ns()
        due = start + round((message.log_time - first) / rate)
        while not stopped() and (now := time.monotonic_ns()) < due:
            between(first + round((now - start) * rate))
            time.sleep(min((due - now) * 1e-9, _NAP))
        if stopped():
            return False
        publish(message)
    return True


def _options(words: Sequence[str]) -> argparse.Namespace:
    found = argparse.ArgumentParser(
        prog='replay',
        description='Play the JointState topics of a bag. Header stamps stay as recorded.',
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = found.add_argument
    add('bag', help='bag directory, or a single .mcap, .db3 or .bag file')
    add('-r', '--rate', type=positive, default=1.0, metavar='FACTOR', help='times faster (1.0)')
    for flag, const, metavar, text in (
        ('--clock', 40.0, 'HZ', 'publish /clock (40 Hz)'),
        ('--wait-for-subscribers', 10.0, 'S', 'wait until every topic has a subscriber; give up '
         'after S seconds (10)'),
    ):  # fmt: skip
        add(flag, type=positive, nargs='?', const=const, metavar=metavar, help=text)
    add('--topics', nargs='+', metavar='TOPIC', help='play only these')
    add('-m', '--remap', nargs='+', default=[], metavar='OLD:=NEW', help='other names for topics')
    add('-q', '--quiet', action='store_true', help='say nothing of what is played')
    return found.parse_args(words)


def main(args: Sequence[str] | None = None) -> int:
    """Play a bag.

    Args:
        args: As on the command line, without the program's name.

    Returns:
        The exit code.
    """
    stop = Stop().install()
    given = list(sys.argv[1:] if args is None else args)
    at = given.index('--ros-args') if '--ros-args' in given else len(given)
    options = _options(given[:at])
    try:
        return _play(options, given[at:], stop)
    except IdentError as error:
        print(f'replay: {error.message}', file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        print(f'replay: {missing(error)}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _play(options: argparse.Namespace, ros: list[str], stop: Stop) -> int:
    """Play as the options say, and let the last messages out; return the exit code."""
    import rclpy
    from rclpy.duration import Duration
    from rclpy.signals import SignalHandlerOptions
    from rclpy.time import Time
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState

    bag = Bag(options.bag, options.topics)
    if not options.quiet:
        left = f'; not {", ".join(bag.skipped)}, no JointState' if bag.skipped else ''
        print(
            f'replay: {sum(bag.topics.values())} messages of {", ".join(bag.topics)}, '
            f'{bag.duration / options.rate:.1f} s{left}',
            file=sys.stderr,
            flush=True,
        )
    ros = (ros or ['--ros-args']) + [x for pair in options.remap for x in ('-r', pair)]
    rclpy.init(args=ros, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('replay')
    # reliable: matches every subscriber
    publishers = {topic: node.create_publisher(JointState, topic, 5000) for topic in bag.topics}
    clock = node.create_publisher(Clock, '/clock', 10) if options.clock else None
    next_clock = 0

    def tick(log_time: int) -> None:
        nonlocal next_clock
        if clock is not None and log_time >= next_clock:
            next_clock = log_time + round(1e9 / options.clock * options.rate)
            clock.publish(Clock(clock=Time(nanoseconds=log_time).to_msg()))

    def publish(message: Message) -> None:
        tick(message.log_time)
        publishers[message.topic].publish(message.data)

    def stopped() -> int:
        return stop.signal

    try:
        patience = options.wait_for_subscribers
        if patience and (deaf := _unheard(publishers, patience, stopped)):
            print(
                f'replay: no subscriber to {", ".join(deaf)} within {patience:g} s; start the '
                'subscriber first, or choose with --topics',
                file=sys.stderr,
            )
            return 1
        whole = play(bag.messages(), publish, rate=options.rate, stopped=stopped, between=tick)
        return 0 if whole else 128 + stop.signal
    finally:
        deadline = time.monotonic() + PATIENCE
        for publisher in publishers.values():
            left_over = max(0.0, deadline - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left_over))
        time.sleep(LINGER)
        bag.close()
        rclpy.try_shutdown()


def _unheard(
    publishers: dict[str, Any], seconds: float, stopped: Callable[[], int]
) -> list[str]:
    """Wait for a subscriber on each topic; return the topics that have none in the end."""
    end = time.monotonic() + seconds
    while deaf := [x for x, p in publishers.items() if not p.get_subscription_count()]:
        if stopped() or time.monotonic() > end:
            return [] if stopped() else deaf
        time.sleep(_NAP)
    if not stopped():
        time.sleep(SETTLE)
    return []


if __name__ == '__main__':
    sys.exit(main())
