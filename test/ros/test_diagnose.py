# SPDX-License-Identifier: Apache-2.0
"""The action ~/diagnose and the latched ~/gap, over DDS; one axis, a catalogue of few effects."""

from collections.abc import Iterator
import json
import math
from pathlib import Path
from typing import Any

from identify_cases import axis_bag
import pytest
from ros_helpers import bag_goal, ended, Listener, program, ROOT, served

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from action_msgs.msg import GoalStatus  # noqa: E402
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from ros2_ident_msgs.msg import Status  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from ros2_ident.effects import CATALOGUE  # noqa: E402
from ros2_ident.errors import ErrorCode  # noqa: E402
from ros2_ident.recording import write_bag  # noqa: E402

pytestmark = pytest.mark.ros

BAG = ROOT / 'bags/axis_reversals'
AXIS = ROOT / 'config/emps.yaml'
TRIPOD_BAG, TRIPOD = ROOT / 'bags/tripod_pick_and_place', ROOT / 'config/tripod.yaml'
KEPT = ('coulomb_friction', 'cable_spring', 'torque_ripple')


def goal_of(**changes: Any) -> Any:
    rest = [name for name in CATALOGUE if name not in KEPT]
    return bag_goal('Diagnose', **{'bag_path': str(BAG), 'without_effects': rest} | changes)


