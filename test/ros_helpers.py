# SPDX-License-Identifier: Apache-2.0
"""Nodes in contexts and programs in processes of their own, and waits with a time-out."""

from collections.abc import Callable, Iterator
import contextlib
import itertools
import os
from pathlib import Path
import signal
import subprocess
import threading
import time
from typing import Any

from forked import forked
import pytest

from ros2_ident.recording import read_bag, write_bag

ROOT = Path(__file__).parents[1]
MACHINE = ROOT / 'config/tripod.yaml'
BAG = ROOT / 'bags/tripod_pick_and_place'
# Longest wait, s, so that a message says for what before pytest ends the test: in a fresh clone
# the first run of a kind compiles, which beside other programs took 260 s. No test asks that a
# process keeps up with another one or with the clock, and a wait ends where its program failed.
PATIENCE = 540.0
HEARD = 'joint_states', 'effort', 'joint_command'
# Samples that a queue holds, whatever its depth (Fast DDS; findings/fastdds_deep_queue.sh): what
# a test waits for has to fit into it.
QUEUE = 5000
# Nothing that such a subscription is sent is lost on a busy machine.
RELIABLE = {
    f'qos_overrides./{topic}.subscription.{policy}': value
    for topic in HEARD
    for policy, value in (('reliability', 'reliable'), ('depth', QUEUE))
}

# Of the two processes of a run of tests each has every other one.
_DOMAINS = itertools.count(
    2 * os.getppid() + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:]), 2
)
_NUMBERS = itertools.count(1)

# How often a condition is looked at, s.
_LOOK = 0.01
# Programs that a test has started.
_STARTED: list[subprocess.Popen[str]] = []


def new_domain() -> int:
    """Return a domain nobody else in this test run uses."""
    return 102 + next(_DOMAINS) % 130  # up to 232 is safe with the default ports


class Station:
    """A node in a context of its own, spun by a thread.

    Args:
        make: Gets the context and returns the node.
        domain: The DDS domain.
    """

    def __init__(self, make: Callable[[Any], Any], domain: int) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = make(self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._done.is_set():
            self.executor.spin_once(0.05)

    def until(self, condition: Callable[[], Any], what: str, seconds: float = PATIENCE) -> Any:
        """Wait until a condition holds, or cannot hold any more: a program of the test failed.

        It is not looked at after each message: of a long series that would keep the interpreter
        from taking the next one.
        """
        deadline = time.monotonic() + seconds
        while not (value := condition()):
            assert time.monotonic() < deadline, f'waited {seconds} s for {what}'
            failed = [x for x in _STARTED if x.poll()]
            assert not failed, f'{what} cannot come any more: {ended(failed[0])}'
            time.sleep(_LOOK)
        return value

    def wait_future(self, future: Any, what: str, seconds: float = PATIENCE) -> Any:
        """Return a future's result."""
        self.until(future.done, what, seconds)
        return future.result()

    def asked(self, ask: Callable[[], Any]) -> Any:
        """Ask something of another node, in the thread that spins; return the future answer.

        rclpy notes which answer it waits for only after it has asked, and an answer that another
        thread takes before that is thrown away.

        Args:
            ask: Returns the future of the answer, as `call_async` does.
        """
        return self.wait_future(self.executor.create_task(ask), 'the executor')

    def request(self, ask: Callable[[], Any], what: str, seconds: float = PATIENCE) -> Any:
        """Ask something of another node, as `asked`; return the answer."""
        return self.wait_future(self.asked(ask), what, seconds)

    def close(self) -> None:
        """Stop spinning and take the node off the air."""
        import rclpy

        self._done.set()
        self._thread.join(10.0)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


class Here(Station):
    """An identifier in this process.

    Args:
        domain: The DDS domain.
        output: Its output directory.
        parameters: Others of its parameters.
    """

    def __init__(self, domain: int, output: Path, **parameters: Any) -> None:
        from rclpy.parameter import Parameter

        from ros2_ident.ros.node import Identifier

        values = {'output_directory': str(output)} | RELIABLE | parameters
        overrides = [Parameter(name, value=value) for name, value in values.items()]

        def make(context: Any) -> Any:
            return Identifier(context=context, parameter_overrides=overrides)

        super().__init__(make, domain)

    def close(self) -> None:
        """End its run, and take it off the air."""
        self.node.stop()
        self.until(lambda: self.node.answered, 'the end of its run')
        self.node.worker.join(60.0)
        super().close()


class Listener(Station):
    """Collects what an identifier publishes, and calls its actions.

    Args:
        domain: The DDS domain.
        name: Full name of the identifier.
    """

    def __init__(self, domain: int, name: str = '/identifier') -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.action import ActionClient
        from rclpy.node import Node
        from ros2_ident_msgs.action import Diagnose, Diff, Identify
        from ros2_ident_msgs.msg import Comparison, Gap, IdentificationResult, Progress, Status
        from sensor_msgs.msg import JointState

        from ros2_ident.ros.outlet import LATCHED

        self.progress: list[Any] = []
        self.results: list[Any] = []
        self.gaps: list[Any] = []
        self.comparisons: list[Any] = []
        self.statuses: list[Any] = []
        self.simulated: list[Any] = []
        self.residual: list[Any] = []
        self.diagnostics: list[Any] = []

        def make(context: Any) -> Any:
            node = Node(f'listener{next(_NUMBERS)}', context=context)
            for kind, topic, kept, qos in (
                (Progress, f'{name}/progress', self.progress, 100),
                (IdentificationResult, f'{name}/result', self.results, LATCHED),
                (Gap, f'{name}/gap', self.gaps, LATCHED),
                (Comparison, f'{name}/comparison', self.comparisons, LATCHED),
                (Status, f'{name}/status', self.statuses, LATCHED),
                (JointState, f'{name}/simulated', self.simulated, QUEUE),
                (JointState, f'{name}/residual', self.residual, QUEUE),
                (DiagnosticArray, '/diagnostics', self.diagnostics, 10),
            ):
                node.create_subscription(kind, topic, kept.append, qos)
            self.actions = {
                kind.Goal: ActionClient(node, kind, f'{name}/{kind.__name__.lower()}')
                for kind in (Identify, Diagnose, Diff)
            }
            return node

        super().__init__(make, domain)

    def send(self, goal: Any, on_feedback: Callable[[Any], None] | None = None) -> Any:
        """Send a goal; return its handle."""
        action = self.actions[type(goal)]
        self.until(action.server_is_ready, 'the action server')
        # it answers only those it knows of; what is latched comes when it does
        self.until(lambda: self.statuses, 'the status')
        return self.request(
            lambda: action.send_goal_async(goal, feedback_callback=on_feedback), 'an answer'
        )

    def ask(
        self,
        goal: Any,
        on_feedback: Callable[[Any], None] | None = None,
        seconds: float = PATIENCE,
    ) -> tuple[int, Any]:
        """Send a goal; return its status at the end, and the result's message."""
        handle = self.send(goal, on_feedback)
        assert handle.accepted
        return self.answer(handle, seconds)

    def answer(self, handle: Any, seconds: float = PATIENCE) -> tuple[int, Any]:
        """Return a goal's status at its end, and the result's message."""
        answer = self.request(handle.get_result_async, 'the result', seconds)
        (field,) = answer.result.get_fields_and_field_types()
        return answer.status, getattr(answer.result, field)

    def cancel(self, handle: Any) -> tuple[int, Any]:
        """Cancel a goal; return its status and the result's message."""
        answer = self.request(handle.cancel_goal_async, 'an answer to the cancel')
        assert len(answer.goals_canceling) == 1
        return self.answer(handle)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, name)
        return self.request(lambda: client.call_async(request), f'an answer of {name}')

    def state(self) -> int:
        """Return the last state, -1 before the first."""
        return self.statuses[-1].state if self.statuses else -1


