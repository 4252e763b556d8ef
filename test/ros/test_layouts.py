# SPDX-License-Identifier: Apache-2.0
"""The layouts in config/ name topics and fields that a running node has."""

import json
import re
import signal
from xml.etree import ElementTree

import pytest
from ros_helpers import bag_goal, ended, identifier, Listener, new_domain, ROOT
import yaml

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from action_msgs.msg import GoalStatus  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from ros2_ident.ros.outlet import LATCHED  # noqa: E402

pytestmark = pytest.mark.ros

CONFIG = ROOT / 'config'


TOPIC = re.compile(
    r'(/identifier/\w+|/joint_states|/effort|/joint_command|/diagnostics)([\w./[\]]*)'
)
READERS = {
    'plotjuggler.xml': ElementTree.fromstring,
    'foxglove.json': json.loads,
    'rqt.perspective': json.loads,
    'identifier.rviz': yaml.safe_load,
}


def named_in(layout):
    """Yield topics and field paths that a layout names; its tool has to be able to parse it."""
    text = (CONFIG / layout).read_text(encoding='utf-8')
    READERS[layout](text)
    for topic, path in TOPIC.findall(text):
        yield topic, path.strip('./').replace('/', '.')


def message_class(name):
    """Return the class of `package/msg/Name`."""
    package, _, kind = name.split('/')
    return getattr(__import__(f'{package}.msg', fromlist=[kind]), kind)


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    """Topics of a node that has identified a tripod, with their types and last messages."""
    domain = new_domain()
    small = 'initial_population:=64', 'generations:=3'
    with identifier(domain, tmp_path_factory.mktemp('results'), *small) as process:
        listener = Listener(domain)
        try:
            scenes = []
            listener.node.create_subscription(
                MarkerArray, '/identifier/scene', scenes.append, LATCHED
            )
            drives = ['drive_1', 'drive_2', 'drive_3']
            status, _ = listener.ask(bag_goal(refine=False, drives=drives))
            assert status == GoalStatus.STATUS_SUCCEEDED
            heard = {
                'scene': scenes,
                'result': listener.results,
                'status': listener.statuses,
                'progress': listener.progress,
                'simulated': listener.simulated,
                'residual': listener.residual,
            }
            listener.until(lambda: all(heard.values()), 'everything that is said')
            types = {
                topic: message_class(kinds[0])
                for topic, kinds in listener.node.get_topic_names_and_types()
                if '/_action/' not in topic
            }
            yield types, {f'/identifier/{name}': x[-1] for name, x in heard.items()}
        finally:
            listener.close()
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


@pytest.mark.parametrize('layout', READERS)
def test_every_topic_and_field_of_a_layout_is_in_the_running_node(layout, running):
    types, last = running
    named = list(named_in(layout))
    assert named
    for topic, field in named:
        assert topic in types, f'{layout} names {topic}'
        if field:
            inner = resolve(types[topic], field, last.get(topic))
            assert inner in ('double', 'string') or inner.startswith('uint'), (topic, field)


def test_the_scene_is_in_the_frame_of_the_rviz_configuration(running):
    _, last = running
    shown = yaml.safe_load((CONFIG / 'identifier.rviz').read_text())['Visualization Manager']
    markers = last['/identifier/scene'].markers
    assert {x.header.frame_id for x in markers} == {shown['Global Options']['Fixed Frame']}
    display = shown['Displays'][1]
    assert {x.ns for x in markers} == set(display['Namespaces'])
    assert display['Topic']['Durability Policy'] == 'Transient Local', 'it is latched'
