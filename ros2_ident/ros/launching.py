# SPDX-License-Identifier: Apache-2.0
"""Arguments of launch/identify.launch.py; imports nothing of launch."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

# Argument, default, description.
ARGUMENTS = (
    ('machine_file', '', 'what is known of the machine; empty: as the parameter file has it'),
    ('params_file', '', 'parameters of the node; empty: all at their defaults'),
    ('namespace', '', 'namespace of the node and of its topics'),
    ('use_sim_time', 'false', 'take the time from /clock'),
    ('state_topic', '', 'measured motion; empty: joint_states in the namespace'),
    ('effort_topic', '', 'measured effort; empty: effort in the namespace'),
    ('command_topic', '', 'set-point; empty: joint_command in the namespace'),
    ('bag', '', 'bag to replay; empty: wait for live topics'),
    ('rate', '1.0', 'pace of the replay'),
)
_TOPICS = {'state': 'joint_states', 'effort': 'effort', 'command': 'joint_command'}


def node_options(given: Mapping[str, str], share: Path) -> dict[str, Any]:
    """Return how to start the node.

    Args:
        given: Values of the arguments.
        share: The package's share folder, whose tripod is taken where neither a machine nor a
            parameter file is given.

    Returns:
        Keywords of `launch_ros.actions.Node`: `parameters`, `namespace`, `remappings`.
    """
    machine, file = given['machine_file'], given['params_file']
    if not machine and not file:
        machine = str(share / 'config/tripod.yaml')
    values: dict[str, Any] = {'use_sim_time': given['use_sim_time'].lower() in ('true', '1')}
    if machine:
        values['machine_file'] = machine
    return {
        'namespace': given['namespace'],
        'parameters': [*([file] if file else []), values],
        'remappings': [
            (name, given[f'{role}_topic'])
            for role, name in _TOPICS.items()
            if given[f'{role}_topic']
        ],
    }


def replay_remappings(given: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return how the usual topics of a bag are renamed to those that the node hears."""
    above = given['namespace'].strip('/')
    found = []
    for role, name in _TOPICS.items():
        topic = given[f'{role}_topic'] or name
        if not topic.startswith('/'):
            topic = f'/{above}/{topic}' if above else f'/{topic}'
        if topic != f'/{name}':
            found.append((f'/{name}', topic))
    return found
