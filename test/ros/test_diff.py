# SPDX-License-Identifier: Apache-2.0
"""The action ~/diff and the latched ~/comparison, over DDS; one axis, few effects."""

from collections.abc import Iterator
import json
import math
from pathlib import Path
from typing import Any, get_args

import pytest
from ros_helpers import bag_goal, ended, Listener, program, ROOT, served

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from action_msgs.msg import GoalStatus  # noqa: E402
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from ros2_ident_msgs.msg import Change, Status  # noqa: E402

from ros2_ident.change.result import Kind  # noqa: E402
from ros2_ident.cli.main import main  # noqa: E402
from ros2_ident.effects import CATALOGUE  # noqa: E402
from ros2_ident.errors import ErrorCode  # noqa: E402

pytestmark = pytest.mark.ros

AXIS = ROOT / 'config/emps.yaml'
KEPT = ('coulomb_friction', 'cable_spring', 'torque_ripple')


def test_every_kind_of_change_is_a_constant_of_the_message():
    named = {getattr(Change, name) for name in dir(Change) if name.startswith('KIND_')}
    assert named == set(get_args(Kind))


@pytest.fixture(scope='module')
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of an axis, a heavier one, and what an identification found of a fourth."""
    folder = tmp_path_factory.mktemp('logs')
    for seed, (name, mass) in enumerate([('one', 75), ('two', 75), ('heavy', 77), ('old', 75)]):
        words = ['simulate', f'{folder}/{name}', '--machine', str(AXIS), '--motion', 'reversals']
        words += ['--seconds', '6', '--seed', str(seed), '--set', f'moving_mass={mass}']
        assert main(words) == 0
    words = ['identify', f'{folder}/old', '--machine', str(AXIS), '--out', f'{folder}/known']
    assert main([*words, '--quiet', '--no-report', '--no-overlay']) == 0
    return folder


@pytest.fixture(scope='module')
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A node that has nothing to identify by itself, and its listener."""
    words = f'machine_file:={AXIS}', 'drives:=[emps_axis]', 'auto_start:=false'
    with served(tmp_path_factory.mktemp('results'), *words) as made:
        yield made


def goal_of(logs: Path, after: str = 'heavy', **changes: Any) -> Any:
    rest = [name for name in CATALOGUE if name not in KEPT]
    asked = {'bag_path': f'{logs}/one', 'without_effects': rest}
    asked |= {'after_bag_path': f'{logs}/{after}'} if after else {}
    return bag_goal('Diff', **asked | changes)


def test_a_goal_names_the_change_and_writes_it(shared: Any, logs: Path) -> None:
    feedback: list[Any] = []
    status, found = shared.ask(goal_of(logs), lambda x: feedback.append(x.feedback))
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert (found.error_code, found.error_message) == (0, '')
    (change,) = found.changes
    assert (change.kind, change.name) == (Change.KIND_PARAMETER, 'emps_axis.moving_mass')
    assert list(change.numbers) == [change.title] == [change.name] and list(change.units) == ['kg']
    assert change.low[0] < 2.0 < change.high[0] and change.low[0] < change.values[0]
    assert change.evidence > 3.0 and found.believed and found.explained > 0.8
    assert found.sentence.startswith('Changed: emps_axis.moving_mass by ')
    friction = next(x for x in found.smallest if x.name == 'emps_axis.coulomb_friction')
    assert friction.values[0] > 0.0 and math.isnan(friction.evidence) and friction.before[0] > 0.0
    assert found.limits[0].startswith('The smallest other change that would have shown: ')
    assert (found.logs_before, found.logs_after) == (1, 1) and found.package_version
    fractions = [x.fraction for x in feedback]
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0
    assert Status.STATE_COMPARING in [x.state for x in shared.statuses]
    shared.until(lambda: shared.state() == Status.STATE_DONE, 'the status')

    folder = Path(found.result_file).parent
    assert folder.parent == shared.output
    written = json.loads(Path(found.result_file).read_text(encoding='utf-8'))
    assert written['changes'][0]['sizes'][0]['value'] == change.values[0]
    assert written['settings']['after_bags'] == [f'{logs}/heavy']
    assert 'after_bags' in (folder / 'configuration.yaml').read_text(encoding='utf-8')
    shared.until(lambda: (folder / 'report.html').exists(), 'the page')

    late = Listener(shared.domain)
    try:
        late.until(lambda: late.comparisons, 'the latched comparison')
        assert str(late.comparisons[0]) == str(found)
        late.until(lambda: late.diagnostics, 'the diagnostics')
        entry = next(x for x in late.diagnostics[-1].status if x.name == 'identifier: comparison')
    finally:
        late.close()
    assert (entry.level, entry.message) == (DiagnosticStatus.WARN, found.sentence)


