# SPDX-License-Identifier: Apache-2.0
"""What the launch file makes of its arguments; launch itself is not needed."""

from pathlib import Path

import pytest

from ros2_ident.ros.launching import ARGUMENTS, node_options, replay_remappings

SHARE = Path('/share')
DEFAULTS = {name: default for name, default, _ in ARGUMENTS}


@pytest.mark.parametrize(
    ('given', 'parameters'),
    [
        ({}, [{'use_sim_time': False, 'machine_file': '/share/config/tripod.yaml'}]),
        ({'machine_file': 'a.yaml'}, [{'use_sim_time': False, 'machine_file': 'a.yaml'}]),
        # a parameter file's own machine file stays
        ({'params_file': 'p.yaml'}, ['p.yaml', {'use_sim_time': False}]),
        (
            {'params_file': 'p.yaml', 'machine_file': 'a.yaml', 'use_sim_time': 'True'},
            ['p.yaml', {'use_sim_time': True, 'machine_file': 'a.yaml'}],
        ),
    ],
)
def test_a_default_never_goes_before_what_is_given(given, parameters) -> None:
    assert node_options(DEFAULTS | given, SHARE)['parameters'] == parameters


def test_namespace_and_topics_reach_the_node_and_the_replay() -> None:
    given = DEFAULTS | {'namespace': 'cell', 'command_topic': '/arm/state', 'effort_topic': 'tau'}
    options = node_options(given, SHARE)
    assert options['namespace'] == 'cell'
    assert options['remappings'] == [('effort', 'tau'), ('joint_command', '/arm/state')]
    assert replay_remappings(given) == [
        ('/joint_states', '/cell/joint_states'),
        ('/effort', '/cell/tau'),
        ('/joint_command', '/arm/state'),
    ]
    assert replay_remappings(DEFAULTS) == []
