# SPDX-License-Identifier: Apache-2.0
"""The parameters: one table, and sentences for what does not fit it."""

import runpy
import subprocess
import sys

import pytest
from ros_helpers import environment, new_domain, ROOT, Station

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from ros2_ident.errors import IdentError  # noqa: E402
from ros2_ident.ros import parameters  # noqa: E402

pytestmark = pytest.mark.ros


@pytest.fixture
def node():
    """A bare node that gets parameters declared."""
    stations = []

    def make(*arguments: str):
        words = ['--ros-args', *arguments]
        stations.append(
            Station(lambda x: Node('identifier', context=x, cli_args=words), new_domain())
        )
        return stations[-1].node

    yield make
    for station in stations:
        station.close()


def test_template_and_page_are_made_from_the_table() -> None:
    for path, text in runpy.run_path(str(ROOT / 'tools/parameters.py'))['generated']().items():
        assert path.read_text(encoding='utf-8') == text, (
            f'{path.name} is out of date; run python tools/parameters.py'
        )


def test_defaults_are_declared_with_descriptions_and_ranges(node) -> None:
    made = node()
    parameters.declare(made)
    snapshot = parameters.snapshot(made)
    for entry in parameters.BY_NAME.values():
        assert snapshot[entry.name] == entry.default
        described = made.describe_parameter(entry.name)
        assert described.description == entry.description
        assert described.read_only == entry.read_only
        ranges = [*described.integer_range, *described.floating_point_range]
        assert len(ranges) == (entry.low is not None)


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ('time_budget:=10', 'time_budget is 10 and has to be of type double; write it like 10.0'),
        ('seed:=0', 'seed is 0, its range is from 1; give a value inside it'),
        ('seed:=1.5', 'seed is 1.5 and has to be of type integer'),
        ('end_of_stream:=0.1', 'end_of_stream is 0.1, its range is 0.2 to 3600'),
        ('mutation:=wild', "mutation is 'wild'; write one of gaussian_root, laplace, normal"),
        ('drives:=3', 'drives is 3 and has to be of type string array'),
    ],
)
def test_an_unfitting_value_is_answered_in_a_sentence(node, given: str, said: str) -> None:
    with pytest.raises(IdentError) as caught:
        parameters.declare(node('-p', given))
    assert said in caught.value.message


def test_a_misspelt_parameter_is_noticed(node) -> None:
    made = node('-p', 'generation:=3')
    parameters.declare(made)
    assert parameters.unknown(made) == [
        'parameter generation is not known and has no effect; did you mean generations?'
    ]


def test_changes_are_checked_like_the_first_values(node) -> None:
    made = node()
    parameters.declare(made)
    made.add_on_set_parameters_callback(parameters.check_change)
    assert made.set_parameters([Parameter('seed', value=5)])[0].successful
    answer = made.set_parameters([Parameter('mutation', value='wild')])[0]
    assert not answer.successful and 'gaussian_root' in answer.reason
    assert not made.set_parameters([Parameter('seed', value=-1)])[0].successful
    assert not made.set_parameters([Parameter('result_timeout', value=20.0)])[0].successful
    assert parameters.snapshot(made)['seed'] == 5


@pytest.mark.parametrize(
    ('missing', 'arguments', 'code', 'said'),
    [
        (
            None,
            ['--ros-args', '-p', 'time_budget:=1'],
            2,
            'parameter time_budget is 1 and has to be of type double; write it like 1.0',
        ),
        ('ros2_ident_msgs', [], 1, 'package ros2_ident_msgs not found; build it with'),
        ('rclpy', [], 1, 'rclpy not found; source ROS 2 Jazzy'),
    ],
)
def test_what_keeps_the_program_from_running_is_said_in_a_sentence(
    missing: str | None, arguments: list[str], code: int, said: str
) -> None:
    script = (
        'import sys\n'
        f'sys.modules[{missing!r}] = None\n'
        'from ros2_ident.ros.identifier import main\n'
        'sys.exit(main())'
    )
    ran = subprocess.run(
        [sys.executable, '-c', script, *arguments],
        env=environment(new_domain()),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ran.returncode == code
    assert ran.stderr.startswith(f'identifier: {said}') and ran.stderr.count('\n') == 1
