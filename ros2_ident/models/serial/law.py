# SPDX-License-Identifier: Apache-2.0
"""Gains, friction, rotors and links of an arm by its log alone, before anything is simulated.

What a controller asks is linear in its gains, and what a motor needs in friction and rotor
(Gautier, Janot, Vandanjon, IEEE TCST 21(2), 2013). Noise of the motion biases both, a free run
then does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from ros2_ident.arrays import Array, rms
from ros2_ident.models.protocol import FullModel, Mask

# Slower than this share of the top speed the direction of friction is open.
_SLOW = 0.05
# What is asked of the controllers, and what of a motor.
GAINS = (
    'position_gain', 'integral_gain', 'velocity_gain', 'velocity_feedforward', 'set_point_delay',
)  # fmt: skip
JOINT = 'drive_inertia', 'coulomb_torque', 'viscous_torque'


@dataclass(frozen=True)
class Signals:
    """A log below one frequency, at the motors.

    Attributes:
        cycle: Time from instant to instant, s.
        motion: (3, D, K) position, velocity and acceleration where set-points change, rad or m.
        middle: (3, D, K) half way to the next one, where a motor is moved by what is held.
        wanted: (D, K) set-points.
        links: (D, K) effort that the described links ask there, by the logged unit.
        added: (D, K) effort that the controllers add to their law's.
        effort: (D, K) logged effort, NaN in the row of a motor without; None where none is.
        gear: (D,) motor's angle per joint's.
    """

    cycle: float
    motion: Array
    middle: Array
    wanted: Array
    links: Array
    added: Array
    effort: Array | None
    gear: Array


def by_regression(seen: Signals, known: Mapping[str, Array]) -> tuple[dict[str, Array], Array]:
    """Return estimates of `GAINS` and `JOINT`, none below 0, and how much of the law is missed.

    Args:
        seen: The log.
        known: (D,) values by name, NaN where they are to be found.

    Returns:
        (D,) each, and (D,) the share of the controllers' effort that the law leaves in a half of
        the log by the gains of the other, its mean square over the effort's; where no effort is
        logged, that of the motor's needs.
    """
    found = {name: known[name].copy() for name in (*GAINS, *JOINT)}
    left = np.empty(len(seen.gear))
    for d in range(len(seen.gear)):
        held, names, rest = _law(seen, seen.middle[:, d], known, d)
        # What rotor, Coulomb and viscous friction of 1 need.
        _, speed, acceleration = seen.middle[:, d]
        needs = np.stack([seen.gear[d] * acceleration, np.sign(speed), speed])
        moves = np.abs(speed) >= _SLOW * np.abs(speed).max()
        asked = seen.links[d] - seen.added[d]
        logged = None if seen.effort is None else seen.effort[d]
        if logged is None or not np.isfinite(logged).all():
            # The law makes what the motor needs.
            columns, values = np.concatenate([held, -needs])[:, moves], (asked - rest)[moves]
            _fill(found, d, (*names, *JOINT), columns, values)
        else:
            columns, _, known_part = _law(seen, seen.motion[:, d], known, d)
            values = logged - seen.added[d] - known_part
            gains = _fill(found, d, names, columns, values)
            _fill(found, d, JOINT, needs[:, moves], (rest + gains @ held - asked)[moves])
        left[d] = _missed(columns, values)
    products = ('set_point_delay', 'position_gain'), ('velocity_feedforward', 'velocity_gain')
    for name, gain in products:
        # of a gain that is none it is not known
        own = np.divide(found[name], found[gain], out=np.zeros(len(left)), where=found[gain] > 0.0)
        found[name] = np.where(np.isnan(known[name]), own, known[name])
    return found, left


def _law(
    seen: Signals, motion: Array, known: Mapping[str, Array], d: int
) -> tuple[Array, tuple[str, ...], Array]:
    """Return columns (C, K) of the free gains, their names, and what the known ones make (K,).

    A late set-point and feed-forward are products with a gain; one without a name is the integral
    part at the log's beginning.
    """
    place, speed = motion[:2]
    time = np.arange(place.size) * seen.cycle
    own = {name: float(known[name][d]) for name in GAINS}
    wanted = seen.wanted[d]
    if own['set_point_delay'] > 0.0:
        wanted = np.interp(time - own['set_point_delay'], time, wanted)
    rate = np.gradient(wanted, seen.cycle)
    error = wanted - place
    integral = np.cumsum(error) * seen.cycle
    ahead = own['velocity_feedforward']
    free_ahead = np.isnan(ahead)
    every = {
        'position_gain': error,
        'integral_gain': integral,
        'velocity_gain': (0.0 if free_ahead else ahead) * rate - speed,
        'velocity_feedforward': rate,
        'set_point_delay': -rate,
    }
    # A delay and feed-forward are one column; the latter is looked for where both are open.
    if free_ahead or not np.isnan(own['set_point_delay']):
        del every['set_point_delay']
    if not free_ahead:
        del every['velocity_feedforward']
    names = [name for name in every if np.isnan(own[name])]
    columns = [every[name] for name in names]
    if np.isnan(own['integral_gain']) or own['integral_gain'] > 0.0:
        names += ['', '']
        columns += [np.ones(place.size), -np.ones(place.size)]
    rest = sum((own[n] * x for n, x in every.items() if n not in names), np.zeros_like(place))
    return np.array(columns).reshape(len(names), place.size), tuple(names), rest


def _fill(
    found: Mapping[str, Array], d: int, names: tuple[str, ...], columns: Array, values: Array
) -> Array:
    """Write what columns (C, K) make of values (K,), where it is not known; return it (C,)."""
    whole = np.array([found[name][d] if name else np.nan for name in names])
    free = np.isnan(whole)
    whole[free] = 0.0
    whole[free] = _solved(columns[free], values - whole @ columns)
    for name, value in zip(names, whole.tolist(), strict=True):
        if name:
            found[name][d] = value
    return whole


def _solved(columns: Array, values: Array) -> Array:
    if not len(columns):
        return np.empty(0)
    scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    return np.asarray(scipy.optimize.nnls((columns / scale[:, None]).T, values)[0] / scale)


def _missed(columns: Array, values: Array) -> float:
    """Return the share of values (K,) that each half of them leaves by the other's columns."""
    first, total = np.arange(values.size) < values.size // 2, 0.0
    for one in (first, ~first):
        told = _solved(columns[:, one], values[one]) @ columns[:, ~one]
        total += float(np.sum((values[~one] - told) ** 2))
    return total / max(float(np.sum(values**2)), 1e-300)


