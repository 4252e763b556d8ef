# SPDX-License-Identifier: Apache-2.0
"""An hour of data into the node, faster than recorded, while it identifies and diagnoses.

    python checks/benchmarks/soak.py [--hours 1] [--speed 4] [--window 20] [--reliable]

A process publishes three drives at 1 kHz on joint_states, effort and joint_command: cycles of the
bundled machine's reference simulation, with the data's header stamps, `--speed` times as fast.
The node `identifier` runs in another process; its queues are `--speed` times as deep as by default
and hold a second, as at the recorded speed. After each window of the data ~/clear_data is called;
before that a goal on what was heard is sent, an identification of all drives and a diagnosis of
one in turn, unless one is running or ended in one of the last two. Told are, every ten minutes,

- messages published, and how many came neither to the node nor into its buffer (by the counts of
  ~/clear_data),
- the node's resident memory, looked at every second: the most, and at rest, which is the least of
  a window between two goals; judged is how that grows from the second ten minutes to the last,
- how long the node's callbacks for messages take, and how long a message took to its callback,
  from DDS's stamp of publishing.

Where the drives are more than 50 ms late, all that follows is late, too: after a pause their
messages do not come all at once.
"""

import argparse
from collections.abc import Callable, Iterator
import contextlib
from dataclasses import dataclass, field
import math
import multiprocessing
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import sys
import tempfile
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from checks.benchmarks import measure
from checks.benchmarks.long_bag import simulated_cycle
from checks.share import table
from ros2_ident.ros.capture import QOS
from ros2_ident.ros.capture import TOPICS as ROLES
from ros2_ident.threads import ONE_THREAD

ROOT = Path(__file__).resolve().parents[2]
MACHINE = ROOT / 'config/tripod.yaml'
TOPICS = ('joint_states', 'effort', 'joint_command')
NAMES = ('drive_1', 'drive_2', 'drive_3')
RATE = 1000  # of the data, Hz
PERIOD = 600 * RATE  # steps of the data in a row of the table
CYCLES = 3
BASE = 1_700_000_000_000_000_000  # first header stamp, ns
# Bins of the times, 8 to the octave from 1 ns on.
BINS, OCTAVE = 320, 8
MADE_UP = 50_000_000  # lateness of the drives that is made up for, ns
PATIENCE = 120.0  # s, for what must come at once on an idle machine
GROWTH = 5.0  # MiB that the node may grow by
SPAWN = multiprocessing.get_context('spawn')


class Shared:
    """What the processes count, readable by the others while they run.

    Attributes:
        sent: Steps of the data that are published, a message of each topic in one.
        came: Messages that came to the node, by topic.
        met: Set once the node has heard of every topic.
        begin: Set when the data shall begin.
        calls: How long callbacks took, by bin.
        ways: How long messages took to them, by bin.
        longest: The longest of both, ns.
    """

    def __init__(self) -> None:
        self.sent = SPAWN.RawValue('q', 0)
        self.came = SPAWN.RawArray('q', len(TOPICS))
        self.met = SPAWN.Event()
        self.begin = SPAWN.Event()
        self.calls = SPAWN.RawArray('q', BINS)
        self.ways = SPAWN.RawArray('q', BINS)
        self.longest = SPAWN.RawArray('q', 2)


def bin_of(nanoseconds: int) -> int:
    """Return the bin of a time."""
    return min(BINS - 1, int(OCTAVE * math.log2(nanoseconds))) if nanoseconds > 1 else 0


def percentile(counts: NDArray[np.int64], percent: float) -> float:
    """Return a percentile of binned times, ns: the upper edge of its bin, at most 9 % too much."""
    if not counts.sum():
        return math.nan
    place = int(np.searchsorted(np.cumsum(counts), 0.01 * percent * counts.sum()))
    return float(2.0 ** ((place + 1) / OCTAVE))


# ---------------------------------------------------------------------- the drives


