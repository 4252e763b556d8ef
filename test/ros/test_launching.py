# SPDX-License-Identifier: Apache-2.0
"""The launch file starts node and replay as its arguments say; launch itself is not needed."""

import importlib.util
from pathlib import Path
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

FILE = Path(__file__).parents[2] / 'launch/identify.launch.py'


@pytest.fixture
def started(monkeypatch):
    """Return what a launch with some arguments starts, by executable."""
    fakes = MagicMock()
    for name in ('launch', 'launch.actions', 'launch.substitutions', 'launch_ros'):
        monkeypatch.setitem(sys.modules, name, fakes)
    monkeypatch.setitem(sys.modules, 'launch_ros.actions', SimpleNamespace(Node=dict))
    monkeypatch.setitem(sys.modules, 'launch_ros.substitutions', fakes)
    typed = SimpleNamespace(ParameterValue=lambda value, value_type: (value, value_type))
    monkeypatch.setitem(sys.modules, 'launch_ros.parameter_descriptions', typed)
    fakes.FindPackageShare.return_value.perform.return_value = '/share'
    fakes.LaunchConfiguration = lambda name: SimpleNamespace(perform=lambda given: given[name])
    spec = importlib.util.spec_from_file_location('identify_launch', FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    defaults = {name: default for name, default, _ in module.ARGUMENTS}
    return lambda given: {n['executable']: n for n in module._nodes(defaults | given)}


@pytest.mark.parametrize(
    ('given', 'parameters'),
    [
        ({}, [{'use_sim_time': False, 'machine_file': ('/share/config/tripod.yaml', str)}]),
        ({'machine_file': 'a.yaml'}, [{'use_sim_time': False, 'machine_file': ('a.yaml', str)}]),
        # a parameter file's own machine file stays
        ({'params_file': 'p.yaml'}, ['p.yaml', {'use_sim_time': False}]),
        (
            {'params_file': 'p.yaml', 'machine_file': 'a.yaml', 'use_sim_time': 'True'},
            ['p.yaml', {'use_sim_time': True, 'machine_file': ('a.yaml', str)}],
        ),
    ],
)
def test_a_default_never_goes_before_what_is_given(started, given, parameters) -> None:
    nodes = started(given)
    assert list(nodes) == ['identifier']
    assert nodes['identifier']['parameters'] == parameters


def test_namespace_and_topics_reach_the_node_and_the_replay(started) -> None:
    rclpy = pytest.importorskip('rclpy')
    from std_msgs.msg import Empty

    given = {'namespace': 'cell', 'command_topic': '/arm/state', 'bag': 'log', 'rate': '2'}
    nodes = started(given)
    assert nodes['replay']['arguments'] == ['log', '--wait-for-subscribers', '--rate', '2']
    heard, wanted = {}, ['/cell/joint_states', '/cell/effort', '/arm/state']
    for name, node in nodes.items():
        rules = [f'__ns:=/{node["namespace"]}', *map(':='.join, node['remappings'])]
        context = rclpy.Context()
        rclpy.init(args=['--ros-args', *(x for r in rules for x in ('-r', r))], context=context)
        made = rclpy.create_node('a', context=context)
        mark = '/' if name == 'replay' else ''
        topics = [f'{mark}{x}' for x in ('joint_states', 'effort', 'joint_command')]
        heard[name] = [made.create_publisher(Empty, x, 1).topic_name for x in topics]
        rclpy.shutdown(context=context)
    assert heard == {'identifier': wanted, 'replay': wanted}