@pytest.fixture(scope='module')
def frictionless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The axis as if nobody knew of its Coulomb friction."""
    lines = AXIS.read_text(encoding='utf-8').splitlines(keepends=True)
    path = tmp_path_factory.mktemp('machine') / 'frictionless.yaml'
    path.write_text(''.join(x for x in lines if 'coulomb_friction' not in x), encoding='utf-8')
    return path


@pytest.fixture(scope='module')
def shared(tmp_path_factory: pytest.TempPathFactory, frictionless: Path) -> Iterator[Any]:
    """A node that has nothing to identify by itself, and its listener."""
    words = f'machine_file:={frictionless}', 'drives:=[emps_axis]', 'auto_start:=false'
    with served(tmp_path_factory.mktemp('results'), *words) as made:
        yield made


def test_a_goal_gives_feedback_a_result_and_a_latched_gap(shared: Any) -> None:
    feedback: list[Any] = []
    status, gap = shared.ask(goal_of(seed=3), lambda x: feedback.append(x.feedback), 120.0)
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert (gap.error_code, gap.error_message) == (0, '')
    assert (gap.effect, list(gap.where)) == ('coulomb_friction', ['emps_axis'])
    assert gap.probability > 0.9 and gap.unit == 'N' and gap.held_out == 'blocks'
    assert gap.before_low < gap.before < gap.before_high
    assert gap.after < 1.1 * gap.noise_floor < 0.1 * gap.before
    assert gap.share_closed > 0.99 and gap.seed == 3 and gap.seconds > 0.0
    assert list(gap.drives) == ['emps_axis'] and len(gap.drive_share_closed) == 1
    assert gap.localisation and gap.package_version

    leader = gap.ranking[0]
    assert (leader.effect, leader.probability) == ('coulomb_friction', gap.probability)
    assert math.isnan(leader.gap_after_low)
    found = {p.name: p for p in leader.parameters}
    assert set(found) == {
        'emps_axis.moving_mass',
        'emps_axis.viscous_friction',
        'emps_axis.constant_force',
        'emps_axis.coulomb_friction.torque',
    }
    torque = found['emps_axis.coulomb_friction.torque']
    assert torque.low < 20.4 < torque.high and torque.identifiable and not torque.at_bound
    assert torque.lower_bound <= torque.value <= torque.upper_bound and torque.unit == 'N'
    assert math.isnan(torque.genetic_value)

    stages = [x.stage for x in feedback]
    # A bag may be read before the first feedback is due.
    first = ('reading the recordings', 'identifying the nominal parameters')
    assert stages[0] in first and len(set(stages)) > 2
    fractions = [x.fraction for x in feedback]
    assert all(0.0 <= x <= 1.0 for x in fractions)
    assert [x.elapsed for x in feedback] == sorted(x.elapsed for x in feedback)
    assert 'Coulomb friction' in feedback[-1].best_so_far
    states = [x.state for x in shared.statuses]
    assert Status.STATE_DIAGNOSING in states
    shared.until(lambda: shared.state() == Status.STATE_DONE, 'the status')

    folder = Path(gap.result_file).parent
    assert folder.parent == shared.output
    written = json.loads(Path(gap.result_file).read_text(encoding='utf-8'))
    assert written['verdict']['effect'] == 'coulomb_friction'
    assert written['gap']['before'] == gap.before
    assert 'without_effects' in (folder / 'configuration.yaml').read_text(encoding='utf-8')

    late = Listener(shared.domain)
    try:
        late.until(lambda: late.gaps, 'the latched gap')
        # NaN is not equal to itself, its text is
        assert str(late.gaps[0]) == str(gap)
        late.until(lambda: late.diagnostics, 'the diagnostics')
        entry = next(x for x in late.diagnostics[-1].status if x.name == 'identifier: gap')
    finally:
        late.close()
    assert entry.level == DiagnosticStatus.WARN
    assert entry.message == gap.sentence
    shared.until(lambda: (folder / 'report.html').exists(), 'the page')
    assert 'stribeck' not in {ranked['effect'] for ranked in written['ranking']}
    page = (folder / 'report.html').read_text(encoding='utf-8')
    assert written['verdict']['sentence'] in page.replace('\N{NO-BREAK SPACE}', ' ')


def test_nothing_missing_is_an_answer(shared: Any) -> None:
    count = len(shared.diagnostics)
    status, gap = shared.ask(goal_of(machine_file=str(AXIS), check_bag_path=str(BAG)))
    assert status == GoalStatus.STATUS_SUCCEEDED and gap.error_message == ''
    assert (gap.effect, list(gap.where), list(gap.ranking)) == (gap.EFFECT_NONE, [], [])
    assert gap.held_out == 'check bag'

    def entry() -> Any:
        late = [x for array in shared.diagnostics[count + 2 :] for x in array.status]
        found = [x for x in late if x.name == 'identifier: gap']
        return [x for x in found if 'is missing: the residual is noise' in x.message]

    shared.until(entry, 'the diagnostics')
    assert entry()[-1].level == DiagnosticStatus.OK


def test_cancel_is_answered_at_once_and_keeps_the_best(shared: Any) -> None:
    feedback: list[Any] = []
    handle = shared.send(
        goal_of(
            machine_file=str(TRIPOD),
            bag_path=str(TRIPOD_BAG),
            without_effects=[],
            drives=['drive_1'],
        ),
        lambda x: feedback.append(x.feedback),
    )
    shared.until(lambda: len(feedback) > 1, 'feedback')
    # whatever runs, a goal of either action is refused with the reason
    assert not shared.send(goal_of()).accepted
    assert not shared.send(bag_goal()).accepted
    shared.until(
        lambda: any(
            x.error_code == ErrorCode.BUSY and 'a goal was refused: diagnosing' in x.error_message
            for x in shared.statuses
        ),
        'the reason',
    )
    status, gap = shared.cancel(handle)
    assert status == GoalStatus.STATUS_CANCELED
    assert gap.error_code == ErrorCode.CANCELLED and 'best so far' in gap.error_message
    assert gap.effect and gap.before > 0.0 and list(gap.drives) == ['drive_1']
    assert Path(gap.result_file).exists()
    shared.until(lambda: shared.state() == Status.STATE_CANCELLED, 'the status')


def test_a_spent_budget_is_no_error_and_is_said(shared: Any) -> None:
    status, gap = shared.ask(goal_of(time_budget=0.01))
    assert status == GoalStatus.STATUS_SUCCEEDED and gap.error_code == 0
    assert gap.advice[0].startswith('The time budget of 0.01 s ended the run')


def test_live_data_is_diagnosed(shared: Any) -> None:
    with program(
        'replay', str(BAG), '--rate', '4', '--wait-for-subscribers', '60', domain=shared.domain
    ) as replay:
        code, text = ended(replay)
        assert code == 0, text
    shared.until(lambda: shared.state() == Status.STATE_READY, 'the end of the stream')
    _, gap = shared.ask(goal_of(data_source=0, bag_path=''))
    assert gap.error_message == '' and gap.effect == 'coulomb_friction'
    cleared = shared.call(Trigger, '/identifier/clear_data', Trigger.Request())
    assert int(cleared.message.removesuffix(' messages are forgotten')) > 10_000


# ---------------------------------------------------------------------- warnings, by every outlet


def status_of(listener: Any, entry: str, text: str) -> Any:
    def there() -> Any:
        every = [x for array in listener.diagnostics for x in array.status]
        return [x for x in every if x.name == f'identifier: {entry}' and text in x.message]

    return listener.until(there, text)[-1]


def test_a_missing_command_is_warned_of_everywhere(shared: Any, tmp_path: Path) -> None:
    said = 'no command is used, so the recorded motion drives the model'
    streams = {k: v for k, v in axis_bag().streams.items() if k != '/joint_command'}
    silent = write_bag(tmp_path / 'silent', streams)
    _, result = shared.ask(bag_goal(bag_path=str(silent), machine_file=str(AXIS)))
    assert result.error_code == 0
    assert [w for w in result.warnings if w.startswith(said)]
    fit = status_of(shared, 'fit', said)
    assert fit.level == DiagnosticStatus.WARN
    assert [v for v in fit.values if v.key == 'warning 1' and v.value]
    shared.logged.append(('WARN', said))


def test_a_wrong_gain_is_the_answer_of_both_actions(shared: Any, tmp_path: Path) -> None:
    said, path = 'your velocity_gain is 243.4; 85', tmp_path / 'wrong.yaml'
    text = AXIS.read_text(encoding='utf-8')
    path.write_text(text.replace('velocity_gain: 8557.4257475', 'velocity_gain: 243.45'))
    _, result = shared.ask(bag_goal(bag_path=str(BAG), machine_file=str(path)))
    assert result.outcome == result.OUTCOME_CONTRADICTED
    assert result.error_code == ErrorCode.CONTRADICTED
    assert said in result.outcome_sentence and said in result.error_message
    assert not any(p.identifiable for p in result.parameters)
    assert status_of(shared, 'fit', said).level == DiagnosticStatus.ERROR
    _, gap = shared.ask(goal_of(machine_file=str(path)))
    assert (gap.effect, list(gap.ranking)) == (gap.EFFECT_BOOKKEEPING, [])
    assert said in gap.sentence and gap.sentence.endswith('No effect is named.')
    assert [w for w in gap.warnings if said in w]
    assert status_of(shared, 'gap', said).level == DiagnosticStatus.ERROR
    shared.logged += [('ERROR', said), ('WARN', said)]
