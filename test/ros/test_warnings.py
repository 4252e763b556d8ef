# SPDX-License-Identifier: Apache-2.0
"""What gates and data warn of reaches every outlet of the node: messages, log, /diagnostics."""

from collections.abc import Iterator
from pathlib import Path
import signal
from typing import Any

from identify_cases import axis_bag, AXIS_FILE
import pytest
from ros_helpers import bag_goal, ended, identifier, Listener, new_domain

from ros.test_diagnose import goal_of
from ros2_ident.recording import write_bag

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from ros2_ident_msgs.msg import ErrorCode  # noqa: E402

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
    found: dict[str, Any] = {}
    domain = new_domain()
    with identifier(
        domain, tmp_path_factory.mktemp('results'), f'machine_file:={AXIS_FILE}',
        'drives:=[emps_axis]', 'auto_start:=false',
    ) as process:
        made = Listener(domain)

        def status_of(entry: str, text: str) -> Any:
            def there() -> Any:
                every = [x for array in made.diagnostics for x in array.status]
                return [x for x in every if x.name == f'identifier: {entry}' and text in x.message]

            return made.until(there, text)[-1]

        try:
            found['silent'] = made.ask(bag_goal(bag_path=str(folder / 'silent')))[1]
            found['fit'] = status_of('fit', SILENT)
            wrong = {'bag_path': goal_of().bag_path, 'machine_file': str(folder / 'wrong.yaml')}
            found['wrong'] = made.ask(bag_goal(**wrong))[1]
            found['wrong fit'] = status_of('fit', GAIN)
            found['gap'] = made.ask(goal_of(**wrong))[1]
            found['gap status'] = status_of('gap', GAIN)
        finally:
            made.close()
            process.send_signal(signal.SIGTERM)
            found['code'], found['log'] = ended(process)
    return found


def lines(heard: dict[str, Any], level: str, text: str) -> list[str]:
    return [x for x in heard['log'].splitlines() if f'[{level}]' in x and text in x]


def test_a_missing_command_is_warned_of_everywhere(heard: dict[str, Any]) -> None:
    result = heard['silent']
    assert result.error_code == 0
    assert [w for w in result.warnings if w.startswith(SILENT)]
    assert lines(heard, 'WARN', SILENT)
    assert heard['fit'].level == DiagnosticStatus.WARN
    assert [v for v in heard['fit'].values if v.key == 'warning 1' and v.value]


def test_a_wrong_gain_is_the_answer_of_both_actions(heard: dict[str, Any]) -> None:
    result, gap = heard['wrong'], heard['gap']
    assert result.outcome == result.OUTCOME_CONTRADICTED
    assert result.error_code == ErrorCode.CONTRADICTED
    assert GAIN in result.outcome_sentence and GAIN in result.error_message
    assert not any(p.identifiable for p in result.parameters)
    assert (gap.effect, list(gap.ranking)) == (gap.EFFECT_BOOKKEEPING, [])
    assert GAIN in gap.sentence and gap.sentence.endswith('No effect is named.')
    assert [w for w in gap.warnings if GAIN in w]
    assert lines(heard, 'ERROR', GAIN) and lines(heard, 'WARN', GAIN)
    for entry in ('wrong fit', 'gap status'):
        assert heard[entry].level == DiagnosticStatus.ERROR
    assert heard['code'] == 0 and 'Traceback' not in heard['log'], 'nothing broke meanwhile'