def test_live_data_are_compared_with_an_earlier_result_known(shared: Any, logs: Path) -> None:
    with program(
        'replay', f'{logs}/two', '--rate', '4', '--wait-for-subscribers', '60',
        domain=shared.domain,
    ) as replay:  # fmt: skip
        code, text = ended(replay)
        assert code == 0, text
    shared.until(lambda: shared.state() == Status.STATE_READY, 'the end of the stream')
    goal = goal_of(logs, '', data_source=0, from_result=f'{logs}/known')
    status, found = shared.ask(goal)
    assert status == GoalStatus.STATUS_SUCCEEDED and found.error_message == ''
    assert not found.changes and math.isnan(found.explained)
    assert found.sentence == 'No change shows.'
    written = json.loads(Path(found.result_file).read_text(encoding='utf-8'))
    assert written['settings']['from'] == f'{logs}/known'


@pytest.mark.parametrize('action', ['Identify', 'Diagnose'])
def test_the_other_actions_take_an_earlier_result_as_known(
    shared: Any, logs: Path, action: str
) -> None:
    known = Path(f'{logs}/known')
    asked = {'without_effects': list(CATALOGUE)} if action == 'Diagnose' else {}
    goal = bag_goal(action, bag_path=f'{logs}/heavy', from_result=str(known), **asked)
    _, found = shared.ask(goal)
    assert found.error_message == ''
    written = json.loads(Path(found.result_file).read_text(encoding='utf-8'))
    assert written['settings']['from'] == str(known)


def test_a_cancel_keeps_what_was_found(shared: Any, logs: Path) -> None:
    feedback: list[Any] = []
    handle = shared.send(goal_of(logs, without_effects=[]), feedback.append)
    shared.until(lambda: feedback, 'feedback')
    status, found = shared.cancel(handle)
    assert status == GoalStatus.STATUS_CANCELED
    assert found.error_code == ErrorCode.CANCELLED
    shared.until(lambda: shared.state() == Status.STATE_CANCELLED, 'the status')


@pytest.mark.parametrize(
    ('changes', 'code', 'said'),
    [
        (
            {'bag_path': ''},
            'INVALID_GOAL',
            'bag_path is empty; give the path of a bag',
        ),
        ({'after_bag_path': ''}, 'INVALID_GOAL', 'data_source is 1 (bag) and after_bag_path is'),
        ({'data_source': 0}, 'INVALID_GOAL', 'after_bag_path is given and data_source is 0'),
        ({'after_bag_path': '/nowhere'}, 'NO_DATA', '/nowhere: does not exist'),
        ({'pairs': True, 'more_bag_paths': [str(AXIS.parent)]}, 'INVALID_GOAL', 'are no pairs'),
        ({'from_result': str(AXIS.parent)}, 'NO_DATA', 'result.json: cannot be read'),
        ({'without_effects': ['gremlins']}, 'UNKNOWN_PARAMETER', "no effect is called 'gremlins'"),
    ],
)
def test_an_unusable_goal_is_answered_with_code_and_sentence(
    shared: Any, logs: Path, changes: dict[str, Any], code: str, said: str
) -> None:
    status, found = shared.ask(goal_of(logs, **changes))
    assert status == GoalStatus.STATUS_ABORTED
    assert found.error_code == ErrorCode[code] and said in found.error_message
    assert not found.result_file and math.isnan(found.explained)
