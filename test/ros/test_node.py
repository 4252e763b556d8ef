# SPDX-License-Identifier: Apache-2.0
"""The identifier in a process of its own, over DDS."""

import json
import math
from pathlib import Path
import signal
import subprocess

import pytest
from ros_helpers import (
    BAG,
    bag_goal,
    ended,
    identifier,
    Listener,
    new_domain,
    program,
    ROOT,
    served,
    short_bag,
)

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from action_msgs.msg import GoalStatus  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.qos import qos_profile_parameters as deep  # noqa: E402
from ros2_ident_msgs.action import Identify  # noqa: E402
from ros2_ident_msgs.msg import (  # noqa: E402
    IdentificationResult,
    Status,  # noqa: E402
)
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from ros2_ident.errors import ErrorCode  # noqa: E402

pytestmark = pytest.mark.ros

AXIS_BAG = ROOT / 'bags/axis_reversals'


@pytest.fixture
def domain() -> int:
    return new_domain()


@pytest.fixture
def listener(domain):
    made = Listener(domain)
    yield made
    made.close()


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """A node and its listener for the tests that leave it as they found it."""
    with served(tmp_path_factory.mktemp('results')) as made:
        yield made


def last_series(messages) -> int:
    """Return how many messages came since the stamps last stepped back.

    Previews of better and better candidates come before the whole series.
    """
    stamps = [x.header.stamp.sec * 10**9 + x.header.stamp.nanosec for x in messages]
    back = [k for k in range(1, len(stamps)) if stamps[k] < stamps[k - 1]]
    return len(stamps) - (back[-1] if back else 0)


def test_a_replayed_bag_is_identified_and_a_late_subscriber_gets_the_result(
    domain: int, tmp_path: Path
) -> None:
    bag, count = short_bag(tmp_path)
    with identifier(domain, tmp_path / 'results') as node:
        early = Listener(domain)
        try:
            with program(
                'replay', str(bag), '--rate', '3', '--wait-for-subscribers', '60', domain=domain
            ) as replay:
                code, text = ended(replay)
                assert code == 0, text
            early.until(lambda: early.results, 'the result')
            assert sum(early.statuses[-1].received) == count
            heard = early.statuses[-1].received[1]
            early.until(
                lambda: (
                    min(last_series(early.residual), last_series(early.simulated)) >= 0.95 * heard
                ),
                'the whole residual',
            )
            assert early.progress and len(early.progress[-1].best_theta) == 7
            assert early.progress[-1].parameter_units[0] == 's'
            assert {x.state for x in early.statuses} >= {
                Status.STATE_RECORDING,
                Status.STATE_IDENTIFYING,
                Status.STATE_DONE,
            }
            names = {x.name for x in early.diagnostics[-1].status}
            assert names == {
                f'identifier: {x}'
                for x in ('data', 'excitation', 'search', 'fit', 'gap', 'comparison')
            }
        finally:
            early.close()
        late = Listener(domain)
        try:
            late.until(lambda: late.results, 'the latched result')
            late.until(lambda: late.state() == Status.STATE_DONE, 'the latched status')
            result = late.results[0]
        finally:
            late.close()
        node.send_signal(signal.SIGINT)
        assert ended(node)[0] == 0
    assert result.error_code == 0 and result.outcome == IdentificationResult.OUTCOME_CONVERGED
    assert list(result.drives) == ['drive_1']
    by_name = {p.name: p for p in result.parameters}
    mass = by_name['tool_mass']
    assert mass.low < 1.762 < mass.high and mass.unit == 'kg'
    assert result.cost_refined < 0.011
    assert list(early.simulated[0].name) == ['drive_1']
    folder = Path(result.result_file).parent
    assert folder.parent == tmp_path / 'results'
    assert json.loads(Path(result.result_file).read_text(encoding='utf-8'))['parameters']
    assert (folder / 'overlay/metadata.yaml').exists()


def test_a_goal_gives_feedback_and_a_result_and_its_overrides_reach_the_search(shared) -> None:
    feedback = []
    goal = bag_goal(
        seed=3,
        refine=False,
        override_names=['tool_mass', 'gear_damping_ratio'],
        override_lower=[1.7, math.nan],
        override_upper=[math.nan, math.nan],
        override_fixed=[math.nan, 0.4],
    )
    status, result = shared.ask(goal, feedback.append)
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert result.error_code == 0 and result.seed == 3
    assert result.bag_path == str(BAG) and len(result.bag_sha256) == 64
    assert feedback and feedback[-1].feedback.progress.evaluations > 0
    assert len(result.parameters) ** 2 == len(result.correlation)
    found = {p.name: p for p in result.parameters}
    assert found['tool_mass'].lower_bound == 1.7 and found['tool_mass'].upper_bound == 2.0
    assert 'drive_1.gear_damping_ratio' not in found


