# SPDX-License-Identifier: Apache-2.0
"""A candidate's drives in a simulator's terms: friction, armature and gains at the joint."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
import math

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.kernel import drive as drive_kernel
from ros2_ident.models.drives.model import DriveModel

# What a joint has beside its links, by the names of `Joint`.
PARTS = 'viscous', 'coulomb', 'armature'


@dataclass(frozen=True)
class Gains:
    """A controller: effort = p e + i int e + d (share v_ref - v), e = x_ref - x, clipped.

    Attributes:
        p: N m/rad or N/m.
        i: N m/(rad s) or N/(m s).
        d: N m s/rad or N s/m.
        share: Of the set-point's speed that d sees.
    """

    p: float
    i: float
    d: float
    share: float


@dataclass(frozen=True)
class Joint:
    """One joint; efforts in N m where it turns and in N where it slides.

    Attributes:
        name: In bags and descriptions.
        travel: `rad` or `m`.
        coulomb: Coulomb friction.
        viscous: Viscous friction, what a motor brakes by its own voltage included.
        armature: Inertia of motor and gear, kg m^2 or kg.
        offset: Constant in the effort.
        gains: Its controller; None where none is known.
        limit: Most that the controller asks for; inf where unknown.
    """

    name: str
    travel: str
    coulomb: float
    viscous: float
    armature: float
    offset: float
    gains: Gains | None = None
    limit: float = math.inf

    def effort(self, velocity: Array, acceleration: Array, of: Collection[str] = PARTS) -> Array:
        """Return (K,) what friction and armature take, without the offset.

        Args:
            velocity: (K,).
            acceleration: (K,).
            of: What counts, of `PARTS`; other names count for nothing.
        """
        parts = {
            'coulomb': self.coulomb * np.sign(velocity),
            'viscous': self.viscous * velocity,
            'armature': self.armature * acceleration,
        }
        felt = [part for name, part in parts.items() if name in of]
        return np.asarray(sum(felt, np.zeros_like(velocity)))

    def closest(self, effort: Array, velocity: Array, acceleration: Array) -> 'Joint':
        """Return the joint whose friction and armature come closest to an effort, by squares.

        Args:
            effort: (K,) that motor and gear take, whatever effects make of it.
            velocity: (K,).
            acceleration: (K,).
        """
        columns = np.stack([np.sign(velocity), velocity, acceleration], axis=1)
        if self.armature == 0.0:
            columns = columns[:, :2]
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        found = scipy.optimize.nnls(columns / scale, effort - self.offset)[0] / scale
        coulomb, viscous, armature = (*found.tolist(), 0.0)[:3]
        return replace(self, coulomb=coulomb, viscous=viscous, armature=armature)


def joints_of(model: DriveModel, theta: Array) -> tuple[Joint, ...]:
    """Return the drives compared, as a candidate (N,) has them."""
    block = model.rows(np.atleast_2d(theta))
    return tuple(_joint(model, block, model.machine.drives.index(name)) for name in model.drives)


def at_joints(model: DriveModel, theta: Array, effort: Array) -> Array:
    """Return (D, K) efforts of the drives compared, as logged, at their joints."""
    gear = model.candidates.of(model.rows(np.atleast_2d(theta)), 'gear')[0]
    return np.asarray(gear[list(model.signals.places), None] * effort)


def _joint(model: DriveModel, block: Array, d: int) -> Joint:
    def of(row: str) -> float:
        return float(model.candidates.of(block, row)[0, d])

    gear = of('gear')
    return Joint(
        name=model.machine.drives[d],
        travel=model.travels[d],
        coulomb=gear * of('coulomb'),
        viscous=gear * of('viscous') + of('back_emf'),
        armature=of('motor_mass'),
        offset=of('constant_load') + gear * of('log_bias'),
        gains=_gains(model, of, d),
        limit=gear * of('torque_limit') * (of('drive_gain') or 1.0),
    )


def _gains(model: DriveModel, of: Callable[[str], float], d: int) -> Gains | None:
    """Return the controller of a drive, its cascade multiplied out; None where it has none."""
    if not all(model.machine.known(key) for key in model.gains):
        return None
    p, d_gain, i, share = (
        of(row) for row in ('position_gain', 'velocity_gain', 'integral_gain', 'feedforward')
    )
    gear = of('gear')
    if model.law[d] == drive_kernel.POSITION:
        full = of('drive_gain')
        return Gains(full * p, 0.0, full * d_gain, share)
    if model.law[d] == drive_kernel.PID:
        return Gains(gear * p, gear * i, gear * d_gain, share)
    # The integral of the speed's error is the position's error.
    return Gains(gear * (d_gain * p + i), gear * i * p, gear * d_gain, share)
