# SPDX-License-Identifier: Apache-2.0
"""The node answers, whatever happens: every goal has a result, no result is lost."""

from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from ros_helpers import (
    BAG,
    bag_goal,
    ended,
    environment,
    Here,
    identifier,
    Listener,
    MACHINE,
    new_domain,
)

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from action_msgs.msg import GoalStatus  # noqa: E402
from action_msgs.srv import CancelGoal  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from ros2_ident_msgs.action import Identify  # noqa: E402
from ros2_ident_msgs.msg import Status  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from ros2_ident.errors import ErrorCode  # noqa: E402
from ros2_ident.recording import read_bag  # noqa: E402
from ros2_ident.recording.cdr import encode  # noqa: E402
from ros2_ident.recording.streams import FIELDS  # noqa: E402
from ros2_ident.report import files  # noqa: E402
from ros2_ident.ros import outlet  # noqa: E402

pytestmark = pytest.mark.ros


def small(domain, output, **parameters) -> Here:
    """Return an identifier of the tripod with a small search."""
    search = {'initial_population': 32, 'generations': 2, 'drives': ['drive_1']}
    return Here(domain, output, **{'machine_file': str(MACHINE), **search} | parameters)


@pytest.fixture
def start(tmp_path):
    """Return a function that starts an identifier and who talks to it."""
    made = []

    def make(**parameters):
        domain = new_domain()
        made.append(small(domain, tmp_path / 'results', **parameters))
        made.append(Listener(domain))
        return made[-2], made[-1]

    yield make
    for one in made[::-1]:
        one.close()


def answer(listener, **changes):
    return listener.ask(bag_goal(**changes))[1]


def test_the_end_of_the_node_waits_for_the_overlay_of_a_run_that_is_done(tmp_path) -> None:
    domain = new_domain()
    with identifier(domain, tmp_path) as process:
        listener = Listener(domain)
        try:
            listener.send(bag_goal(refine=False))
            listener.until(lambda: listener.results, 'the result')
            process.send_signal(signal.SIGTERM)
            found = Path(listener.results[0].result_file).parent
        finally:
            listener.close()
        code, text = ended(process)
    assert code == 0 and 'Traceback' not in text, text
    assert (found / 'overlay/metadata.yaml').exists()


def test_a_second_signal_ends_at_once() -> None:
    code = (
        'import threading\n'
        'from ros2_ident.ros.identifier import Stop\n'
        'stop = Stop()\n'
        'print("ready", flush=True)\n'
        'try:\n'
        '    while not stop.signal: threading.Event().wait(0.01)\n'
        '    print("first", flush=True)\n'
        '    threading.Event().wait()\n'
        'finally:\n'
        '    threading.Event().wait()\n'
    )
    process = subprocess.Popen(
        [sys.executable, '-c', code], env=environment(0), stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == 'ready\n'
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == 'first\n'
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] == 128 + signal.SIGINT


def test_a_run_that_does_not_end_is_answered_all_the_same(start) -> None:
    node, listener = start(initial_population=1000000)
    feedback = []
    handle = listener.send(bag_goal(), feedback.append)
    done = listener.asked(handle.get_result_async)
    listener.until(lambda: feedback, 'feedback')
    node.executor.create_task(node.node.give_up)
    answered = listener.wait_future(done, 'the result')
    assert answered.status == GoalStatus.STATUS_ABORTED
    result = answered.result.identification
    assert result.error_code == ErrorCode.CANCELLED
    assert 'did not end in time' in result.error_message


@pytest.mark.parametrize(
    'where', ['ros.actions.wanted_of', 'jobs.identify', 'ros.conversion._outcome']
)
def test_whatever_is_raised_becomes_an_answer_with_a_code(start, monkeypatch, where) -> None:
    def fail(*arguments, **options):
        raise ZeroDivisionError('of a test')

    monkeypatch.setattr(f'ros2_ident.{where}', fail)
    _, listener = start()
    found = answer(listener)
    assert found.error_code == ErrorCode.INTERNAL
    assert 'ZeroDivisionError: of a test' in found.error_message


def test_a_cancel_that_is_taken_together_with_its_goal_is_heeded(start) -> None:
    node, listener = start(initial_population=1000000)
    all_goals = listener.node.create_client(CancelGoal, '/identifier/identify/_action/cancel_goal')
    listener.until(all_goals.service_is_ready, 'the service')
    action = listener.actions[type(bag_goal())]
    listener.until(lambda: action.server_is_ready() and listener.statuses, 'the node')
    node.executor.create_task(lambda: time.sleep(0.5))  # both wait meanwhile
    sent = listener.asked(lambda: action.send_goal_async(bag_goal()))
    asked = listener.asked(lambda: all_goals.call_async(CancelGoal.Request()))
    assert listener.wait_future(asked, 'an answer').goals_canceling
    handle = listener.wait_future(sent, 'an answer')
    assert listener.answer(handle)[0] == GoalStatus.STATUS_CANCELED


