# SPDX-License-Identifier: Apache-2.0
"""The machine as a value: what a file leaves out, what differs by drive, what is free."""

import copy
import math
from pathlib import Path
import re

from identify_cases import AXIS_TRUTH, ROOT
import numpy as np
import pytest
import yaml

from checks.reference import twin_of
from checks.reference.tripod import simulate_tripod
from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.gates.controller import check_law
from ros2_ident.gates.law import fit_law
from ros2_ident.machine.units import effort_factors
from ros2_ident.models import machine_from_mapping, make_model
from ros2_ident.models.registry import KINDS
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion

EMPS = yaml.safe_load((ROOT / 'config' / 'emps.yaml').read_text())
TRIPOD = yaml.safe_load((ROOT / 'config' / 'tripod.yaml').read_text())
TRUTH = {
    'measurement_delay': 0.002,
    'gear_stiffness': 2e5,
    'gear_damping_ratio': 0.4,
    'tool_mass': 1.5,
    'drive_inertia': 9e-5,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.03,
}


def file_of(data: dict, **changed: object) -> dict:
    """Return a machine file with other keys, `section__key=value`; None takes one out."""
    out = copy.deepcopy(data)
    for path, value in changed.items():
        section, _, key = path.partition('__')
        if value is None:
            del out[section][key]
        else:
            out[section][key] = value
    return out


def theta_of(model, values):
    """Return (1, N) parameters of a model by their names."""
    named = (values.get(p.name, values.get(p.name.rpartition('.')[2])) for p in model.parameters)
    return np.array([list(named)])


def same_as_reference(machine, values, share=1e-3, seconds=1.5):
    """Assert that the fast model follows the reference; return the reference's effort."""
    motion = draw_motion('multi_point', machine, seconds, 3)
    log = twin_of(machine).simulate(machine, values, motion.position, motion.velocity)
    data = Dataset(
        machine.drives, motion.cycle, 0, motion.position, motion.velocity, None, None, log.effort
    )
    model = make_model(machine, data)
    theta = theta_of(model, values)
    # Each candidate has its own constants.
    error = model.simulate(np.concatenate([1.01 * theta, theta]))[1] - log.effort
    assert np.sqrt(np.mean(error**2)) < share * np.abs(log.effort).max()
    return log.effort


# ------------------------------------------------------------------ the value


def test_a_machine_is_complete_and_says_what_was_stated():
    axis = machine_from_mapping(
        {
            'machine': 'linear_axis',
            'drives': ['a', 'b'],
            'controller': {'cycle': 1e-3},
            'parameters': {'moving_mass': [1.0, 2.0, 'kg']},
        }
    )
    assert set(axis.constants) == {key.name for key in KINDS['linear_axis'].constants}
    assert axis.numbers('torque_limit').tolist() == [math.inf, math.inf]
    assert axis.number('gear_factor') == 1.0 and not axis.stated('gear_factor')
    assert axis.numbers('travel_per_turn').tolist() == [2.0 * math.pi] * 2
    assert math.isnan(axis.number('position_gain')) and not axis.known('position_gain')
    assert axis.stated('cycle') and axis.text('law', 'b') == 'cascade_pi'


def test_a_drives_constant_is_one_value_or_one_for_each():
    machine = machine_from_mapping(file_of(TRIPOD, drive__gear_factor=[70.0, 80.0, 90.0]))
    assert machine.numbers('gear_factor').tolist() == [70.0, 80.0, 90.0]
    assert machine.number('gear_factor', 'drive_2') == 80.0
    turns = 2.0 * math.pi / np.array([70.0, 80.0, 90.0])
    np.testing.assert_array_equal(machine.numbers('travel_per_turn'), turns)
    with pytest.raises(IdentError, match='gear_factor differs from drive to drive'):
        machine.number('gear_factor')
    assert machine.number('rail_mass') == machine.number('rail_mass', 'drive_3') == 1.2


