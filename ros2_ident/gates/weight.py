# SPDX-License-Identifier: Apache-2.0
"""Are an arm's efforts those that its description asks for: their size, and which way is down?

    effort = factor weight + inertia + rotor acceleration + friction + viscous speed + offset

is fitted to each joint by itself, and to all of them with one free fall of any direction.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.gates import scale
from ros2_ident.gates.finding import Gate, Level
from ros2_ident.gates.scale import figure, near
from ros2_ident.machine.units import STATED_FOR
from ros2_ident.models import Machine
from ros2_ident.models.registry import kind_of
from ros2_ident.recording import Dataset, smooth_motion
from ros2_ident.recording.limits import likewise
from ros2_ident.recording.motion import allowed_cutoff, direction, fill_gaps, low_pass
from ros2_ident.recording.quality import standing

# Samples compared at most, for time: below 10 Hz more of them say the same. By hand.
_MOST = 2000
# Parts of a log of which one is left out in turn. By hand.
_PARTS = 10
# The best of gears, one spur stage, loses this share of what it transmits (textbooks: 1 to 3 %).
_LOSES = 0.03
# A weight that varies by less of itself cannot be told from a constant. By hand.
_SAME = 0.1
# Effort that is this share of a weight holds none of it. By hand.
_NOTHING = 0.05
# A direction that joints feel by less than this share of the one they feel most is not told: a
# hundred times as much noise. By hand.
_FELT = 1e-2


@dataclass(frozen=True)
class _Joint:
    """A joint's effort and the columns that may explain it: (T,) or (T, C) values.

    Attributes:
        inertia: What the description's inertia asks for.
        weight: What its weight asks for.
        falls: The same in a free fall of 1 m/s^2 along x, y and z of the base.
        rotor: The acceleration.
        friction: Its direction, and the speed.
        free: One, and forces of counterbalances.
    """

    drive: str
    effort: Array
    inertia: Array
    weight: Array
    falls: Array
    rotor: Array
    friction: Array
    free: Array

    def beside_weight(self, rows: Array) -> Array:
        """Return (T, ...) rows less their least-squares fit by all but the weight."""
        return _without(rows, self.inertia, self.rotor, self.friction, self.free)

    def factor(self) -> float:
        """Return effort per effort that the description asks for, NaN where it does not show.

        A joint without a weight shows it by its inertia, to which a rotor can only add.
        """
        sides = self.beside_weight(self.weight), self.beside_weight(self.effort)
        factor = _factor(*sides)
        if math.isfinite(factor):
            return factor
        if self.weight.any():
            # Of the other sign is an effort which friction gives power, too: a cable is not.
            turned = _below_zero(*sides) if self.friction_power() < 0.0 else math.nan
            return turned if math.isfinite(turned) else self.held()
        beside = self.friction, self.free
        factor = _factor(_without(self.inertia, *beside), _without(self.effort, *beside))
        return factor if factor < 1.0 / scale.ANOTHER else math.nan

    def held(self) -> float:
        """Return effort per weight where that stays the same, far above all efforts; else NaN.

        A constant can be a cable's pull, but none that takes away a weight. Its sign is not known.
        """
        weight = float(np.mean(self.weight))
        same = np.ptp(self.weight) < _SAME * abs(weight) and self.free.shape[1] == 1
        far = scale.ANOTHER * float(np.abs(self.effort).max()) < abs(weight)
        return abs(float(np.mean(self.effort)) / weight) if same and far else math.nan

    def friction_power(self) -> float:
        """Return the power that friction takes from the drive, in its effort and speed."""
        parts = self.weight, self.inertia, self.rotor, self.free, self.friction
        found = np.linalg.lstsq(np.column_stack(parts), self.effort, rcond=1e-9)[0]
        return float(np.mean(self.friction @ found[-2:] * self.friction[:, -1]))

    def lost(self) -> float:
        """Return the larger of friction and rotor, as a share of how the effort varies."""
        columns = np.column_stack([self.weight, self.free, self.rotor, self.friction])
        found = np.linalg.lstsq(columns, self.effort - self.inertia, rcond=1e-9)[0]
        made = self.rotor * found[-3], self.friction @ found[-2:]
        return max(float(np.std(part)) for part in made) / float(np.std(self.effort))


def check_weight(machine: Machine, data: Dataset) -> tuple[list[Gate], dict[str, float]]:
    """Compare efforts with those of a description of links, if any, along the recorded motion.

    Returns:
        The findings, and effort per effort that the description asks for of the joints that show
        it.
    """
    try:
        joints = list(_joints(machine, data))
    except IdentError:
        return [], {}  # said where the model is made
    if tilted := _tilted(machine, joints):
        return tilted, {}
    factors = {x.drive: f for x in joints if math.isfinite(f := x.factor())}
    constant = STATED_FOR.get(machine.effort_unit, '')
    return _sized(factors, constant) or _behind_gears(machine, joints), factors


def _joints(machine: Machine, data: Dataset) -> Iterator[_Joint]:
    """Yield the joints that move and whose effort is logged."""
    asked = kind_of(machine).asked
    if asked is None or data.position is None or data.effort is None:
        return
    order = [data.names.index(name) for name in machine.drives]
    position, effort = data.position[order], data.effort[order]
    cutoff = allowed_cutoff(position, data.cycle, scale.SLOW)
    ends = int(scale.ENDS / (cutoff * data.cycle))
    count = position.shape[1] - 2 * ends
    if count < scale.FEWEST:
        return
    kept = slice(ends, ends + count, math.ceil(count / _MOST))
    motion = np.stack(smooth_motion(position, data.cycle, cutoff))[:, :, kept]
    inertia, weight, *others = asked(machine, motion)
    strokes = dict(zip(machine.drives, np.ptp(motion[0], axis=1).tolist(), strict=True))
    still = standing(strokes)
    for d, drive in enumerate(machine.drives):
        described = inertia[d].any() or weight[d].any()
        logged = effort[d, np.isfinite(effort[d])]
        told = logged.size >= scale.FEWEST and np.ptp(logged) > 0.0
        if not (described and told and strokes[drive]) or drive in still:
            continue
        more = np.array(others)[:, d].T
        speed, rotor = motion[1:, d]
        slow = low_pass(fill_gaps(effort[d]), data.cycle, cutoff)[kept]
        friction = np.stack([direction(speed), speed], axis=1)
        free = np.column_stack([np.ones_like(speed), more[:, 3:]])
        yield _Joint(drive, slow, inertia[d], weight[d], more[:, :3], rotor, friction, free)


def _without(rows: Array, *parts: Array) -> Array:
    """Return (T, ...) rows less their least-squares fit by columns (T,) or (T, C)."""
    columns = np.column_stack(parts)
    return rows - columns @ np.linalg.lstsq(columns, rows, rcond=1e-9)[0]


def _factor(column: Array, row: Array) -> float:
    """Return a row per column (T,), NaN where most of either is left."""
    square = float(column @ column)
    factor = float(column @ row) / square if square else math.nan
    left = row - factor * column
    told = float(left @ left) <= (1.0 - scale.FOLLOWS) * max(1.0, factor**2) * square
    return factor if told else math.nan


def _below_zero(column: Array, row: Array) -> float:
    """Return a row per column (T,) where that is below 0 for certain, else NaN.

    How far it is known is seen by leaving parts of the log out in turn (jackknife), as what is
    left of the row is no white noise.
    """
    parts = zip(np.array_split(column, _PARTS), np.array_split(row, _PARTS), strict=True)
    sums = np.array([(x @ x, x @ y, y @ y) for x, y in parts])
    square, product, size = whole = sums.sum(axis=0)
    if product**2 < scale.STRAYS * square * size or not square:
        return math.nan
    factor, without = float(product / square), whole - sums
    spread = math.sqrt(_PARTS - 1) * float(np.std(without[:, 1] / without[:, 0]))
    return factor if factor < -scale.STANDS_OUT * spread else math.nan


def _tilted(machine: Machine, joints: list[_Joint]) -> list[Gate]:
    """Say it where gravity of another direction explains the efforts, and the stated none."""
    tilt = kind_of(machine).tilt
    size = machine.number('free_fall') if tilt and joints else 0.0
    if tilt is None or not size:
        return []
    rows = [x.beside_weight(np.column_stack([x.effort, x.weight, x.falls])) for x in joints]
    stated = sum(float(np.square(_without(x[:, 0], x[:, 1:2])).sum()) for x in rows)
    every = np.concatenate(rows)
    fall: Array = np.asarray(np.linalg.lstsq(every[:, 2:], every[:, 0], rcond=_FELT)[0])
    left = float(np.square(every[:, 0] - every[:, 2:] @ fall).sum())
    if left > scale.SWAPPED * stated or not near(math.sqrt(float(fall @ fall)) / size):
        return []
    keys = tilt(fall)
    listed = ', '.join(f'{key}: {round(value, 2) + 0.0:g}' for key, value in keys.items())
    text = (
        f'the efforts hold the weight of an arm whose base is tilted otherwise; write {listed} '
        'under geometry'
    )
    return [Gate('tilt', '', 'fail', math.nan, 'rad', text, True, next(iter(keys)))]


def _sized(factors: dict[str, float], constant: str) -> list[Gate]:
    """Say it where efforts are another's size than a description asks for.

    Args:
        constant: Key of the machine file by which efforts are torques; empty where they are logged
            as such.
    """
    off = {drive: factor for drive, factor in factors.items() if not near(factor, scale.ANOTHER)}
    if not off:
        return []
    (drive, factor), *others = sorted(off.items(), key=lambda x: abs(x[1]) < _NOTHING)
    # A description that is wrong is not so by one factor on every joint.
    by_one = len(off) == len(factors) > 1 and all(near(x / factor) for x in off.values())
    turned = [name for name, x in off.items() if x < 0.0]
    # No masses, right or wrong, turn the efforts of all joints over.
    sure = by_one or (len(factors) > 1 and all(x < -_NOTHING for x in factors.values()))
    rest = '' if by_one else likewise(f'{n} {figure(x)}' for n, x in others)
    text = (
        f'{"all joints" if by_one else drive}: the effort is {figure(factor)} times what the '
        f'description asks for{rest}; '
    )
    if all(abs(x) < _NOTHING for x in factors.values()) and not constant:
        text += 'log the whole torque, not one with gravity compensated, or set free_fall to 0'
    else:
        hangs = ', or write base_roll: 3.14 where the arm hangs' * sure
        whose = '' if len(turned) == len(factors) else f' of {", ".join(turned)}'
        steps = [f'negate the effort or the position{whose} in the driver{hangs}'] * bool(turned)
        if not near(-factor):
            unit = 'state effort_unit with torque_constant or rated_torque'
            first = f'correct {constant}' if constant else unit
            steps.append(
                f"{first}, gear_factor where it is the motor's, or correct the masses of the "
                'description'
            )
        text += ', and '.join(steps)
    level: Level = 'fail' if sure else 'warn'
    return [Gate('weight', '', level, factor, '1', text, sure, cause='size')]


def _behind_gears(machine: Machine, joints: list[_Joint]) -> list[Gate]:
    """Say it where no effort shows the friction and inertia of motors and gears."""
    takes = ('drive_inertia', 'coulomb_torque', 'viscous_torque')
    sought = [name for name in takes if name in machine.bounds]
    if not joints or not sought or any(x.lost() > _LOSES for x in joints):
        return []
    text = (
        'no effort shows friction or the inertia of a rotor, as those of torque sensors behind '
        f'the gears: such a log cannot tell {", ".join(sought)}; remove them from parameters, or '
        'log the torques of the motors'
    )
    return [Gate('behind_gears', '', 'warn', math.nan, '1', text)]
