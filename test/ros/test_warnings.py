# SPDX-License-Identifier: Apache-2.0
"""What gates and data warn of reaches every outlet of the node: messages, log, /diagnostics."""

from collections.abc import Iterator
from pathlib import Path
import signal
from typing import Any

from identify_cases import axis_bag, AXIS_FILE
import pytest
from ros_helpers import ended, identifier, new_domain

from ros.test_diagnose import Diagnostician, goal_of
from ros2_ident.recording import write_bag

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

GAIN = 'your velocity_gain is 243.4; 85'
SILENT = 'there is no command, so the recorded motion drives the model'


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where a bag without a command and a machine file with a wrong gain lie."""
    path = tmp_path_factory.mktemp('warnings')
    streams = {k: v for k, v in axis_bag().streams.items() if k != '/joint_command'}
    write_bag(path / 'silent', streams)
    text = AXIS_FILE.read_text(encoding='utf-8')
    (path / 'wrong.yaml').write_text(
        text.replace('velocity_gain: 8557.4257475', 'velocity_gain: 243.45'), encoding='utf-8'
    )
    return path


@pytest.fixture(scope='module')
def heard(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Return what a node answers three goals with, and what it says meanwhile."""
    from ros2_ident_msgs.action import Identify

    found: dict[str, Any] = {}
    domain = new_domain()
    with identifier(
        domain, tmp_path_factory.mktemp('results'), f'machine_file:={AXIS_FILE}',
        'drives:=[emps_axis]', 'auto_start:=false',
    ) as process:
        made = Diagnostician(domain)

        def status_of(entry: str, text: str) -> Any:
            def there() -> Any:
                every = [x for array in made.diagnostics for x in array.status]
                return [x for x in every if x.name == f'identifier: {entry}' and text in x.message]

            return made.until(there, text)[-1]

        def identified(**changes: str) -> Any:
            goal = Identify.Goal(data_source=Identify.Goal.DATA_SOURCE_BAG, **changes)
            mine, made.action = made.action, made.identify
            answer = made.request(made.send(goal).get_result_async, 'the result')
            made.action = mine
            return answer.result.identification

        try:
            found['silent'] = identified(bag_path=str(folder / 'silent'))
            found['fit'] = status_of('fit', SILENT)
            found['wrong'] = identified(
                bag_path=goal_of().bag_path,
                machine_file=str(folder / 'wrong.yaml'),
            )
            found['wrong fit'] = status_of('fit', GAIN)
            found['gap'] = made.diagnose(goal_of(machine_file=str(folder / 'wrong.yaml')))[1]
            found['gap status'] = status_of('gap', GAIN)
        finally:
            made.close()
            process.send_signal(signal.SIGTERM)
            found['code'], found['log'] = ended(process)
    return found


def lines(heard: dict[str, Any], level: str, text: str) -> list[str]:
    return [x for x in heard['log'].splitlines() if f'[{level}]' in x and text in x]


def test_a_missing_command_is_warned_of_everywhere(heard: dict[str, Any]) -> None:
    from diagnostic_msgs.msg import DiagnosticStatus

    result = heard['silent']
    assert result.error_code == 0
    assert [w for w in result.warnings if w.startswith(SILENT)]
    assert lines(heard, 'WARN', SILENT)
    assert heard['fit'].level == DiagnosticStatus.WARN
    assert [v for v in heard['fit'].values if v.key == 'warning 1' and v.value]


def test_a_wrong_gain_is_the_answer_of_an_identification(heard: dict[str, Any]) -> None:
    from diagnostic_msgs.msg import DiagnosticStatus
    from ros2_ident_msgs.msg import ErrorCode

    result = heard['wrong']
    assert result.outcome == result.OUTCOME_CONTRADICTED
    assert result.error_code == ErrorCode.CONTRADICTED
    assert GAIN in result.outcome_sentence and GAIN in result.error_message
    assert not any(p.identifiable for p in result.parameters)
    assert lines(heard, 'ERROR', GAIN)
    assert heard['wrong fit'].level == DiagnosticStatus.ERROR


def test_a_wrong_gain_is_the_answer_of_a_diagnosis(heard: dict[str, Any]) -> None:
    from diagnostic_msgs.msg import DiagnosticStatus

    gap = heard['gap']
    assert gap.effect == gap.EFFECT_BOOKKEEPING
    assert GAIN in gap.sentence and gap.sentence.endswith('No effect is named.')
    assert [w for w in gap.warnings if GAIN in w]
    assert list(gap.ranking) == []
    assert lines(heard, 'WARN', GAIN)
    assert heard['gap status'].level == DiagnosticStatus.ERROR


def test_nothing_broke_meanwhile(heard: dict[str, Any]) -> None:
    assert heard['code'] == 0
    assert 'Traceback' not in heard['log']
