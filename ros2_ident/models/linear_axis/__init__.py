# SPDX-License-Identifier: Apache-2.0
"""Carriages, each on a motor of its own."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import head, of_geometry, sought
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space
from ros2_ident.models.drives import keys

_GRAVITY = of_geometry('gravity', 'm/s^2',
                       'against positive positions: 0 lying flat, 9.81 upright', 0.0,
                       absent='0 by default', low=-9.9, high=9.9)
_MOVING_MASS = sought(
    'moving_mass',
    'kg',
    'rigid axis: motor and carriage as one, in place of gear_* and drive_inertia; stated in '
    'kg m^2 it says that the joint turns: then rad stands for m and N m for N everywhere',
    (1.0, 20.0),
    low=0.0,
    high=1e5,
    shown=False,
)
_DRIVE = tuple(
    replace(key, meaning=f'{key.meaning}; 0: friction that holds at rest', low=0.0)
    if key.name == 'coulomb_regularisation'
    else key
    for key in keys.drive_keys(3.5)
)
_CONTROLLER = tuple(
    replace(
        key,
        meaning=f'{key.meaning}; effort: none, the logged effort moves the axis, and its motion '
        'is compared (`--outputs position`)',
        choices=(*key.choices, 'effort'),
    )
    if key.name == 'law'
    else key
    for key in keys.controller_keys(1.0e-3)
)


def _judge(draft: Draft) -> Iterator[Remark]:
    yield from keys.judge_drives(draft)
    moving = draft.states('parameters', 'moving_mass')
    massive = moving or draft.states('parameters', 'rail_mass')
    stated = draft.numbers('drive', 'rail_mass') or (0.0,)
    if not massive and min(stated) <= 0.0:
        yield Remark(
            'error',
            ('drive', 'rail_mass'),
            'nothing has a mass: give drive.rail_mass in kg, or list moving_mass under parameters',
        )
    if moving and draft.states('parameters', 'rail_mass'):
        yield Remark(
            'warn',
            ('parameters', 'rail_mass'),
            'rail_mass and moving_mass are the same mass of a linear_axis; list one of them',
        )


def _space(machine: Machine) -> Space:
    count = len(machine.drives)
    if machine.known('gear_factor'):
        return Space(np.full(count, 0.45), np.full(count, 0.12), 0.9, 20.0)
    return Space(np.full(count, 0.125), np.full(count, 0.12), 0.12, 1.2)


KIND = Kind(
    name='linear_axis',
    title='carriages that know nothing of each other; gear elastic or rigid',
    keys=(
        *head('linear_axis', ('axis',)),
        _GRAVITY,
        *_DRIVE,
        *_CONTROLLER,
        keys.DELAY,
        *keys.GEAR,
        keys.INERTIA,
        _MOVING_MASS,
        *keys.FRICTION,
        _GRAVITY.searched(0.0, 9.81),
        *keys.free_constants(*_DRIVE, *_CONTROLLER),
    ),
    model=later('ros2_ident.models.linear_axis.model:LinearAxis'),
    judge=_judge,
    starts_in_motion=True,
    coupled=False,
    space=_space,
)
