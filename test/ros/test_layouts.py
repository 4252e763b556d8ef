# SPDX-License-Identifier: Apache-2.0
"""The layouts in config/ name topics and fields that a running node has."""

import ast
import json
import re
import signal
from xml.etree import ElementTree

import pytest
from ros_helpers import BAG, ended, identifier, new_domain, ROOT, Station
import yaml

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

CONFIG = ROOT / 'config'
# What the node hears; the rest it says itself.
HEARD = {'/joint_states', '/effort', '/joint_command'}


def plotjuggler():
    """Yield topics and field paths of the PlotJuggler layout."""
    root = ElementTree.parse(CONFIG / 'plotjuggler.xml').getroot()
    assert root.tag == 'root' and root.find('tabbed_widget/Tab/Container/DockSplitter') is not None
    plugin = root.find('Plugins/plugin[@ID="ROS2 Topic Subscriber"]')
    assert root.find('previouslyLoaded_Streamer').get('name') == plugin.get('ID')
    topics = plugin.find('selected_topics').get('value').split(';')
    curves = [x.get('name') for x in root.iter('curve')]
    for curve in curves:
        topic = next(x for x in sorted(topics, key=len, reverse=True) if curve.startswith(x + '/'))
        yield topic, curve[len(topic) + 1 :].replace('/', '.')
    assert all(any(c.startswith(t + '/') for c in curves) for t in topics)
    for splitter in root.iter('DockSplitter'):
        assert len(splitter) == int(splitter.get('count'))
        assert len(splitter.get('sizes').split(';')) == len(splitter)


def panels(layout):
    """Yield the names in a Foxglove layout's tree."""
    if isinstance(layout, str):
        yield layout
        return
    assert layout['direction'] in ('row', 'column')
    for half in ('first', 'second'):
        yield from panels(layout[half])


def foxglove():
    """Yield topics and field paths of the Foxglove layout."""
    data = json.loads((CONFIG / 'foxglove.json').read_text())
    assert set(data) == {'configById', 'globalVariables', 'userNodes', 'playbackConfig', 'layout'}
    assert sorted(panels(data['layout'])) == sorted(data['configById'])
    for name, panel in data['configById'].items():
        kind = name.split('!')[0]
        if kind in ('Plot', 'StateTransitions'):
            found = [x['value'] for x in panel['paths']]
        elif kind == 'RawMessages':
            found = [panel['topicPath']]
        elif kind == 'DiagnosticSummary':
            found = [panel['topicToRender']]
        else:
            assert kind == '3D', name
            found = list(panel['topics'])
        for path in found:
            topic, _, field = path.partition('.')
            yield topic, field


def rqt():
    """Yield topics and field paths of the rqt perspective."""
    data = json.loads((CONFIG / 'rqt.perspective').read_text())
    manager = data['groups']['pluginmanager']
    running = ast.literal_eval(manager['keys']['running-plugins']['repr'])
    names = {
        f'plugin__{plugin.replace("/", "__")}__{number}'
        for plugin, numbers in running.items()
        for number in numbers
    }
    assert names == set(manager['groups'])
    for name, group in manager['groups'].items():
        if 'rqt_plot' not in name:
            continue
        for path in ast.literal_eval(group['groups']['plugin']['keys']['topics']['repr']):
            _, node, topic, field = path.split('/', 3)
            yield f'/{node}/{topic}', field.replace('/', '.')


def rviz():
    """Yield the topics of the RViz configuration."""
    data = yaml.safe_load((CONFIG / 'identifier.rviz').read_text())
    manager = data['Visualization Manager']
    for display in manager['Displays']:
        assert display['Class'].startswith('rviz_default_plugins/')
        if 'Topic' in display:
            assert display['Topic']['Durability Policy'] == 'Transient Local'
            yield display['Topic']['Value'], ''


LAYOUTS = {
    'plotjuggler.xml': plotjuggler,
    'foxglove.json': foxglove,
    'rqt.perspective': rqt,
    'identifier.rviz': rviz,
}