@pytest.mark.parametrize(
    ('arguments', 'factor'),
    [(('N m',), 1.0), (('A', 0.25), 0.25), (('percent', None, 6.0), 0.06)],
)
def test_an_effort_in_amperes_or_percent_becomes_a_torque(arguments, factor):
    assert effort_factors(*arguments) == pytest.approx((factor,))


@pytest.mark.parametrize(
    ('changed', 'said'),
    [
        ({'drive__gear_factor': [70.0, 80.0]}, 'drive.gear_factor has 2 values for 3 drives; wr'),
        ({'drive__gear_factor': [70.0, 'x', 80.0]}, "drive.gear_factor is 'x'; write a number in"),
        ({'controller__law': ['pi', 'pid', 'pi']}, "law is 'pid'; write one of cascade_pi, casc"),
        ({'controller__cycle': [1e-3] * 3}, 'controller.cycle is [0.001, 0.001, 0.001]; write a'),
        ({'geometry__rail_azimuth': 0.0}, 'geometry.rail_azimuth needs three angles in rad'),
        ({'parameters__rail_azimuth': [0.0, 1.0, 'rad']}, 'needs a list of three boxes'),
        ({'parameters__rail_mass': [[0.5, 2.0, 'kg']] * 2}, 'has 2 values for 3 drives'),
        ({'parameters__rail_mass': [[2.0, 0.5, 'kg']] * 3}, 'min has to be below max'),
        ({'drive__rail_mass': None, 'parameters__rod_length': [0.6, 0.5, 'm']}, 'min has to be'),
    ],
)
def test_what_is_wrong_with_a_list_is_said(changed, said):
    with pytest.raises(IdentError, match=re.escape(said)):
        machine_from_mapping(file_of(TRIPOD, **changed))


# ------------------------------------------------------------------ what a file may omit


@pytest.mark.parametrize('data', [EMPS, TRIPOD], ids=['axis', 'tripod'])
def test_no_torque_limit_is_a_limit_that_is_never_reached(data):
    without = machine_from_mapping(file_of(data, controller__torque_limit=None))
    wide = machine_from_mapping(file_of(data, controller__torque_limit=1e5))
    values = AXIS_TRUTH if data is EMPS else TRUTH
    efforts = [same_as_reference(machine, values, 2e-3) for machine in (without, wide)]
    np.testing.assert_array_equal(*efforts)


def test_a_set_point_fed_forward_reaches_a_p_controller_too():
    # Its log tells feed-forward from none, in the fast model and in the reference.
    parts = [
        machine_from_mapping(file_of(EMPS, controller__velocity_feedforward=share))
        for share in (0.0, 0.9)
    ]
    plain, fed = (same_as_reference(machine, AXIS_TRUTH, 2e-3) for machine in parts)
    assert np.abs(fed - plain).max() > 1.0  # N, the noise is 0.3


# ------------------------------------------------------------------ several drives


def test_drives_that_differ_follow_their_reference():
    each = {
        'drive__gear_factor': [70.0, 80.0, 90.0],
        'drive__rail_mass': [1.2, 1.0, 1.5],
        'controller__law': ['pi', 'cascade_p', 'pi'],
        'controller__position_gain': [60.0, 40.0, 50.0],
        'controller__velocity_gain': [4.5, 6.0, 4.0],
        'controller__torque_limit': [6.0, 0.3, 6.0],
    }
    effort = same_as_reference(machine_from_mapping(file_of(TRIPOD, **each)), TRUTH)
    assert np.abs(effort[1]).max() == 0.3 < np.abs(effort[[0, 2]]).max()