def encoded() -> list[list[bytearray]]:
    """Return the messages of the cycles, a list for each topic."""
    from ros2_ident.recording import cdr

    rng = np.random.default_rng(1)
    out: list[list[bytearray]] = [[], [], []]
    for seed in range(1, CYCLES + 1):
        cycle = simulated_cycle(seed)
        effort = cycle['effort'] + 0.01 * rng.standard_normal(cycle['effort'].shape)
        stamp = np.zeros(len(effort), dtype=np.int64)
        fields = (
            (cycle['position'], cycle['velocity'], None),
            (None, None, effort),
            (cycle['command'], None, None),
        )
        for messages, values in zip(out, fields, strict=True):
            messages += [bytearray(x) for x in cdr.encode(stamp, NAMES, values)]
    return out


def publish(shared: Shared, steps: int, speed: float) -> None:
    """Be the drives."""
    import rclpy
    from rclpy.duration import Duration
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    messages = encoded()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node('drives')
    publishers = [node.create_publisher(JointState, topic, 5000) for topic in TOPICS]
    for number, (publisher, series) in enumerate(zip(publishers, messages, strict=True)):
        while not shared.came[number]:  # nothing else tells that the other side knows of us
            publisher.publish(bytes(series[0]))
            time.sleep(0.2)
    time.sleep(1.0)
    shared.met.set()
    shared.begin.wait()
    period = round(1e9 / RATE / speed)
    due = time.monotonic_ns()
    for k in range(steps):
        now = time.monotonic_ns()
        if now < due:
            time.sleep((due - now) * 1e-9)
        due = max(due, now - MADE_UP) + period
        seconds, rest = divmod(BASE + k * (1_000_000_000 // RATE), 1_000_000_000)
        stamp = seconds.to_bytes(4, 'little') + rest.to_bytes(4, 'little')
        for publisher, series in zip(publishers, messages, strict=True):
            message = series[k % len(series)]
            message[4:12] = stamp
            publisher.publish(bytes(message))
        shared.sent.value = k + 1
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=5.0))
    time.sleep(1.0)
    node.destroy_node()
    rclpy.shutdown()


# ---------------------------------------------------------------------- the node


def run_node(shared: Shared, words: list[str]) -> None:
    """Be the node: its program with a stop-watch in its callbacks."""
    from ros2_ident.ros import node as module
    from ros2_ident.ros.identifier import main as identifier

    calls, ways, longest = shared.calls, shared.ways, shared.longest
    number = 0  # of the topic whose messages are taken

    def count(nanoseconds: int) -> None:
        shared.came[number] += 1
        ways[bin_of(nanoseconds)] += 1
        if nanoseconds > longest[1]:
            longest[1] = nanoseconds

    def timed(
        callback: Callable[[bytes, dict[str, int]], None], own: int
    ) -> Callable[[bytes, dict[str, int]], None]:
        def call(data: bytes, info: dict[str, int]) -> None:
            nonlocal number
            number = own
            start = time.perf_counter_ns()
            callback(data, info)
            spent = time.perf_counter_ns() - start
            calls[bin_of(spent)] += 1
            if spent > longest[0]:
                longest[0] = spent

        return call

    class Watched(module.Identifier):
        def __init__(self) -> None:
            super().__init__()
            self.capture.on_latency = count
            for role, topic in ROLES.items():
                subscription = self.capture._subscriptions[role]
                subscription.callback = timed(subscription.callback, TOPICS.index(topic))

    module.Identifier = Watched  # type: ignore[misc]
    sys.exit(identifier(words))


