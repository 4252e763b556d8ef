# SPDX-License-Identifier: Apache-2.0
"""Constants that differ from drive to drive, and from candidate to candidate."""


import numpy as np
import numpy.typing as npt

from checks.reference.axis import simulate_axis
from checks.reference.tripod import TABLE_5 as TRUTH
from ros2_ident.models import Machine, machine_from_mapping
from ros2_ident.models.linear_axis.model import LinearAxis
from ros2_ident.models.recorded import recorded_motion
from ros2_ident.recording import Dataset

Array = npt.NDArray[np.float64]
CYCLE = 5e-4
TIME = np.arange(1600) * CYCLE
POSITION = np.stack([0.05 * np.sin(9.0 * TIME) ** 2, 0.03 * np.sin(14.0 * TIME) ** 2])
VELOCITY = np.gradient(POSITION, CYCLE, axis=1)
# What two drives have that otherwise are the same.
OWN = {
    'gear_factor': [78.54, 50.0],
    'rail_mass': [1.5, 1.1],
    'coulomb_regularisation': [5e-3, 2e-3],
    'law': ['cascade_pi', 'cascade_p'],
    'position_gain': [61.3, 40.0],
    'velocity_gain': [4.5, 6.0],
    'integral_gain': [250.0, 90.0],
    'velocity_feedforward': [1.0, 0.7],
    'torque_limit': [6.0, 0.3],
}


def axes(*which: int) -> Machine:
    """Return axes that have the constants of these drives."""
    own = {key: [values[d] for d in which] for key, values in OWN.items()}
    of_drive = ('gear_factor', 'rail_mass', 'coulomb_regularisation')
    return machine_from_mapping(
        {
            'machine': 'linear_axis',
            'drives': [f'axis_{d}' for d in range(len(which))],
            'drive': {key: own[key] for key in of_drive},
            'controller': {
                'cycle': CYCLE, **{key: own[key] for key in own if key not in of_drive}
            },
            'parameters': {
                'gear_stiffness': [1e3, 3e5, 'N/m'],
                'gear_damping_ratio': [0.0, 2.0, '1'],
                'drive_inertia': [5e-5, 15e-5, 'kg m^2'],
                'coulomb_torque': [0.0, 0.2, 'N m'],
                'viscous_torque': [0.0, 0.2, 'N m s/m'],
            },
        }
    )  # fmt: skip


def model_of(machine: Machine, which: slice) -> LinearAxis:
    position, velocity = POSITION[which], VELOCITY[which]
    data = Dataset(
        machine.drives, CYCLE, 0, position, velocity, position, velocity, 0.0 * position
    )
    return LinearAxis(machine, data, substeps=16)


def replay(model: LinearAxis, theta: Array) -> Array:
    there = np.ones((len(model.drives), TIME.size), dtype=bool)
    seen = recorded_motion(model.data, model.machine.drives)
    return model.replay_law(seen, theta, there).reshape(len(theta), *there.shape)


def test_every_constant_is_each_drives_own() -> None:
    both = model_of(axes(0, 1), slice(2))
    names = [p.name for p in both.parameters]
    low, high = np.array([(p.low, p.high) for p in both.parameters]).T
    theta = low + (high - low) * np.random.default_rng(4).random((9, len(low)))
    for d in range(2):
        alone = model_of(axes(d), slice(d, d + 1))
        own = theta[
            :, [names.index(p.name.replace('axis_0', f'axis_{d}')) for p in alone.parameters]
        ]
        for of in (LinearAxis.simulate, replay):
            np.testing.assert_array_equal(of(both, theta)[:, d], of(alone, own)[:, 0])
    plain = model_of(axes(0, 0), slice(2)).simulate(theta)
    assert np.abs(both.simulate(theta) - plain).max(axis=(0, 2)).tolist()[0] == 0.0
    assert np.abs(both.simulate(theta) - plain)[:, 1].max() > 0.05


def test_drives_that_differ_follow_their_reference() -> None:
    machine = axes(0, 1)
    values = {key: value for key, value in TRUTH.items() if key != 'tool_mass'}
    del values['measurement_delay']
    log = simulate_axis(machine, values, POSITION, VELOCITY)
    model = model_of(machine, slice(2))
    theta = np.array([[values[p.name.split('.')[-1]] for p in model.parameters]])
    error = model.simulate(theta)[0] - log.effort
    assert np.abs(log.effort[1]).max() == 0.3  # its own limit
    assert np.sqrt(np.mean(error**2, axis=1)).max() < 1e-3 * np.abs(log.effort).max()