def test_a_full_disk_leaves_the_result_on_the_topic_and_to_be_saved(start, monkeypatch) -> None:
    def full(*arguments, **options):
        raise OSError(28, 'No space left on device')

    written = files.write_result
    monkeypatch.setattr(files, 'write_result', full)
    node, listener = start()
    found = answer(listener)
    assert found.error_code == 0 and found.parameters and not found.result_file
    assert 'No space left on device' in found.warnings[-1]
    listener.until(lambda: listener.results, 'the result on its topic')
    said = listener.call(Trigger, '/identifier/save_result', Trigger.Request())
    assert not said.success and 'No space left on device' in said.message
    monkeypatch.setattr(files, 'write_result', written)
    said = listener.call(Trigger, '/identifier/save_result', Trigger.Request())
    assert said.success and Path(said.message).exists()


def test_goals_stay_inside_the_allowed_directory(start, tmp_path) -> None:
    (tmp_path / 'in').mkdir()
    (tmp_path / 'in/link').symlink_to(BAG)
    _, listener = start(allowed_directory=str(tmp_path / 'in'))
    for changes in (
        {'bag_path': str(BAG)},
        {'bag_path': str(tmp_path / 'in/link')},
        {'bag_path': str(tmp_path / 'in/../x')},
        {'machine_file': str(MACHINE)},
        {'differences_file': '/etc/passwd'},
    ):
        found = answer(listener, **changes)
        assert found.error_code == ErrorCode.INVALID_GOAL
        assert 'lies outside of allowed_directory' in found.error_message


def test_a_wrong_machine_file_is_told_at_the_start_and_when_it_is_set(start) -> None:
    node, listener = start(machine_file='/nowhere.yaml')
    listener.until(lambda: listener.statuses, 'the status')
    assert listener.statuses[0].error_code == ErrorCode.BAD_MACHINE_FILE
    (said,) = node.node.set_parameters([Parameter('machine_file', value='/nor_there.yaml')])
    assert not said.successful and '/nor_there.yaml: cannot be read' in said.reason


def test_a_directory_that_cannot_be_written_is_told_at_the_start_when_set_and_to_a_goal(
    start, tmp_path
) -> None:
    node, listener = start(output_directory='/proc/nope')
    listener.until(lambda: listener.statuses, 'the status')
    assert '/proc/nope: cannot be made' in listener.statuses[0].error_message
    found = answer(listener)
    assert found.error_code == ErrorCode.INVALID_GOAL
    assert '/proc/nope: cannot be made' in found.error_message
    said, taken = (
        node.node.set_parameters([Parameter('output_directory', value=str(x))])[0]
        for x in ('/proc/nor_there', tmp_path / 'there')
    )
    assert not said.successful and '/proc/nor_there: cannot be made' in said.reason
    assert taken.successful and answer(listener).result_file


def test_what_was_heard_is_found_again_after_a_restart(tmp_path) -> None:
    (recording,) = read_bag(BAG)
    domain = new_domain()
    node = small(domain, tmp_path, auto_start=False, end_of_stream=0.5)
    topics = {'state': 'joint_states', 'effort': 'effort', 'command': 'joint_command'}
    count = 2500
    for role, stream in recording.streams.items():
        data = encode(stream.stamp, stream.names, [stream.values(x) for x in FIELDS])
        publisher = node.node.create_publisher(JointState, topics[role], count)
        node.until(publisher.get_subscription_count, 'a subscription')
        for k in range(0, count, 100):
            for message in data[k : k + 100]:
                publisher.publish(message)
            inbox = node.node.capture._inbox[role]
            node.until(
                lambda inbox=inbox, k=k: len(inbox.data) + inbox.meter.received >= k + 100,
                'the messages',
            )
    node.until(lambda: node.node.board.state == Status.STATE_READY, 'the end of the stream')
    node.close()
    domain = new_domain()
    node, listener = small(domain, tmp_path, auto_start=False), Listener(domain)
    try:
        listener.until(lambda: listener.state() == Status.STATE_READY, 'what was heard')
        assert '7500 messages from before the start are held' in listener.statuses[-1].sentence
        (found,) = node.node.received().build()
        for role, stream in recording.streams.items():
            other = found.streams[role]
            np.testing.assert_array_equal(other.stamp, stream.stamp[:count])
            for field in FIELDS:
                if (values := stream.values(field)) is not None:
                    np.testing.assert_array_equal(other.values(field), values[:count])
        assert listener.ask(Identify.Goal(refine=False))[1].error_message == ''
    finally:
        listener.close()
        node.close()


def test_pages_are_written_one_after_the_other_and_a_page_left_out_is_named(
    tmp_path, monkeypatch
) -> None:
    log = tmp_path / 'log'
    script = f'echo begin "$0" >> {log}; sleep 0.1; echo end "$0" >> {log}'
    monkeypatch.setattr(outlet, '_REPORT', ['sh', '-c', script])
    monkeypatch.setattr(outlet, '_MOST_PAGES', 3)
    pages = outlet.PageWriter()
    for number in range(6):
        pages.start(str(tmp_path / f'run {number}/result.json'))
    said = pages.failures()
    while pages._process is not None:
        said += pages.failures()
        time.sleep(0.01)
    folders = [tmp_path / f'run {number}' for number in (0, 3, 4, 5)]
    wanted = [f'{word} {folder}' for folder in folders for word in ('begin', 'end')]
    assert log.read_text(encoding='utf-8').splitlines() == wanted
    assert [
        f"for run in '{tmp_path}/run {number}'; do ident report" in x
        for number, x in enumerate(said, 1)
    ] == [True, True]