def message_class(name):
    """Return the class of `package/msg/Name`."""
    package, _, kind = name.split('/')
    return getattr(__import__(f'{package}.msg', fromlist=[kind]), kind)


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    """Topics of a node that has identified a tripod, with their types and last messages."""
    from action_msgs.msg import GoalStatus
    from rclpy.action import ActionClient
    from rclpy.node import Node
    from ros2_ident_msgs.action import Identify

    from ros2_ident.ros.outlet import LATCHED

    domain = new_domain()
    small = 'initial_population:=64', 'generations:=3'
    with identifier(domain, tmp_path_factory.mktemp('results'), *small) as process:
        station = Station(lambda context: Node('layouts', context=context), domain)
        try:
            client = ActionClient(station.node, Identify, '/identifier/identify')
            station.until(client.server_is_ready, 'the action server')
            station.until(
                lambda: {x for x, _ in station.node.get_topic_names_and_types()} >= HEARD,
                'the node',
            )
            types = {
                topic: message_class(kinds[0])
                for topic, kinds in station.node.get_topic_names_and_types()
                if '/_action/' not in topic
            }
            last = {}
            for topic in ('scene', 'result', 'status', 'progress', 'simulated', 'residual'):
                name = f'/identifier/{topic}'
                qos = LATCHED if topic in ('scene', 'result', 'status') else 1000
                station.node.create_subscription(
                    types[name], name, lambda x, name=name: last.update({name: x}), qos
                )
            goal = Identify.Goal(
                data_source=Identify.Goal.DATA_SOURCE_BAG,
                bag_path=str(BAG),
                refine=False,
                drives=['drive_1', 'drive_2', 'drive_3'],
            )
            handle = station.request(lambda: client.send_goal_async(goal), 'an answer')
            result = station.request(handle.get_result_async, 'the result', 200.0)
            assert result.status == GoalStatus.STATUS_SUCCEEDED
            station.until(lambda: len(last) == 6, 'everything that is said', 120.0)
            yield types, last
        finally:
            station.close()
        process.send_signal(signal.SIGTERM)
        assert ended(process)[0] == 0


def resolve(kind, path, message):
    """Return the type at the end of a path through message classes; names joints, too."""
    part, _, rest = path.partition('.')
    name, index = re.fullmatch(r'(\w+)(?:\[(\d+)\])?', part).groups()
    fields = kind.get_fields_and_field_types()
    if name not in fields and 'effort' in fields:
        # PlotJuggler sorts a JointState by its joints
        assert message is None or name in message.name, f'no joint {name}'
        assert rest in ('position', 'velocity', 'effort')
        return 'double'
    declared = fields[name]
    assert bool(index) == declared.startswith('sequence<'), path
    if index and message is not None:
        assert int(index) < len(getattr(message, name)), path
    inner = re.sub(r'^sequence<(.*)>$', r'\1', declared)
    if not rest:
        return inner
    package, kind_name = inner.split('/')
    return resolve(message_class(f'{package}/msg/{kind_name}'), rest, None)


@pytest.mark.parametrize('layout', LAYOUTS)
def test_every_topic_and_field_of_a_layout_is_in_the_running_node(layout, running):
    types, last = running
    named = list(LAYOUTS[layout]())
    assert named
    for topic, field in named:
        assert topic in types, f'{layout} names {topic}'
        if field:
            inner = resolve(types[topic], field, last.get(topic))
            assert inner in ('double', 'string') or inner.startswith('uint'), (topic, field)


def test_the_scene_is_latched_and_in_the_frame_of_the_rviz_configuration(running):
    _, last = running
    frame = yaml.safe_load((CONFIG / 'identifier.rviz').read_text())['Visualization Manager'][
        'Global Options'
    ]['Fixed Frame']
    markers = last['/identifier/scene'].markers
    assert {x.header.frame_id for x in markers} == {frame}
    shown = yaml.safe_load((CONFIG / 'identifier.rviz').read_text())
    names = shown['Visualization Manager']['Displays'][1]['Namespaces']
    assert {x.ns for x in markers} == set(names)
