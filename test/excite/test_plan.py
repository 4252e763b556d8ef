# SPDX-License-Identifier: Apache-2.0
"""Planned motions: rest at both ends, limits that hold, intervals that come true, files."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
import yaml

from checks.reference import twin_of
from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.excite.course import Courses, courses_for
from ros2_ident.excite.information import Sensitivity
from ros2_ident.excite.limits import Limits, limits_of, Moved
from ros2_ident.excite.plan import Excitation, excite, largest, SEARCH
from ros2_ident.models import load_machine, machine_from_mapping, make_model
from ros2_ident.recording import Dataset, read_bag, Topics

CONFIG = Path(__file__).parents[2] / 'config'
FEW = replace(SEARCH, initial_population=30, survivors=4, generations=8, range_reduction=0.7)


@pytest.fixture(scope='module')
def axis():
    return load_machine(CONFIG / 'emps.yaml')


@pytest.fixture(scope='module')
def tripod():
    return load_machine(CONFIG / 'tripod.yaml')


def by_file(folder: Path, machine, **content: object) -> Limits:
    path = folder / 'joint_limits.yaml'
    path.write_text(yaml.safe_dump(content))
    return limits_of(machine, path)


# ------------------------------------------------------------------ limits


def test_a_file_of_limits_counts_before_what_suits_the_machine(axis, tmp_path) -> None:
    own = {
        'max_velocity': 0.05,
        'has_velocity_limits': True,
        'max_jerk': 3.0,
        'max_acceleration': 9.0,
        'has_acceleration_limits': False,
    }
    found = by_file(tmp_path, axis, joint_limits={'emps_axis': own})
    assert (found.velocity[0], found.jerk[0]) == (0.05, 3.0)
    assert found.acceleration[0] == pytest.approx(1.2)
    assert found.effort[0] == pytest.approx(351.5065)
    np.testing.assert_allclose([found.low[0], found.high[0]], [0.005, 0.245])


def test_limits_of_a_tool_are_those_of_its_drives(tripod, tmp_path) -> None:
    found = by_file(tmp_path, tripod, workspace=[[-0.02, 0.02], [-0.02, 0.02], [-0.08, -0.02]])
    np.testing.assert_allclose(found.way_low, [-0.02, -0.02, -0.08])
    assert np.isinf(found.high).all()
    # A rail goes up as the tool does, and by as much as the rod leans where the tool goes aside.
    lean = 0.3 / np.sqrt(0.6**2 - 0.3**2)
    np.testing.assert_allclose(found.velocity, np.hypot(1.0, lean), rtol=1e-6)


@pytest.mark.parametrize(
    ('content', 'said'),
    [
        ({'limits': {}}, 'states no limits'),
        ({'joint_limits': {'x': {'max_velocity': 1.0}}}, 'has no limits of emps_axis, but of x'),
        ({'joint_limits': {'emps_axis': {'max_velocity': 'fast'}}}, "is 'fast'; give a number"),
        ({'joint_limits': {'emps_axis': {'max_velocity': 0.0}}}, 'max_velocity leaves no room'),
        ({'joint_limits': {'emps_axis': {'min_position': 0.3}}}, 'max_position leaves no room'),
    ],
)
def test_limits_that_cannot_be_kept(axis, tmp_path, content, said) -> None:
    with pytest.raises(IdentError, match=said):
        by_file(tmp_path, axis, **content)


# ------------------------------------------------------------------ motions


def drawn(courses: Courses, seed: int) -> Moved:
    return courses.motion(np.random.default_rng(seed).random(courses.dimension))


@pytest.mark.parametrize('seed', range(3))
def test_a_motion_begins_and_ends_at_rest_and_touches_a_limit(axis, seed) -> None:
    limits = limits_of(axis)
    courses = courses_for(axis, limits, 6.0)
    moved = drawn(courses, seed)
    for end in (0, -1):
        assert abs(moved.velocity[0, end]) < 1e-12
        assert abs(moved.acceleration[0, end]) < 1e-9
    # No jump of the acceleration where the rest ends: at most a cycle of full jerk.
    assert np.abs(np.diff(moved.acceleration)).max() < 1.01 * limits.jerk[0] * axis.number('cycle')
    # The trapezoidal rule is off by a twelfth of the jerk times the squared cycle.
    cycle = axis.number('cycle')
    np.testing.assert_allclose(
        np.diff(moved.position) / cycle,
        0.5 * (moved.velocity[:, 1:] + moved.velocity[:, :-1]),
        atol=0.1 * limits.jerk[0] * cycle**2,
    )
    loads = largest(limits, moved)
    assert max(loads.values()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(('seconds', 'harmonics'), [(0.4, 8), (4.0, 1)])
def test_too_little_for_a_motion(axis, seconds, harmonics) -> None:
    with pytest.raises(IdentError, match='leave no motion; take 2 harmonics and 0.54 s'):
        courses_for(axis, limits_of(axis), seconds, harmonics)


@pytest.mark.parametrize('file', ['tripod', 'delta'])
def test_a_tool_stays_in_its_room(file) -> None:
    machine = load_machine(CONFIG / f'{file}.yaml')
    limits = limits_of(machine)
    courses = courses_for(machine, limits, 3.0)
    for seed in range(4):
        moved = drawn(courses, seed)
        assert 0.9 < max(largest(limits, moved).values()) < 1.02
    log = twin_of(machine).simulate(machine, expected(machine), moved.position, moved.velocity)
    assert (log.platform > limits.way_low[:, None] - 1e-3).all()
    assert (log.platform < limits.way_high[:, None] + 1e-3).all()


def expected(machine) -> dict[str, float]:
    sensitivity = Sensitivity(machine)
    return {p.name: v for p, v in zip(sensitivity.parameters, sensitivity.values, strict=True)}


# ------------------------------------------------------------------ what a log will show


def test_the_intervals_come_true(axis) -> None:
    sensitivity = Sensitivity(axis, rate=250.0)
    courses = courses_for(axis, limits_of(axis), 6.0)
    planned = drawn(courses, 0)
    shown = sensitivity.of(planned)
    model = make_model(axis, data_of(axis, planned))
    there = np.zeros(model.measured.shape, dtype=bool)
    there[:, ::4] = True
    truth = sensitivity.values
    slopes = np.stack(
        [
            (model.simulate_at(truth + h, there)[0] - model.simulate_at(truth - h, there)[0])
            / (2.0 * h[n])
            for n, h in enumerate(np.diag(1e-4 * sensitivity.box.width))
        ],
        axis=1,
    )
    # 400 logs with noise, each fitted by least squares: the spread of what is found.
    noise = axis.effort_noise * np.random.default_rng(1).standard_normal((slopes.shape[0], 400))
    spread = np.std(np.linalg.lstsq(slopes, noise, rcond=None)[0], axis=1)
    np.testing.assert_allclose(sensitivity.half_widths(shown), norm.ppf(0.975) * spread, rtol=0.12)


def data_of(machine, planned: Moved) -> Dataset:
    position, velocity = planned.position, planned.velocity
    zero = np.zeros_like(position)
    cycle = machine.number('cycle')
    return Dataset(machine.drives, cycle, 0, position, velocity, position, velocity, zero)


def planned(machine, **wish: object) -> Excitation:
    courses = courses_for(machine, limits_of(machine), 4.0)
    return excite(courses, Sensitivity(machine), settings=FEW, **wish)


@pytest.fixture(scope='module')
def found(axis) -> Excitation:
    return planned(axis)


def test_a_planned_motion_tells_more_than_a_random_one(found) -> None:
    ratio = found.chance / found.half_widths
    # Dry friction and a constant force show alike in every motion that is not at rest.
    assert ratio[0] > 1.3 and ratio[1] > 1.15
    assert np.prod(ratio) > 1.5


def test_what_is_wanted_is_determined_best(axis, found) -> None:
    n = [p.name for p in found.parameters].index('emps_axis.viscous_friction')
    ratios = []
    for seed in range(3):  # so short a search ends anywhere near the best
        one = planned(axis, names=('viscous_friction',), seed=seed)
        every = planned(axis, seed=seed) if seed else found
        ratios.append(one.half_widths[n] / every.half_widths[n])
    assert one.wanted.tolist() == [k == n for k in range(len(one.parameters))]
    assert np.mean(ratios) < 0.95
    with pytest.raises(IdentError, match="'tool_mass' is no parameter"):
        planned(axis, names=('tool_mass',))


@pytest.mark.parametrize('wrong', [0.75, 1.0, 1.25])
def test_the_reference_keeps_to_the_limits(axis, found, wrong) -> None:
    values = zip(found.parameters, found.values, strict=True)
    truth = {p.name: wrong * value for p, value in values}
    log = twin_of(axis).simulate(axis, truth, found.planned.position, found.planned.velocity)
    acceleration = np.gradient(log.velocity, log.cycle, axis=1)
    seen = Moved(log.position, log.velocity, acceleration, effort=log.effort)
    loads = largest(found.courses.limits, found.planned, seen)
    assert 0.95 < max(loads.values()) < 1.01


# ------------------------------------------------------------------ files


@pytest.fixture(scope='module')
def written(tmp_path_factory) -> Path:
    """A folder that the command filled."""
    folder = tmp_path_factory.mktemp('excite') / 'motion'
    assert main(command(folder)) == 0
    return folder


def command(folder: Path, *more: str) -> list[str]:
    words = ['excite', str(folder), '--machine', str(CONFIG / 'emps.yaml'), '--seconds', '2']
    return [*words, '--generations', '2', '--threads', '1', '--quiet', *more]


def test_a_controller_makes_the_motion_of_the_trajectory(written) -> None:
    topics = Topics(command='/joint_trajectory_controller/joint_trajectory')
    (recording,) = read_bag(written / 'set_points', topics)
    (planned,) = read_bag(written / 'set_points')
    followed, rows = recording.command, planned.command
    assert followed is not None and rows is not None
    time = 1e-9 * (followed.stamp - followed.stamp[0])
    np.testing.assert_allclose(
        np.interp(time, 1e-9 * (rows.stamp - rows.stamp[0]), rows.position[:, 0]),
        followed.position[:, 0],
        atol=2e-6,
    )
    assert followed.names == ('emps_axis',)
    assert followed.stamp[0] - rows.stamp[0] == 3 * 10**9


def test_what_a_motion_is_worth_is_written_down(written, capsys) -> None:
    worth = json.loads((written / 'excite.json').read_text())
    assert worth['largest_share_of_a_limit']['acceleration'] <= 1.0
    of_mass = worth['parameters']['emps_axis.moving_mass']
    assert of_mass['half_width'] > 0.0 and of_mass['unit'] == 'kg'


def test_a_motion_is_replaced_and_nothing_else(written, tmp_path, capsys) -> None:
    assert main(command(written, '--seed', '1')) == 0
    said = capsys.readouterr().out
    assert 'emps_axis.moving_mass' in said and 'of the limits it takes at most' in said
    (tmp_path / 'set_points').mkdir()
    (tmp_path / 'set_points' / 'mine').write_text('')
    assert main(command(tmp_path)) == 2
    assert 'will not be replaced' in capsys.readouterr().err


# ------------------------------------------------------------------ an arm


def test_an_arm_by_its_description(tmp_path) -> None:
    pytest.importorskip('pinocchio', reason='pinocchio is not installed')
    (tmp_path / 'arm.urdf').write_text(URDF)
    machine = machine_from_mapping(
        {
            'machine': 'serial',
            'drives': ['shoulder', 'elbow'],
            'geometry': {'description': 'arm.urdf'},
            'controller': {'cycle': 0.01},
            'parameters': {'link_moment': [-5.0, 5.0, 'kg m'], 'coulomb_torque': [0, 4, 'N m']},
        },
        folder=tmp_path,
    )
    with pytest.raises(IdentError, match='no max_acceleration of shoulder is known'):
        limits_of(machine)
    own = {'max_acceleration': 6.0}
    limits = by_file(tmp_path, machine, joint_limits={'shoulder': own, 'elbow': own})
    np.testing.assert_allclose([limits.low, limits.high], [[-1.0, -2.0], [1.0, 2.0]])
    np.testing.assert_allclose(limits.effort, [14.0, 20.0])
    found = excite(courses_for(machine, limits, 8.0), Sensitivity(machine), settings=FEW)
    assert max(found.loads.values()) == pytest.approx(1.0, abs=0.01)
    # The shoulder has hardly the torque to hold both links.
    assert found.loads['effort'] > 0.5
    assert np.mean(np.log(found.chance / found.half_widths)) > np.log(1.1)


LINK = (
    '<link name="{0}"><inertial><origin xyz="0.2 0 0"/><mass value="{1}"/>'
    '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>'
    '<origin xyz="{3} 0 0"/><limit lower="-{4}" upper="{4}" velocity="3" effort="{5}"/></joint>'
)
URDF = (
    '<robot name="arm"><link name="base"/>'
    + LINK.format('upper', 1.5)
    + LINK.format('lower', 1.0)
    + JOINT.format('shoulder', 'base', 'upper', 0.0, 1.0, 14.0)
    + JOINT.format('elbow', 'upper', 'lower', 0.4, 2.0, 20.0)
    + '<transmission name="t"><joint name="elbow"/></transmission></robot>'
)