def test_a_second_goal_is_refused_with_a_reason(shared) -> None:
    """So are twenty at once; each is answered, as is each cancel, and the run goes on.

    Its own cancel keeps the best.
    """
    # the queue in which answers wait for a client is its own
    qos = dict.fromkeys(('goal_service_qos_profile', 'cancel_service_qos_profile'), deep)
    client = ActionClient(shared.node, Identify, '/identifier/identify', **qos)
    shared.until(client.server_is_ready, 'the server')
    feedback = []
    # A seed of its own: with another test's it would go on where that was cancelled.
    goal = bag_goal(initial_population=4000, seed=11, drives=['drive_1', 'drive_2', 'drive_3'])
    first = shared.send(goal, feedback.append)
    result = shared.asked(first.get_result_async)
    shared.until(lambda: len(feedback) > 2, 'feedback')
    asked = shared.asked(lambda: [client.send_goal_async(goal) for _ in range(20)])
    others = [shared.wait_future(x, 'an answer to a goal') for x in asked]
    assert not any(x.accepted for x in others)
    asked = shared.asked(lambda: [x.cancel_goal_async() for x in others])
    for one in asked:
        assert not shared.wait_future(one, 'an answer to a cancel').goals_canceling
    assert not result.done()
    status, found = shared.cancel(first)
    assert status == GoalStatus.STATUS_CANCELED
    assert found.outcome == found.OUTCOME_CANCELLED
    assert found.cost_genetic < 1.0 and len(found.parameters) == 17
    shared.until(lambda: shared.state() == Status.STATE_CANCELLED, 'the status')
    refused = [x for x in shared.statuses if x.error_code == ErrorCode.BUSY]
    assert refused and 'a goal was refused' in refused[0].error_message


WRONG = {
    ('Identify', 'Diagnose'): [
        ({'data_source': 0, 'bag_path': ''}, 'NO_DATA', '/joint_states has 0 publishers'),
        ({'bag_path': ''}, 'INVALID_GOAL', 'bag_path is empty'),
        ({'bag_path': '/nowhere'}, 'NO_DATA', '/nowhere: does not exist'),
        ({'check_bag_path': '/nowhere'}, 'NO_DATA', '/nowhere: does not exist'),
        ({'data_source': 0}, 'INVALID_GOAL', 'bag_path is given and data_source is 0'),
        ({'machine_file': '/nowhere.yaml'}, 'BAD_MACHINE_FILE', 'cannot be read'),
        ({'machine_file': str(ROOT / 'Makefile')}, 'BAD_MACHINE_FILE', 'Makefile'),
        ({'drives': ['drive_9']}, 'INVALID_GOAL', 'drive_9'),
        ({'override_names': ['tool_mass']}, 'INVALID_GOAL', 'no value is given'),
        (
            {'override_names': ['tool_mass'], 'override_fixed': [1.0, 2.0]},
            'INVALID_GOAL',
            'override_fixed has 2 values',
        ),
        (
            {'override_names': ['mass'], 'override_fixed': [1.0]},
            'UNKNOWN_PARAMETER',
            'choose from measurement_delay',
        ),
        ({'bag_path': '~nobody_at_all/log'}, 'INVALID_GOAL', 'is no path'),
        ({'bag_path': '/' + 'a' * 5000}, 'INVALID_GOAL', 'is no path (File name too long)'),
        ({'time_budget': float('nan')}, 'INVALID_GOAL', 'time_budget is nan'),
    ],
    ('Identify',): [
        ({'model': 'belt_drive'}, 'INVALID_GOAL', 'describes a tripod'),
        ({'range_reduction': 3.0}, 'INVALID_GOAL', 'range_reduction is 3.0'),
        ({'initial_population': 10**8}, 'INVALID_GOAL', 'its range is 1 to 1e+07'),
    ],
    ('Diagnose',): [
        ({'check_bag_path': str(AXIS_BAG)}, 'MISSING_STREAM', 'drive_1'),
        ({'without_effects': ['gremlins']}, 'UNKNOWN_PARAMETER', "no effect is called 'gremlins'"),
        ({'output': 'torque'}, 'INVALID_GOAL', "output is 'torque'; choose from effort, position"),
    ],
}


