# SPDX-License-Identifier: Apache-2.0
"""Overlay bags: what was recorded, what was found, and the tripod in space."""

from identify_cases import ROOT, tripod
from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import read_data
from ros2_ident.report.overlay import overlay_streams, write_overlay
from ros2_ident.report.scene import (
    MARKERS,
    REPEAT,
    scene_messages,
    scene_of,
)

BAG = ROOT / 'bags/tripod_pick_and_place'
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope='module')
def problem():
    return problem_of(tripod(), read_data(BAG, tripod()))


@pytest.fixture(scope='module')
def theta(problem):
    return problem.low + 0.3 * (problem.high - problem.low)


@pytest.fixture(scope='module')
def scene(problem, theta):
    (streams,) = overlay_streams(problem, theta)
    return scene_of(problem, theta, streams['residual'])


@pytest.fixture(scope='module')
def overlay(problem, theta, tmp_path_factory):
    (path,) = write_overlay(tmp_path_factory.mktemp('bags') / 'overlay', problem, theta)
    return path


def test_foxglove_finds_what_it_needs(overlay):
    (file,) = overlay.glob('*.mcap')
    with file.open('rb') as stream:
        reader = make_reader(stream)
        header, summary = reader.get_header(), reader.get_summary()
    assert header.profile == 'ros2'
    schemas = {summary.schemas[x.schema_id].name: x.topic for x in summary.channels.values()}
    assert {x.encoding for x in summary.schemas.values()} == {'ros2msg'}
    assert schemas['visualization_msgs/msg/MarkerArray'] == '/identifier/scene'
    assert all(x.data for x in summary.schemas.values())
    assert all(x.message_encoding == 'cdr' for x in summary.channels.values())
    assert (overlay / 'metadata.yaml').is_file()


def test_what_is_drawn_is_the_scene(scene):
    said = scene_messages(scene)
    assert len(said) == scene.stamp.size
    first = STORE.deserialize_cdr(said[0], MARKERS).markers
    second = STORE.deserialize_cdr(said[1], MARKERS).markers
    names = [(x.ns, x.id) for x in first]
    assert len(set(names)) == len(names)
    assert {x.ns for x in first} == {'frame', 'gap', 'measured'}
    assert {x.ns for x in second} == {'measured'}
    assert len(STORE.deserialize_cdr(said[REPEAT], MARKERS).markers) == len(first)
    assert {x.header.frame_id for x in first} == {'tripod'}
    path = next(x for x in first if x.ns == 'gap')
    assert len(path.points) == len(path.colors) == len(scene.stamp)
    np.testing.assert_array_equal([[p.x, p.y, p.z] for p in path.points], scene.figure.tool)
    rods = next(x for x in second if (x.ns, x.id) == ('measured', 2))
    ends = np.array([[p.x, p.y, p.z] for p in rods.points]).reshape(3, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 0.6, rtol=1e-12)
    text = next(x.text for x in first if x.text)
    assert 'N m' in text