def left_by_quarters(model: FullModel) -> Array:
    """Return (E,) the mean square that a linear model leaves of the drives with an effort.

    Of each quarter of a log, by what its parameters are in the others. A drive weighs by what is
    left of it at the least, as in the source above: else what the heaviest joint leaves decides on
    the links of all.
    """
    low, high = np.array([(p.low, p.high) for p in model.parameters]).T
    # Of lines the ends of the box tell the slopes.
    at, *moved = model.residuals(low + np.vstack([np.zeros_like(low), np.diag(high - low)]))
    rows, instant = np.nonzero(np.isfinite(model.measured))
    _, drive = np.unique(rows, return_inverse=True)
    quarter = instant * 4 // model.measured.shape[1]
    columns = np.column_stack([x - at for x in moved])
    each = (drive == d for d in range(drive.max() + 1))
    alone = [rms(_left_over(columns, at, own, own)) for own in each]
    weight = np.array([x or 1.0 for x in alone])[drive, None]
    whole = np.column_stack([columns, at]) / weight
    left = np.empty_like(at)
    for own in (quarter == n for n in range(4)):
        left[own] = _left_over(whole[:, :-1], whole[:, -1], ~own, own)
    return np.bincount(drive, (left * weight[:, 0]) ** 2) / np.bincount(drive)


def _left_over(columns: Array, values: Array, told: Mask, asked: Mask) -> Array:
    """Return what columns (K, C) leave of values (K,) in rows that are asked, by others."""
    shares = np.linalg.lstsq(columns[told], values[told], rcond=None)[0]
    return np.asarray(values[asked] - columns[asked] @ shares)
