# SPDX-License-Identifier: Apache-2.0
"""Servos: motors fed with a share of a supply voltage by a law on position, an arm as load."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import head, Key, of_controller, of_drive, of_geometry, sought
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space
from ros2_ident.models.drives import keys

# What a servo logs beside a torque: the share of its supply, the motor's voltage or its current.
DUTY, VOLTAGE, CURRENT = 'duty', 'V', 'A'

_EFFORT = (
    Key('', 'effort_unit', '', 'of a logged effort: N m, duty (share of the supply), V or A', DUTY,
        absent='N m by default; not read where no effort is compared', shown=False),
)
_GRAVITY = of_geometry('gravity', 'm/s^2',
                       '9.81 where the arm turns in a vertical plane, 0 where it lies flat', 9.81,
                       absent='0 by default', low=0.0, high=9.9)
_optional = partial(of_drive, absent='0 by default', default=0.0)
_LOAD = (
    _optional('load_mass', 'kg', 'at the end of the arm', 0.5, low=0.0, high=1e3),
    _optional('load_length', 'm', 'of the arm', 0.1, low=0.0, high=10.0),
    _optional('arm_mass', 'kg', 'of the arm, spread evenly over it', 0.02, low=0.0, high=1e3),
    _optional('load_inertia', 'kg m^2', 'that gravity does not turn', 1.0e-3, low=0.0, high=1e3),
    _optional('load_angle', 'rad', 'position at which the arm hangs', 0.0, low=-7.0, high=7.0),
)
_MOTOR = (
    of_drive('supply_voltage', 'V', 'of the motor at duty 1', 7.4, low=0.1, high=1e3),
    of_drive('torque_constant', 'N m/A', 'at the output shaft, as V s/rad', 0.4, low=1e-4,
             high=1e3),
    of_drive('resistance', 'Ohm', 'of the winding', 4.0, low=1e-3, high=1e3),
    of_drive('armature', 'kg m^2', 'of rotor and gear, at the output', 2.0e-3, low=0.0, high=1e2),
)
_SIGN = of_drive('coulomb_regularisation', 'rad/s',
                 'width v of the step in Coulomb friction, tanh(speed / v), which creeps; 0: '
                 'friction that holds', 1.0e-2, absent='0 by default', default=0.0, low=0.0,
                 high=1.0, shown=False)
_CONTROLLER = (
    of_controller('law', '', 'position: P and D on the position', 'position',
                  absent='position by default', default='position', shown=False,
                  choices=('position',)),
    Key('controller', 'cycle', 's', "period of the firmware's law", 1.0e-3, low=1e-6, high=0.05),
    of_controller('position_gain', '1/rad', 'duty per position error', 0.29,
                  absent='needed where a set-point is recorded', low=1e-4, high=1e4),
    of_controller('velocity_gain', 's/rad', "duty per velocity error, the law's D", 0.01,
                  absent='0 by default', default=0.0, low=0.0, high=1e3, shown=False),
    of_controller('velocity_feedforward', '1', "share of the set-point's velocity in the law's D",
                  1.0, absent='0 by default', low=0.0, high=1.5, shown=False),
    of_controller('duty_limit', '1', 'the duty is clipped to plus and minus this', 1.0,
                  absent='1 by default', default=1.0, low=1e-3, high=1.0),
)
_sought = partial(sought, absent='none by default', low=0.0)
_FRICTION = (
    _sought('coulomb_torque', 'N m', 'Coulomb friction', (0.0, 0.2), high=1e3),
    _sought('viscous_torque', 'N m s/rad', 'viscous friction', (0.0, 0.2), high=1e3),
)
_GEAR = (
    _sought('gear_stiffness', 'N m/rad', 'of a gear that gives', (10.0, 1e4), high=1e9,
            shown=False),
    _sought('gear_damping_ratio', '1', 'of motor and load swinging against each other', (0.0, 2.0),
            high=100.0, shown=False),
)
# Where a newcomer begins: what a data sheet does not say well enough.
_SOUGHT = ('torque_constant', 'resistance', 'armature', 'load_angle')
_SPREAD = {
    'torque_constant': (0.1, 1.0),
    'resistance': (1.0, 10.0),
    'armature': (1e-4, 1e-2),
    'load_angle': (-0.1, 0.1),
    'duty_limit': (0.5, 1.0),
}


def _free(key: Key) -> Key:
    low, high = _SPREAD.get(key.name, (None, None))
    return key.searched(low, high, shown=key.name in _SOUGHT)


def _judge(draft: Draft) -> Iterator[Remark]:
    def known(name: str) -> bool:
        return draft.states('drive', name) or draft.states('parameters', name)

    if not (known('load_inertia') or known('load_length') or known('armature')):
        yield Remark(
            'error',
            ('drive',),
            'nothing has an inertia: give armature, load_inertia, or load_mass and load_length',
        )
    if (known('load_mass') or known('arm_mass')) and not known('load_length'):
        yield Remark(
            'warn',
            ('drive', 'load_length'),
            'a mass without load_length neither weighs nor has inertia; add the length of the arm',
        )
    if draft.states('parameters', 'gear_damping_ratio') and not draft.states(
        'parameters', 'gear_stiffness'
    ):
        yield Remark(
            'error',
            ('parameters', 'gear_damping_ratio'),
            'a gear that is damped has to give: list gear_stiffness, too, or remove the line',
        )


def _space(machine: Machine) -> Space:
    count = len(machine.drives)
    return Space(np.zeros(count), np.full(count, 1.2), 4.0, 30.0)


KIND = Kind(
    name='servo',
    title='motors fed with a voltage by P or PD on position, arms or inertias as load',
    keys=(
        *head('servo', ('servo',), effort=_EFFORT),
        _GRAVITY,
        *_MOTOR,
        *_LOAD,
        _SIGN,
        *_CONTROLLER,
        keys.DELAY.at((0.0, 0.05), shown=False, absent='none by default'),
        *_FRICTION,
        *_GEAR,
        _GRAVITY.searched(),
        *(_free(key) for key in (*_MOTOR, *_LOAD)),
        *(_free(key) for key in (_SIGN, *_CONTROLLER) if key.unit and key.name != 'cycle'),
    ),
    model=later('ros2_ident.models.servo.model:Servo'),
    judge=_judge,
    starts_in_motion=True,
    travel='rad',
    compares=('position',),
    logs=(DUTY, VOLTAGE, CURRENT),
    released=True,
    efforts=later('ros2_ident.models.servo.model:stall_torque'),
    space=_space,
)
