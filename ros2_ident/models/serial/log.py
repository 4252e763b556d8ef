# SPDX-License-Identifier: Apache-2.0
"""An arm along its log: recorded motion, and what the described links ask along it."""

import functools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.models.drives.log import DriveLog
from ros2_ident.models.drives.separate import first_seen
from ros2_ident.models.serial.arm import Arm, arm_of
from ros2_ident.models.serial.linkage import Tree
from ros2_ident.models.serial.parameters import Inertials, Transmission
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, smooth_motion

# Samples that a motion has at least, see `smooth_motion`.
_FEW = 3
# Instants of a log that tell its links well enough for what is small. By hand.
_ENOUGH = 2000


class Terms(NamedTuple):
    """Terms that an arm's efforts are sums of.

    Attributes:
        each: (D, K, B) the terms.
        firsts: (D,) the first of a joint's that is not zero.
    """

    each: Array
    firsts: npt.NDArray[np.int64]


class ArmLog(DriveLog):
    """A log of an arm, see `DriveLog`.

    What is made of it is made once: for 20 s of seven joints it takes longer than a hundred
    candidates.
    """

    @functools.cached_property
    def arm(self) -> Arm:
        """The rigid bodies."""
        return arm_of(self.machine)

    @functools.cached_property
    def inertials(self) -> Inertials:
        """Unknown part of the links."""
        return Inertials(self.machine, self.arm)

    @functools.cached_property
    def transmission(self) -> Transmission:
        """Transmission between motors and links."""
        return Transmission(self.machine)

    @property
    def closed(self) -> bool:
        """Whether controllers follow a set-point."""
        return super().closed and self.machine.known('position_gain')

    def joints(self, motors: Array) -> Array:
        """Return (..., D, K) what joints do by what their motors do."""
        return np.asarray(np.linalg.inv(self.transmission.motors) @ motors)

    # ------------------------------------------------------------------ along its recorded motion

    @functools.cached_property
    def lead(self) -> float:
        """How long before its motion an effort may stand in the log, s."""
        name = 'measurement_delay'
        if self.closed:
            return 0.0
        low = self.machine.bounds[name][0] if name in self.machine.bounds else 0.0
        return max(0.0, -min(low, self.fixed.get(name, 0.0)))

    @property
    def ahead(self) -> float:
        """Cycles by which the motion is ahead of the log.

        Its cycle is that of the log: an arm's controllers are faster, and hold hardly anything.
        """
        return self.lead / self.data.cycle

    @property
    def motion(self) -> Array:
        """(3, D, K) the joints' motion: position, velocity, acceleration."""
        if self.closed:
            return self._seen
        if not self.lead:
            return self.followed
        time = np.arange(self.followed.shape[2]) * self.data.cycle
        back = functools.partial(np.interp, time - self.lead, time)
        return np.apply_along_axis(back, 2, self.followed)

    @functools.cached_property
    def driven(self) -> Array:
        """(3, D, K) the motion of the motors."""
        out: Array = np.einsum('de,xek->xdk', self.transmission.motors, self.followed)
        return np.ascontiguousarray(out)

    @functools.cached_property
    def _made(self) -> dict[tuple[bool, bool], Terms]:
        """Those of `terms` that were made."""
        return {}

    def terms(self, *, hand: bool, zeros: bool) -> Terms:
        """Return terms of the motors' efforts along the recorded motion.

        Args:
            hand: With those of what hangs at the last joint; where it is looked for in any case.
            zeros: With those of joints whose positions are more by 1.
        """
        key = hand or self.inertials.carries, zeros
        if key not in self._made:
            self._made[key] = self._with_zeros(key[0]) if zeros else self._of_links(key[0])
        return self._made[key]

    def _of_links(self, hand: bool) -> Terms:
        links = self.inertials.terms(self.arm.terms(*self.followed), hand=hand)
        balance = self.transmission.terms(self.followed[0])
        joints = np.concatenate([links, balance], axis=2)
        terms = np.ascontiguousarray(self.transmission.at_motors(joints))
        return Terms(terms, np.asarray(np.argmax((terms != 0.0).any(axis=1), axis=1)))

    def _with_zeros(self, hand: bool) -> Terms:
        plain = self.terms(hand=hand, zeros=False)
        zeros = self.transmission.at_motors(self.arm.slopes(self._probable, *self.followed))
        return plain._replace(each=np.concatenate([plain.each, zeros], axis=2))

    @functools.cached_property
    def _probable(self) -> Array:
        """(10 D,) inertials of the links, as logged efforts make them probable beside friction."""
        if self.data.effort is None:
            return self.arm.inertials
        every = slice(None, None, 1 + self.data.cycles // _ENOUGH)
        terms = self.terms(hand=False, zeros=False).each[:, every]
        given = np.ravel(self.transmission.coefficients({}, 1))
        links = terms.shape[2] - given.size
        effort = self.data.effort[self.order, every] * self.machine.numbers('gear_factor')[:, None]
        _, speed, acceleration = self.driven[:, :, every]
        beside = np.stack([np.ones_like(speed), np.sign(speed), speed, acceleration], axis=2)
        left = effort - terms[:, :, links - 1] - terms[:, :, links:] @ given
        return self.inertials.probable(terms, left, beside)

    # ------------------------------------------------------------------ under its controllers

    def _set_points(self) -> Array:
        """Return (2, D, K) set-points of the motors, then their rates."""
        return np.asarray(self.transmission.motors @ super()._set_points())

    @functools.cached_property
    def _seen(self) -> Array:
        """(3, D, K) the joints' recorded motion; as wanted where none is."""
        place = self.joints(self.command)[0]
        if self.data.position is not None:
            known = np.isfinite(self.data.position[self.order])
            there = known.sum(axis=1, keepdims=True) > _FEW
            place = np.where(there, self.data.position[self.order], place)
        cutoff = allowed_cutoff(place, self.data.cycle, CUTOFF)
        return np.array(smooth_motion(place, self.data.cycle, cutoff))

    @functools.cached_property
    def begin(self) -> Array:
        """(2, D) where the motors start and how fast, by their first measured positions."""
        begin = np.zeros((2, len(self.order)))
        begin[0] = self.joints(self.command)[0, :, 0]
        begin = first_seen(self.data, self.order, begin)
        return np.ascontiguousarray((self.transmission.motors @ begin[:, :, None])[:, :, 0])

    @functools.cached_property
    def added(self) -> Array:
        """(D, K) effort of the motors that controllers add by the description; (0, K) for none."""
        how = self.machine.text('compensation')
        if how == 'none':
            return np.empty((0, self.data.cycles))
        place, speed = self.joints(self.command)
        zero = np.zeros_like(place)
        if how == 'dynamics':
            rates = np.gradient(speed, self.data.cycle, axis=1)
            asked = self.arm.efforts(place, speed, rates)
        else:
            asked = self.arm.efforts(self._seen[0], zero, zero)
        gear = self.machine.numbers('gear_factor')[:, None]
        return np.ascontiguousarray(self.transmission.at_motors(asked) / gear)

    @functools.cached_property
    def turns(self) -> Array:
        """(D, 3, 3) the turns into the kernel's frames."""
        return self.arm.hangs[2]

    @functools.cached_property
    def inertia(self) -> Array:
        """(D, D) mass matrix of the described links at the motors where the log begins."""
        drives = np.linalg.inv(self.transmission.motors)
        place = self.joints(self.begin[:, :, None])[0, :, 0]
        return np.asarray(drives.T @ self.arm.mass(place) @ drives)

    @functools.cached_property
    def tree(self) -> Tree:
        """The links as the kernel has them, each behind the one that carries it."""
        arm, (order, back) = self.arm, self.arm.orders
        hung, places, _ = arm.hangs
        drives = np.linalg.inv(self.transmission.motors)
        plain = not self.transmission.coupled and (order == np.arange(len(order))).all()
        balances = self.transmission.balances
        balances[:, 0] = back[balances[:, 0].astype(int)]
        parents = arm.parents[order]
        return Tree(
            (0,) * len(order),
            np.where(parents < 0, -1, back[parents]),
            hung[order].reshape(len(order), 9),
            places[order],
            arm.prismatic[order],
            np.array(arm.model.gravity.linear),
            np.ascontiguousarray(drives[order][: 0 if plain else None]),
            np.ascontiguousarray(drives),
            np.ascontiguousarray(balances, dtype=float),
        )
