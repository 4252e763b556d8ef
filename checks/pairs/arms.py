# SPDX-License-Identifier: Apache-2.0
"""Pairs of logs of an arm under position controllers, by MuJoCo in fine steps."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from checks.generators.arm_cases import (
    coloured,
    draw_motion,
    draw_robot,
    PANDA,
    Robot,
    STRIDE,
    UR10,
)
from checks.generators.free_arms import (
    draw_gains,
    FRICTION,
    simulate,
    TORQUE,
    write_log,
    write_machine,
)
from checks.pairs.draw import kind_of
from ros2_ident.change.result import Suspect

Array = npt.NDArray[np.float64]

# A load in the hand: of which effect it is, kg for a share of 1, and how far off it lies, m.
LOAD, HEAVY, REACH = 'hand_load', 5.0, 0.1
_BALL = '1e-6 1e-6 1e-6'  # kg m^2, as good as a point
# Parameters of a joint that may change: rows of the gains, and what a robot calls the others.
GAINS = 'position_gain', 'velocity_gain'
OTHERS = {'drive_inertia': 'rotors', 'coulomb_torque': 'dry', 'viscous_torque': 'viscous'}


@dataclass(frozen=True)
class Loaded(Robot):
    """Robot that carries a body, `load` of (mass, x, y, z) in the frame of its last link."""

    load: tuple[float, ...] = ()

    def xml(self, rotors: bool) -> str:
        """Return its MJCF, see `Robot`."""
        mass, *place = self.load
        at = ' '.join(map(str, place))
        ball = f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{_BALL}"/>'
        whole = super().xml(rotors)
        return whole.replace('</body>', f'<body pos="{at}">{ball}</body></body>', 1)


def values_of(robot: Robot, gains: Array, name: str) -> Array:
    """Return (D,) a parameter of every joint."""
    row: Array = gains[GAINS.index(name)] if name in GAINS else getattr(robot, OTHERS[name])
    return row


def changed(
    robot: Robot, gains: Array, name: str, joint: int, share: float
) -> tuple[Robot, Array]:
    """Return an arm of which a parameter of a joint is larger by a share."""
    values = values_of(robot, gains, name).copy()
    values[joint] *= 1.0 + share
    if name not in GAINS:
        own: dict[str, Any] = {OTHERS[name]: values}
        return replace(robot, **own), gains
    new = gains.copy()
    new[GAINS.index(name)] = values
    return robot, new


def draw_arm(folder: Path, case: int, seed: int) -> dict[str, Any]:
    """Draw a pair, write logs, description and machine file, and return the label."""
    rng = np.random.default_rng([seed, case])
    table = (UR10, PANDA)[int(rng.integers(2))]
    robot, joints = draw_robot(rng, table), len(table[3])
    gains = draw_gains(rng, robot, joints)
    names = tuple(f'joint_{n + 1}' for n in range(joints))
    motions = [draw_motion(rng, joints)[0, ::STRIDE] for _ in range(2)]
    kind, size, which = kind_of(rng)
    joint, shape = int(rng.integers(joints)), float(rng.uniform())
    places, efforts, _ = simulate(robot, gains, motions[0])
    noise = rng.uniform(0.005, 0.02) * efforts.std(axis=0)
    label: dict[str, Any] = {'kind': kind, 'size': size, 'motion': which}
    other = simulate(robot, gains, motions[1])[:2] if which else (places, efforts)
    after = other
    if kind != 'none':
        effects = *FRICTION, *TORQUE, LOAD
        name = str(rng.choice(effects if kind == 'effect' else [*GAINS, *OTHERS]))
        sign = float(rng.choice([-1.0, 1.0]))
        step = 0.1 * (1.0 if name == LOAD else robot.dry[joint] if kind == 'effect' else sign)
        rms = size
        place = rng.uniform(-REACH, REACH, 3)
        for _ in range(4):
            step = max(-0.9, step * size / max(rms, 1e-9))
            if name == LOAD:
                loaded = Loaded(**vars(robot), load=(HEAVY * step, *place))
                run = simulate(loaded, gains, motions[which])
            elif kind == 'effect':
                run = simulate(robot, gains, motions[which], name, joint, step, shape)
            else:
                there, own = changed(robot, gains, name, joint, step)
                run = simulate(there, own, motions[which])
            after = run[:2]
            rms = float((np.sqrt(np.mean((after[1] - other[1]) ** 2, axis=0)) / noise).max())
            if abs(rms / size - 1.0) < 0.15:
                break
        where = names[joint] if kind == 'effect' else ''
        label |= {'name': name, 'where': 'all' if name == LOAD else where, 'size': rms}
        if name == LOAD:
            label |= {'sized': f'{LOAD}.mass', 'change': HEAVY * step, 'place': place.tolist()}
        if kind == 'parameter':
            before = float(values_of(robot, gains, name)[joint])
            label |= {
                'name': f'{names[joint]}.{name}',
                'value': before,
                'change': step * before,
            }
    both = (('before', motions[0], places, efforts), ('after', motions[which], *after))
    for bag, wanted, at, effort in both:
        write_log(folder / bag, wanted, at, effort + coloured(rng, len(effort), noise))
    believed = gains * rng.uniform(0.7, 1.4, gains.shape)
    write_machine(folder, robot, believed, folder / 'before')
    return label


class ArmSides:
    """Arm of which nothing changes, then the side after with one change."""

    def __init__(self, folder: Path, case: int, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, case])
        table = (UR10, PANDA)[int(rng.integers(2))]
        self.folder, (self.robot, joints) = folder, (draw_robot(rng, table), len(table[3]))
        self.gains = draw_gains(rng, self.robot, joints)
        motions = [draw_motion(rng, joints)[0, ::STRIDE] for _ in range(2)]
        self.wanted = motions[int(rng.random() < 0.5)]
        self.place = rng.uniform(-REACH, REACH, 3)
        places, efforts, _ = simulate(self.robot, self.gains, motions[0])
        self.noise = rng.uniform(0.005, 0.02) * efforts.std(axis=0)
        write_log(folder / 'before', motions[0], places,
                  efforts + coloured(rng, len(efforts), self.noise))  # fmt: skip
        self.again('after', None, 0.0)
        believed = self.gains * rng.uniform(0.7, 1.4, self.gains.shape)
        write_machine(folder, self.robot, believed, folder / 'before')

    def again(self, name: str, what: Suspect | None, step: float) -> None:
        """Write the side after anew, with a change of a size."""
        robot, gains = self.robot, self.gains
        if what is not None and what.name == LOAD:
            robot = Loaded(**vars(robot), load=(step, *self.place))
        elif what is not None:
            joint, _, own = what.name.rpartition('.')
            at = int(joint.removeprefix('joint_')) - 1
            share = step / float(values_of(robot, gains, own)[at])
            robot, gains = changed(robot, gains, own, at, share)
        places, efforts, _ = simulate(robot, gains, self.wanted)
        noisy = efforts + coloured(self.rng, len(efforts), self.noise)
        write_log(self.folder / name, self.wanted, places, noisy)