@pytest.mark.parametrize(
    ('kind', 'changes', 'code', 'said'),
    [(kind, *case) for kinds, cases in WRONG.items() for kind in kinds for case in cases],
)
def test_an_unusable_goal_is_answered_with_code_and_sentence(
    shared, kind: str, changes: dict, code: str, said: str
) -> None:
    before = len(shared.results)
    status, found = shared.ask(bag_goal(kind, **changes))
    assert status == GoalStatus.STATUS_ABORTED
    assert found.error_code == ErrorCode[code]
    assert said in found.error_message and not found.result_file
    assert math.isnan(found.before if kind == 'Diagnose' else found.cost_genetic)
    assert len(shared.results) == before, 'a goal that never ran leaves the last result alone'


def test_services(shared) -> None:
    answer = shared.call(Trigger, '/identifier/save_result', Trigger.Request())
    assert answer.success and Path(answer.message).exists()
    assert Path(answer.message).parent.parent == shared.output
    page = Path(answer.message).with_name('report.html')
    shared.until(page.exists, 'the page')
    answer = shared.call(Trigger, '/identifier/clear_data', Trigger.Request())
    assert answer.success and answer.message == '0 messages are forgotten'


@pytest.mark.parametrize(('kind', 'file'), [('Identify', 'result'), ('Diagnose', 'diagnosis')])
def test_a_signal_ends_a_run_answers_its_goal_and_keeps_its_result(
    domain: int, listener: Listener, tmp_path: Path, kind: str, file: str
) -> None:
    # Long enough on any machine to be in the middle of it.
    with identifier(domain, tmp_path, 'initial_population:=1000000') as node:
        feedback = []
        handle = listener.send(bag_goal(kind), feedback.append)
        listener.until(lambda: len(feedback) > 1, 'feedback')
        done = listener.asked(handle.get_result_async)
        node.send_signal(signal.SIGINT)
        answered = listener.wait_future(done, 'the result')
        code, text = ended(node)
    assert code == 0 and 'Traceback' not in text, text
    assert answered.status == GoalStatus.STATUS_ABORTED
    latched = listener.results if kind == 'Identify' else listener.gaps
    listener.until(lambda: latched, 'the last result')
    assert latched[0].error_code == ErrorCode.CANCELLED and latched[0].error_message
    assert len(list(tmp_path.glob(f'*/{file}.json'))) == 1
    if kind == 'Identify':
        assert latched[0].outcome == latched[0].OUTCOME_CANCELLED
        assert len(latched[0].parameters) == 7


def test_two_nodes_on_one_domain_do_not_interfere(shared, tmp_path: Path) -> None:
    elsewhere = (
        '__ns:=/cell',
        'joint_states:=/a/x',
        'effort:=/a/effort',
        'joint_command:=/a/command',
    )
    before = len(shared.results)
    with identifier(shared.domain, tmp_path, remaps=elsewhere) as second:
        two = Listener(shared.domain, '/cell/identifier')
        try:
            runs = [
                (one, one.send(bag_goal(seed=seed, refine=False)))
                for one, seed in ((shared, 11), (two, 12))
            ]
            found = [one.answer(run)[1] for one, run in runs]
            assert [x.error_message for x in found] == ['', '']
            assert [x.seed for x in found] == [11, 12]
            assert two.statuses[-1].streams == ['/a/x', '/a/effort', '/a/command']
            assert shared.statuses[-1].streams[0] == '/joint_states'
            shared.until(lambda: len(shared.results) > before, 'the latched result')
            two.until(lambda: two.results, 'the latched result')
            assert len(two.results) == 1 and len(shared.results) == before + 1
            assert (shared.results[-1].seed, two.results[0].seed) == (11, 12)
        finally:
            two.close()
        second.send_signal(signal.SIGINT)
        assert ended(second)[0] == 0


def test_silence_is_explained(domain: int, listener: Listener, tmp_path: Path) -> None:
    listener.node.create_publisher(String, '/joint_states', 10)
    with identifier(domain, tmp_path) as node:
        listener.until(
            lambda: any('wrong type std_msgs/msg/String' in x.sentence for x in listener.statuses),
            'the sentence',
        )
        node.send_signal(signal.SIGTERM)
        _, text = ended(node)
    assert 'no data yet: /joint_states has a publisher of the wrong type' in text
    assert '/effort has 0 publishers' in text


def test_replay_stops_on_a_signal(domain: int) -> None:
    with program('replay', str(BAG), '--rate', '0.1', domain=domain) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith('replay: ') and ' messages of ' in line, line
        process.send_signal(signal.SIGINT)
        code, text = ended(process)
    assert code == 130 and 'Traceback' not in text, text
    assert isinstance(process, subprocess.Popen)