def test_two_axes_go_from_file_to_result(tmp_path: Path, capsys):
    file, bag, out = tmp_path / 'axes.yaml', tmp_path / 'bag', tmp_path / 'out'
    made = ['new-machine', '--kind', 'linear_axis', '--drives', 'x,y', '--out', str(file)]
    assert main(made) == 0
    truth = {'x.drive_inertia': 7e-5, 'y.drive_inertia': 1.1e-4, 'y.coulomb_torque': 0.08}
    words = [part for name, value in truth.items() for part in ('--set', f'{name}={value}')]
    about = ['--machine', str(file), '--seconds', '4', '--motion', 'reversals', '--seed', '2']
    assert main(['simulate', str(bag), *about, *words]) == 0
    assert main(['check', str(bag), '--machine', str(file)]) == 0
    assert '\nwarn' not in (said := capsys.readouterr().out) and 'error' not in said
    few = ['--population', '128', '--generations', '6', '--no-overlay', '--quiet']
    assert main(['identify', str(bag), '--machine', str(file), '--out', str(out), *few]) == 0
    found = yaml.safe_load((out / 'result.json').read_text())['parameters']
    for name, value in truth.items():
        assert found[name]['value'] == pytest.approx(value, rel=0.02), name


# ------------------------------------------------------------------ free constants


FREE = {
    'position_gain': ([20.0, 80.0, '1/s'], 25.0),
    'velocity_gain': ([3.0, 6.0, 'N m s/m'], 4.1),
    'integral_gain': ([150.0, 350.0, 'N m/m'], 220.0),
    'velocity_feedforward': ([0.5, 1.2, '1'], 0.8),
    'torque_limit': ([0.1, 6.0, 'N m'], 0.3),
    'gear_factor': ([60.0, 100.0, 'rad/m'], 70.0),
    'rail_mass': ([0.5, 2.0, 'kg'], 0.9),
    'coulomb_regularisation': ([1e-3, 1e-2, 'm/s'], 8e-3),
    'gravity': ([9.0, 10.0, 'm/s^2'], 9.6),
    'rail_radius': ([0.2, 0.4, 'm'], 0.28),
    'rod_length': ([0.5, 0.7, 'm'], 0.62),
    'rail_azimuth': (
        [[-0.1, 0.1, 'rad'], [2.0, 2.2, 'rad'], [4.1, 4.3, 'rad']],
        {'drive_1.rail_azimuth': 0.03, 'drive_2.rail_azimuth': 2.12, 'drive_3.rail_azimuth': 4.15},
    ),
}


def freed(name):
    """Return the tripod with a constant free and not stated, and the truth with its value."""
    key = next(key for key in KINDS['tripod'].constants if key.name == name)
    data = copy.deepcopy(TRIPOD)
    data[key.section].pop(name, None)
    box, value = FREE[name]
    data['parameters'][name] = box
    return machine_from_mapping(data), TRUTH | (value if name == 'rail_azimuth' else {name: value})


@pytest.mark.parametrize('name', FREE)
def test_any_constant_can_be_free(name):
    machine, truth = freed(name)
    assert not machine.stated(name) and machine.known(name)
    effort = same_as_reference(machine, truth, 2e-3)
    stated = machine_from_mapping(TRIPOD)
    motion = draw_motion('multi_point', machine, 1.5, 3)
    plain = simulate_tripod(stated, TRUTH, motion.position, motion.velocity).effort
    assert np.abs(effort - plain).max() > 5e-3
    with pytest.raises(IdentError, match=f'the reference needs a value of {name}'):
        twin_of(machine).simulate(machine, TRUTH, motion.position, motion.velocity)


def test_a_gain_that_is_to_be_found_contradicts_no_log():
    machine, truth = freed('position_gain')
    motion = draw_motion('multi_point', machine, 4.0, 3)
    log = simulate_tripod(machine, truth, motion.position, motion.velocity)
    data = Dataset(
        machine.drives, motion.cycle, 0, motion.position, motion.velocity, log.position,
        log.velocity, log.effort,
    )  # fmt: skip
    for known, level in ((machine, 'ok'), (machine_from_mapping(TRIPOD), 'warn')):
        law = fit_law(known, data, 'drive_2')
        assert law is not None
        told = [gate.level for gate in check_law(known, law, 'drive_2', noise=0.01)]
        assert (set(told) == {'ok'}) == (level == 'ok'), told
    assert 'position_gain' not in {gain.name for gain in fit_law(machine, data, 'drive_2').gains}
