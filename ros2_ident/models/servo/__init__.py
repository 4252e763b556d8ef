# SPDX-License-Identifier: Apache-2.0
"""Servos: motors fed with a share of a supply voltage by a law on position, an arm as load."""

from collections.abc import Iterator

import numpy as np

from ros2_ident.machine.draft import Draft, Remark
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space

# What a servo logs beside a torque: the share of its supply, the motor's voltage or its current.
DUTY, VOLTAGE, CURRENT = 'duty', 'V', 'A'


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
    keys=keys_of('servo'),
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