def resident(process: BaseProcess) -> float:
    """Return the resident memory of a process, MiB."""
    pages = int(Path(f'/proc/{process.pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 2**20


# ---------------------------------------------------------------------- the client


@dataclass
class Goals:
    """What became of the goals.

    Attributes:
        ended: How many ended with a result, by kind.
        wrong: What went wrong, a sentence each.
    """

    ended: dict[str, int] = field(default_factory=lambda: {'identify': 0, 'diagnose': 0})
    wrong: list[str] = field(default_factory=list)


class Client:
    """Sends goals on the live data, one after the other, and has the data cleared."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.action import ActionClient
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.signals import SignalHandlerOptions
        from ros2_ident_msgs.action import Diagnose, Identify
        from ros2_ident_msgs.msg import Status
        from std_srvs.srv import Trigger

        from ros2_ident.ros.outlet import LATCHED

        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node('soak')
        self._status: Any = None
        self.node.create_subscription(Status, '/identifier/status', self._hear, LATCHED)
        self._actions = {
            'identify': (ActionClient(self.node, Identify, '/identifier/identify'), Identify),
            'diagnose': (ActionClient(self.node, Diagnose, '/identifier/diagnose'), Diagnose),
        }
        self._clear = self.node.create_client(Trigger, '/identifier/clear_data')
        self._trigger = Trigger.Request
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._running: tuple[str, Any] | None = None
        self._next = 'identify'
        self._sent = 0
        self._pause = 0  # windows to come without a goal
        self.goals = Goals()
        self.cleared = 0
        self.resting = False

    def _hear(self, status: Any) -> None:
        self._status = status

    def spin(self, condition: Callable[[], Any], what: str, seconds: float = PATIENCE) -> Any:
        """Spin until a condition holds; return its value."""
        end = time.monotonic() + seconds
        while not (value := condition()):
            if time.monotonic() > end:
                raise TimeoutError(f'{what} did not come within {seconds} s')
            self._executor.spin_once(0.02)
        return value

    def connect(self) -> None:
        """Wait for the node to be there with all that is asked of it."""
        self.spin(
            lambda: (
                self._status is not None
                and all(action.server_is_ready() for action, _ in self._actions.values())
                and self._clear.service_is_ready()
            ),
            'the node',
        )

    def rest(self, seconds: float) -> None:
        """Spin for a while, and take the result of a goal that has ended."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(min(left, 0.05))
        if self._running is not None and self._running[1].done():
            name, result = self._running
            self._running, self._pause = None, 2
            self._judge(name, result.result().result)

    def _judge(self, name: str, result: Any) -> None:
        self.goals.ended[name] += 1
        found = result.identification if name == 'identify' else result.gap
        if found.error_code:
            self.goals.wrong.append(f'{name}: {found.error_message}')
        elif name == 'identify' and found.missing_fraction:
            self.goals.wrong.append(f'identify: {found.missing_fraction} of the samples missing')

    def window(self) -> None:
        """Have the data cleared; before that send the next goal, unless one runs or just did.

        The first window after a goal is for the files of its run.
        """
        self.resting = self._running is None and self._pause == 1
        if self._running is None and not self._pause:
            self._send(self._next)
        self._pause = max(0, self._pause - 1)
        self.cleared += self.clear()

    def clear(self) -> int:
        """Have the data cleared; return how many messages it was."""
        answer = self._clear.call_async(self._trigger())
        self.spin(answer.done, 'the answer of ~/clear_data')
        return int(answer.result().message.split()[0])

    def _send(self, name: str) -> None:
        action, kind = self._actions[name]
        began: list[Any] = []
        goal = kind.Goal(data_source=kind.Goal.DATA_SOURCE_LIVE)
        if name == 'diagnose':
            goal.drives = [NAMES[self._sent % len(NAMES)]]
        self._sent += name == 'diagnose'
        sent = action.send_goal_async(goal, feedback_callback=began.append)
        self.spin(sent.done, f'the answer to the goal {name}')
        handle = sent.result()
        if not handle.accepted:
            self.goals.wrong.append(f'{name}: refused')
            return
        result = handle.get_result_async()
        self.spin(lambda: began or result.done(), f'word of the goal {name}')  # it has its data
        self._running = name, result
        self._next = 'diagnose' if name == 'identify' else 'identify'

    def finish(self) -> None:
        """Wait for the goal that runs, and count what is still in the buffer."""
        while self._running is not None:
            self.rest(0.2)
        self.cleared += self.clear()


# ---------------------------------------------------------------------- the table


@dataclass(frozen=True)
class Row:
    """What was counted up to a moment.

    Attributes:
        sent: Steps of the data published.
        calls: Binned times of callbacks (BINS,).
        ways: Binned times of messages to their callback (BINS,).
    """

    sent: int
    calls: NDArray[np.int64]
    ways: NDArray[np.int64]
    goals: dict[str, int]


def counted(shared: Shared, goals: Goals) -> Row:
    """Return what is counted by now."""
    return Row(shared.sent.value, np.array(shared.calls), np.array(shared.ways), dict(goals.ended))


def cells(first: Row, before: Row, now: Row, memory: list[float], rests: list[float]) -> list[str]:
    """Return a row of the table: what came between two moments."""
    calls, ways = now.calls - before.calls, now.ways - before.ways
    goals = (now.goals[x] - before.goals[x] for x in ('identify', 'diagnose'))
    return [
        f'{before.sent / RATE / 60:.0f} to {now.sent / RATE / 60:.0f}',
        f'{len(TOPICS) * (now.sent - before.sent)}',
        f'{len(TOPICS) * now.sent - int(now.ways.sum() - first.ways.sum())}',
        f'{np.median(rests):.1f}' if rests else '',
        f'{max(memory):.0f}',
        ' + '.join(f'{x}' for x in goals),
        f'{percentile(calls, 50) * 1e-3:.0f}',
        f'{percentile(calls, 99) * 1e-3:.0f}',
        f'{percentile(ways, 50) * 1e-6:.2f}',
        f'{percentile(ways, 99) * 1e-6:.2f}',
    ]


HEAD = (
    'data [min]', 'messages', 'behind by now', 'resident at rest [MiB]', 'most',
    'identified + diagnosed', 'callback p50 [µs]', 'p99 [µs]', 'latency p50 [ms]', 'p99 [ms]',
)  # fmt: skip


class Soak:
    """The hour: what is sent, looked at and told."""

    def __init__(
        self, shared: Shared, node: BaseProcess, client: Client, options: argparse.Namespace
    ) -> None:
        self.shared, self.node, self.client = shared, node, client
        self.steps = round(3600 * RATE * options.hours)
        self.window = round(options.window * RATE)
        self.drives = SPAWN.Process(
            target=publish, args=(shared, self.steps, options.speed), daemon=True
        )
        self.rows = [counted(shared, client.goals)]
        self.memory = [list[float]()]
        self.rests = list[tuple[float, float]]()  # minutes of data, MiB
        self._rest = list[float]()

    def run(self) -> float:
        """Let the data run through; return how long that took, s."""
        shared, client, turn = self.shared, self.client, 1
        self.drives.start()
        client.spin(shared.met.is_set, 'the first message')
        client.clear()
        self.rows = [counted(shared, client.goals)]
        shared.longest[:] = [0, 0]
        shared.begin.set()
        begin = time.monotonic()
        while self.drives.is_alive():
            client.rest(1.0)
            if not self.node.is_alive():
                raise RuntimeError(f'the node ended with code {self.node.exitcode}')
            self._look()
            if turn * self.window <= shared.sent.value < self.steps:
                self._end_rest()
                client.window()
                turn = shared.sent.value // self.window + 1
            if len(self.memory) * PERIOD <= shared.sent.value < self.steps:
                self._tell()
                self.memory.append([])
        if self.drives.exitcode:
            raise RuntimeError('the process that publishes failed')
        seconds = time.monotonic() - begin
        client.finish()
        self._tell()
        return seconds

    def _look(self) -> None:
        self.memory[-1].append(resident(self.node))
        if self.client.resting:
            self._rest.append(self.memory[-1][-1])

    def _end_rest(self) -> None:
        if self._rest:
            self.rests.append((self.shared.sent.value / RATE / 60.0, min(self._rest)))
            self._rest = []

    def _between(self, start: float, end: float) -> list[float]:
        return [x for minute, x in self.rests if start <= minute < end]

    def _tell(self) -> None:
        self.rows.append(counted(self.shared, self.client.goals))
        minutes = [x.sent / RATE / 60.0 for x in self.rows[-2:]]
        row = cells(self.rows[0], *self.rows[-2:], self.memory[-1], self._between(*minutes))
        print('| ' + ' | '.join(row) + ' |', flush=True)

    def judge(self) -> list[str]:
        """Tell the whole; return what is not as it should be."""
        sent = len(TOPICS) * self.shared.sent.value
        came = int((self.rows[-1].ways - self.rows[0].ways).sum())
        wrong = list(self.client.goals.wrong)
        print(
            f'{sent} sent, {sent - came} lost on the way, '
            f'{came - self.client.cleared} between callback and buffer'
        )
        if sent != came or came != self.client.cleared:
            wrong.append('messages are lost')
        wrong += self._grown()
        parts = [
            f'{name}: p50 {percentile(x, 50) * unit:.3g}, p99 {percentile(x, 99) * unit:.3g}, '
            f'p99.9 {percentile(x, 99.9) * unit:.3g}, longest {longest * unit:.3g}'
            for name, x, longest, unit in zip(
                ('callback [µs]', 'latency [ms]'),
                (self.rows[-1].calls - self.rows[0].calls, self.rows[-1].ways - self.rows[0].ways),
                self.shared.longest,
                (1e-3, 1e-6),
                strict=True,
            )
        ]
        print(*parts, sep='\n')
        return wrong

    def _grown(self) -> list[str]:
        """Tell how the memory grew after ten minutes; return what is wrong with that."""
        minute = self.steps / RATE / 60.0
        early, late = self._between(10.0, 20.0), self._between(minute - 10.0, minute)
        if minute < 30.0 or not early or not late:
            return []
        growth = float(np.median(late) - np.median(early))
        at, values = np.array([x for x in self.rests if x[0] >= 10.0]).T
        line = f'resident memory at rest: {growth:+.1f} MiB from minutes 10 to 20 to the last ten'
        if len(at) > 3:
            (slope, _), spread = np.polyfit(at, values, 1, cov=True)
            error = 2.0 * math.sqrt(spread[0, 0])
            rate = minute - 10.0
            line += (
                f'; by a line through {len(at)} looks {slope * rate:+.1f} +- {error * rate:.1f} '
                f'MiB in {rate:.0f} minutes'
            )
        print(line)
        return ['the memory grows'] if growth >= GROWTH else []


@contextlib.contextmanager
def identifier_process(shared: Shared, options: argparse.Namespace) -> Iterator[BaseProcess]:
    """Run the node in a process of its own; it is ended as by Ctrl-C."""
    values = {'machine_file': MACHINE, 'auto_start': 'false'}
    for topic in TOPICS:
        qos = f'qos_overrides./{topic}.subscription'
        values[f'{qos}.depth'] = round(QOS.depth * options.speed)
        if options.reliable:
            values[f'{qos}.reliability'] = 'reliable'
    with tempfile.TemporaryDirectory() as folder:
        values['output_directory'] = folder
        words = [x for k, v in values.items() for x in ('-p', f'{k}:={v}')]
        node = SPAWN.Process(target=run_node, args=(shared, ['--ros-args', *words]))
        node.start()
        try:
            yield node
        finally:
            node.terminate()
            node.join(PATIENCE)
            node.kill()


def main() -> int:
    """Soak, and return 1 where something was lost, grew, or went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=1.0, help='of the data')
    parser.add_argument('--speed', type=float, default=4.0, help='times faster than recorded')
    parser.add_argument('--window', type=float, default=20.0, help='of the data, s')
    parser.add_argument('--reliable', action='store_true', help='the node asks for reliability')
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # the others end, too
    os.environ.update(dict.fromkeys(ONE_THREAD, '1'))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 90 + 10))
    print(measure.machine())
    shared = Shared()
    with identifier_process(shared, options) as node:
        client = Client()
        client.connect()
        print(table(HEAD, []), end='', flush=True)
        soak = Soak(shared, node, client, options)
        seconds = soak.run()
        wrong = soak.judge()
    ended = ', '.join(f'{count} {name}' for name, count in client.goals.ended.items())
    print(f'goals ended: {ended}; {options.hours:g} h in {seconds:.0f} s')
    print(f'{len(wrong)} wrong', *wrong[:20], sep='\n  ')
    return bool(wrong)


if __name__ == '__main__':
    sys.exit(main())