def bag_goal(kind: str = 'Identify', **changes: Any) -> Any:
    """Return a goal of an action on a bag read directly, some of its fields changed."""
    from ros2_ident_msgs import action

    goal_type = getattr(action, kind).Goal
    source = {'data_source': goal_type.DATA_SOURCE_BAG, 'bag_path': str(BAG)}
    return goal_type(**source | changes)


def short_bag(folder: Path) -> tuple[Path, int]:
    """Write the first 4 s of BAG: so much that queues hold it; return it and its messages."""
    (whole,) = read_bag(BAG)
    part = whole.between(whole.begin, whole.begin + 4 * 10**9)
    topics = dict(zip(('state', 'effort', 'command'), HEARD, strict=True))
    streams = {f'/{topics[role]}': stream for role, stream in part.streams.items()}
    assert max(len(stream.stamp) for stream in streams.values()) < QUEUE
    return write_bag(folder / 'short', streams), sum(len(x.stamp) for x in streams.values())


def environment(domain: int, **more: str) -> dict[str, str]:
    """Return the environment of a program on a domain."""
    return os.environ | {
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'PYTHONPATH': os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')]),
        **more,
    }


@contextlib.contextmanager
def program(
    module: str, *arguments: str, domain: int, **more: str
) -> Iterator[subprocess.Popen[str]]:
    """Run a module of the package in a process of its own; kill it at the end if need be."""
    process = subprocess.Popen(
        [*forked('ros2_ident.ros.node'), '-m', f'ros2_ident.ros.{module}', *arguments],
        env=environment(domain, **more),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    _STARTED.append(process)
    try:
        yield process
    finally:
        _STARTED.remove(process)
        if process.poll() is None:
            process.kill()
            process.communicate()


def identifier(
    domain: int, output: Path, *more: str, remaps: tuple[str, ...] = ()
) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """Run the identifier with a small search; nothing that it is sent is lost."""
    arguments = ['--ros-args']
    for pair in (
        *(f'{name}:={value}' for name, value in RELIABLE.items()),
        f'machine_file:={MACHINE}',
        f'output_directory:={output}',
        'end_of_stream:=1.0',
        'initial_population:=32',
        'generations:=2',
        'drives:=[drive_1]',
        *more,
    ):
        arguments += ['-p', pair]
    for pair in remaps:
        arguments += ['-r', pair]
    return program('identifier', *arguments, domain=domain)


@contextlib.contextmanager
def served(output: Path, *more: str) -> Iterator[Any]:
    """Run an identifier that several tests share and leave as they found it; yield a listener.

    Lines that are put into its `logged` have to be in what the program writes.
    """
    domain = new_domain()
    with identifier(domain, output, 'progress_rate:=50.0', *more) as process:
        made = Listener(domain)
        made.domain, made.output, made.logged = domain, output, []
        yield made
        made.close()
        process.send_signal(signal.SIGTERM)
        code, text = ended(process)
        assert code == 0 and 'Traceback' not in text, text
        for level, words in made.logged:
            assert [x for x in text.splitlines() if f'[{level}]' in x and words in x], words


def ended(process: subprocess.Popen[str], seconds: float = PATIENCE) -> tuple[int, str]:
    """Wait for a program; return its exit code and what it wrote."""
    try:
        text, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        text, _ = process.communicate()
        pytest.fail(f'did not end within {seconds} s: {text[-2000:]}')
    return process.returncode, text
