# SPDX-License-Identifier: Apache-2.0
"""Carriages, each on a motor of its own."""

from collections.abc import Iterator

import numpy as np

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space
from ros2_ident.models.drives import keys


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
    keys=keys_of('linear_axis'),
    model=later('ros2_ident.models.linear_axis.model:LinearAxis'),
    judge=_judge,
    starts_in_motion=True,
    coupled=False,
    space=_space,
)
