# SPDX-License-Identifier: Apache-2.0
"""The program `replay`: plays a bag's JointState topics where there is no `ros2 bag play`."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
import signal
import sys
import time
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import get_typestore, Stores

from ros2_ident.cli.arguments import positive
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import unreadable
from ros2_ident.ros.identifier import missing, Stop

TYPE = 'sensor_msgs/msg/JointState'
# A publisher knows of a subscriber a little before that one knows of it; what is sent in between
# is lost, and nothing tells when it is over.
SETTLE = 0.5
# Time for the last messages to leave this process: what reliable subscribers, on a busy machine
# too, may take to confirm those of a topic, and what comes on top for the others.
PATIENCE, LINGER = 10.0, 0.3
# The longest sleep [s]: a signal is noticed after it.
_NAP = 0.05

EXAMPLES = (
    'examples:\n'
    '  replay bags/tripod_mixed                   at the recorded pace\n'
    '  replay bags/tripod_mixed -r 2 --clock      twice as fast, with /clock at 40 Hz\n'
    '  replay log.mcap --wait-for-subscribers     not before someone listens to every topic\n'
    '  replay log.mcap --ros-args -r /joint_states:=/arm/joint_states\n'
    '\n'
    'exit codes: 0 played to its end, 1 not played, 2 wrong arguments, 130 interrupted\n'
)
# Topic, log time [ns], CDR of ROS 2.
Message = tuple[str, int, bytes]


def opened(path: str | Path, topics: Sequence[str] = ()) -> tuple[AnyReader, list[Connection]]:
    """Return the reader of a bag, and its JointState topics: those named, or all.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM or DAMAGED_BAG.
    """
    path = Path(path).expanduser()
    for place in (path, *path.glob('*')):
        if why := unreadable(place):
            text = f'{place}: {why}; give a bag directory or an .mcap file'
            raise ErrorCode.NO_DATA.error(text)
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    except Exception as exc:  # rosbags lets errors of its decoders through
        reason = ' '.join(str(exc).split()).rstrip('.') or type(exc).__name__
        raise ErrorCode.DAMAGED_BAG.error(
            f'{path}: cannot be played ({reason}); try `mcap recover` or `ros2 bag reindex`'
        ) from None
    there = {x.topic for x in reader.connections if x.msgtype == TYPE and x.msgcount}
    wanted = set(topics) or there
    if not there or wanted - there:
        raise ErrorCode.MISSING_STREAM.error(
            f'{path}: has no {TYPE} on {", ".join(sorted(wanted - there)) or "any topic"}; it has '
            f'them on {", ".join(sorted(there)) or "none"}, others on '
            f'{", ".join(_skipped(reader)) or "none"}'
        )
    return reader, [x for x in reader.connections if x.topic in wanted and x.msgtype == TYPE]


def _skipped(reader: AnyReader) -> list[str]:
    """Return the topics of other types."""
    return sorted({x.topic for x in reader.connections if x.msgtype != TYPE})


def _messages(reader: AnyReader, connections: list[Connection]) -> Iterator[Message]:
    """Yield the messages in the order of log time."""
    for connection, log_time, data in reader.messages(connections=connections):
        raw = data if reader.is2 else reader.typestore.ros1_to_cdr(data, TYPE)
        yield connection.topic, int(log_time), bytes(raw)


def paced(
    messages: Iterable[Message],
    rate: float = 1.0,
    stopped: Callable[[], Any] = lambda: False,
    between: Callable[[int], None] = lambda log_time: None,
) -> Iterator[Message]:
    """Yield each message when it is due, times `rate` faster than recorded, until stopped.

    Args:
        messages: In the order of log time.
        between: Called with the log time now, ns, before each message and while nothing is due.
    """
    first, start = None, time.monotonic_ns()
    for message in messages:
        first = message[1] if first is None else first
        due = start + round((message[1] - first) / rate)
        while not stopped() and (now := time.monotonic_ns()) < due:
            between(first + round((now - start) * rate))
            time.sleep(min((due - now) * 1e-9, _NAP))
        if stopped():
            return
        between(message[1])
        yield message


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
    add('--topics', nargs='+', default=[], metavar='TOPIC', help='play only these')
    return found.parse_args(words)


def main(args: Sequence[str] | None = None) -> int:
    """Play a bag."""
    stop = Stop()
    given = list(sys.argv[1:] if args is None else args)
    at = given.index('--ros-args') if '--ros-args' in given else len(given)
    options = _options(given[:at])
    try:
        return _play(options, given[at:], lambda: stop.signal)
    except (IdentError, ModuleNotFoundError) as error:
        said = error.message if isinstance(error, IdentError) else missing(error)
        print(f'replay: {said}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _play(options: argparse.Namespace, ros: list[str], stopped: Callable[[], int]) -> int:
    """Play as the options say, and let the last messages out; return the exit code."""
    reader, connections = opened(options.bag, options.topics)
    topics = sorted({x.topic for x in connections})
    import rclpy
    from rclpy.duration import Duration
    from rclpy.signals import SignalHandlerOptions
    from rclpy.time import Time
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState

    skipped = _skipped(reader)
    left = f'; not {", ".join(skipped)}, no JointState' if skipped else ''
    seconds = 1e-9 * (int(reader.end_time) - int(reader.start_time)) / options.rate
    count = sum(x.msgcount for x in connections)
    what = f'{count} messages of {", ".join(topics)}, {seconds:.1f} s{left}'
    print(f'replay: {what}', file=sys.stderr, flush=True)
    rclpy.init(args=ros, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('replay')
    # reliable: matches every subscriber
    publishers = {topic: node.create_publisher(JointState, topic, 5000) for topic in topics}
    clock = node.create_publisher(Clock, '/clock', 10) if options.clock else None
    next_clock = 0

    def tick(log_time: int) -> None:
        nonlocal next_clock
        if clock is not None and log_time >= next_clock:
            next_clock = log_time + round(1e9 / options.clock * options.rate)
            clock.publish(Clock(clock=Time(nanoseconds=log_time).to_msg()))

    try:
        patience = options.wait_for_subscribers
        if patience and (deaf := _unheard(publishers, patience, stopped)):
            print(
                f'replay: no subscriber to {", ".join(deaf)} within {patience:g} s; start the '
                'subscriber first, or choose with --topics',
                file=sys.stderr,
            )
            return 1
        for topic, _, data in paced(_messages(reader, connections), options.rate, stopped, tick):
            publishers[topic].publish(data)
        return 128 + stopped() if stopped() else 0
    finally:
        for publisher in publishers.values():
            if not stopped():
                publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
        time.sleep(LINGER)
        reader.close()
        rclpy.try_shutdown()


def _unheard(publishers: dict[str, Any], seconds: float, stopped: Callable[[], int]) -> list[str]:
    """Wait for a subscriber on each topic; return the topics that have none in the end."""
    end = time.monotonic() + seconds
    while deaf := [x for x, p in publishers.items() if not p.get_subscription_count()]:
        if stopped() or time.monotonic() > end:
            return [] if stopped() else deaf
        time.sleep(_NAP)
    time.sleep(SETTLE)
    return []


if __name__ == '__main__':
    sys.exit(main())
