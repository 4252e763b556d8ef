# SPDX-License-Identifier: Apache-2.0
"""An arm of links and joints, driven by its recorded motion or run freely by its controllers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import functools
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.effects import Context
from ros2_ident.errors import IdentError
from ros2_ident.kernel import drive as drive_kernel
from ros2_ident.kernel import rows
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.drives.model import Compiled, DriveModel
from ros2_ident.models.drives.outputs import chosen_outputs
from ros2_ident.models.drives.separate import first_seen
from ros2_ident.models.protocol import Output, RecordedMotion
from ros2_ident.models.serial import kernel, kernel_free
from ros2_ident.models.serial.arm import Arm, arm_of, INERTIALS
from ros2_ident.models.serial.law import by_regression, GAINS, JOINT, Signals
from ros2_ident.models.serial.linkage import Tree
from ros2_ident.models.serial.parameters import Inertials, Transmission, turned
from ros2_ident.recording.motion import (
    allowed_cutoff,
    CUTOFF,
    fill_gaps,
    low_pass,
    smooth_motion,
)

# What a model and all that extend it have in common, made once: for 20 s of seven joints it takes
# longer than a hundred candidates.
_COMMON = ('arm', 'inertials', 'transmission', '_recorded')
_ALONG, _FREE = (
    ('_driven', '_terms', '_firsts'),
    ('tree', '_turns', '_begin', '_added', '_inertia'),
)
# Longest step [s]: with 2 ms links alone are 4e-7 rad off on the arms of
# `checks/benchmarks/arm.py`.
_STEP = 0.0025
# Samples that a motion has at least, see `smooth_motion`.
_FEW = 3


class Serial(DriveModel):
    """An arm's joints; see `DriveModel`.

    Where the controllers' gains are known they follow the set-point: PID on position, and what the
    description says of gravity or dynamics added. Else the recorded motion drives the joints, and
    a set-point is not looked at.
    """

    gains = ('position_gain',)

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

    def as_described(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return the base parameters of the links as described, see `FullModel.as_described`."""
        return self.inertials.as_described(self.machine, given)

    def _take_over(self, like: DriveModel) -> None:
        super()._take_over(like)
        names = *_COMMON, *(_FREE if like._closed else _ALONG)
        self.__dict__.update({name: getattr(like, name) for name in names})

    def _inputs(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        return self._recorded

    @functools.cached_property
    def _recorded(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        """Set-points, motion and what drives the joints."""
        return super()._inputs()

    @property
    def _followed(self) -> Array:
        """(3, D, K) the joints' motion that drives the model, by `_lead` ahead of the log."""
        return super().motion

    @functools.cached_property
    def _driven(self) -> Array:
        """(3 * D * K,) the motion of the motors."""
        out: Array = np.einsum('de,xek->xdk', self.transmission.motors, self._followed)
        return np.ascontiguousarray(out).ravel()

    @functools.cached_property
    def _terms(self) -> Array:
        """(D, K, B) terms of the motors' efforts along the recorded motion, made once."""
        links = self.inertials.terms(self.arm.terms(*self._followed))
        balance = self.transmission.terms(self._followed[0])
        joints = np.concatenate([links, balance], axis=2)
        return np.ascontiguousarray(self.transmission.at_motors(joints))

    @property
    def motion(self) -> Array:
        """(3, D, K) the joints' motion: position, velocity, acceleration."""
        if self._closed:
            return self._seen
        if not self._lead:
            return self._followed
        time = np.arange(self._followed.shape[2]) * self.cycle
        rows = self._followed.reshape(-1, len(time))
        back = [np.interp(time - self._lead, time, row) for row in rows]
        return np.array(back).reshape(self._followed.shape)

    @functools.cached_property
    def _lead(self) -> float:
        """How long before its motion an effort may stand in the log, s."""
        name = 'measurement_delay'
        if self._closed:
            return 0.0
        low = self.machine.bounds[name][0] if name in self.machine.bounds else 0.0
        return max(0.0, -min(low, self.fixed.get(name, 0.0)))

    @property
    def _ahead(self) -> float:
        # Its cycle is that of the log: an arm's controllers are faster, and hold hardly anything.
        return self._lead / self.cycle

    # ------------------------------------------------------------------ under its controllers

    @property
    def _closed(self) -> bool:
        return super()._closed and self.machine.known('position_gain')

    @property
    def _laws(self) -> npt.NDArray[np.int64]:
        return np.full(len(self.machine.drives), drive_kernel.PID, dtype=np.int64)

    def _constants(self) -> Array:
        base = super()._constants()
        if self._closed and not self.machine.known('coulomb_regularisation'):
            # Friction that holds at rest.
            rows.of(base[None], 'regularisation', len(self.machine.drives))[:] = 0.0
        return base

    def _set_points(self, order: Sequence[int]) -> Array:
        """Return (2 * D * K,) set-points of the motors, then their rates."""
        both = super()._set_points(order).reshape(2, len(order), -1)
        return np.ascontiguousarray(self.transmission.motors @ both).ravel()

    @functools.cached_property
    def _seen(self) -> Array:
        """(3, D, K) the joints' recorded motion; as wanted where none is."""
        drives = len(self.machine.drives)
        place = self._joints(self._command.reshape(2, drives, -1))[0]
        if self.data.position is not None:
            order = [self.data.names.index(name) for name in self.machine.drives]
            known = np.isfinite(self.data.position[order])
            there = known.sum(axis=1, keepdims=True) > _FEW
            place = np.where(there, self.data.position[order], place)
        cutoff = allowed_cutoff(place, self.cycle, CUTOFF)
        return np.array(smooth_motion(place, self.cycle, cutoff))

    @functools.cached_property
    def _begin(self) -> Array:
        """(2 * D,) where the motors start and how fast, by their first measured positions."""
        drives = len(self.machine.drives)
        begin = np.zeros((2, drives))
        begin[0] = self._joints(self._command.reshape(2, drives, -1))[0, :, 0]
        begin = first_seen(self.machine.drives, self.data, begin.ravel()).reshape(2, drives)
        return np.ascontiguousarray((self.transmission.motors @ begin[:, :, None]).ravel())

    def _joints(self, motors: Array) -> Array:
        """Return (..., D, K) what joints do by what their motors do."""
        return np.asarray(np.linalg.inv(self.transmission.motors) @ motors)

    @functools.cached_property
    def _added(self) -> Array:
        """(D * K,) effort that the controllers add by the description, of the motors."""
        how = self.machine.text('compensation')
        if how == 'none':
            return np.empty(0)
        drives = len(self.machine.drives)
        place, speed = self._joints(self._command.reshape(2, drives, -1))
        zero = np.zeros_like(place)
        if how == 'dynamics':
            asked = self.arm.efforts(place, speed, np.gradient(speed, self.cycle, axis=1))
        else:
            asked = self.arm.efforts(self._seen[0], zero, zero)
        gear = self.machine.numbers('gear_factor')[:, None]
        return np.ascontiguousarray(self.transmission.at_motors(asked) / gear).ravel()

    @property
    def replayed(self) -> Array:
        """(P, K) logged efforts that `replay_law` makes, also where positions are compared."""
        effort = chosen_outputs(self.machine.drives, self.drives, ('effort',), None)
        return np.asarray(effort.measured(self.data))

    def recorded_motion(self) -> RecordedMotion | None:
        """Return the motion that the controllers saw; None where a motor turns with two joints."""
        return None if self.transmission.coupled else super().recorded_motion()

    def regressed(self) -> tuple[dict[str, Array], Array]:
        """Return what the log alone says of gains and motors, see `law.by_regression`.

        Raises:
            IdentError: BAD_VALUES where a joint has fewer than four positions.
        """
        data, machine = self.data, self.machine
        assert data.position is not None
        order = [data.names.index(name) for name in machine.drives]
        gear = machine.numbers('gear_factor')
        cutoff = allowed_cutoff(data.position[order], self.cycle, CUTOFF)
        # A set-point holds for a cycle, in whose middle the law is at its mean.
        seen, middle = (
            np.array(smooth_motion(data.position[order], self.cycle, cutoff, ahead))
            for ahead in (0.0, 0.5)
        )
        asked = self.transmission.at_motors(self.arm.efforts(*middle)) / gear[:, None]
        effort = None
        if data.effort is not None:
            logged = data.effort[order]
            rows = [fill_gaps(x) if np.isfinite(x).any() else x for x in logged]
            effort = low_pass(np.stack(rows), self.cycle, cutoff)
        wanted = self._command.reshape(2, len(order), -1)[0]
        added = self._added.reshape(len(order), -1) if self._added.size else 0.0 * wanted
        wanted, asked, added = (low_pass(x, self.cycle, cutoff) for x in (wanted, asked, added))
        at = functools.partial(np.einsum, 'de,xek->xdk', self.transmission.motors)
        signals = Signals(self.cycle, at(seen), at(middle), wanted, asked, added, effort, gear)
        free = {p.name for p in self.parameters}
        known = {}
        for name in (*GAINS, *JOINT):
            stated = machine.numbers(name) if name in machine.constants else np.zeros(len(order))
            known[name] = np.array([
                math.nan if f'{drive}.{name}' in free else self.fixed.get(f'{drive}.{name}', x)
                for drive, x in zip(machine.drives, stated.tolist(), strict=True)
            ])  # fmt: skip
        return by_regression(signals, known)

    def suggested(self) -> Array | None:
        """Return (N,) parameters, see `FullModel.suggested`; None along a recorded motion."""
        if not self._closed or self.data.position is None:
            return None
        try:
            found, _ = self.regressed()
        except IdentError:  # a joint has hardly a position
            return None
        told = self.as_described({})
        theta = []
        for p in self.parameters:
            drive, _, name = p.name.rpartition('.')
            value = told.get(p.name, 0.5 * (p.low + p.high) if p.absent is None else p.absent)
            if name in found and drive in self.machine.drives:
                value = float(found[name][self.machine.drives.index(drive)])
            theta.append(min(max(value, p.low), p.high))
        return np.array(theta)

    @functools.cached_property
    def tree(self) -> Tree:
        """The links as the kernel has them, each behind the one that carries it."""
        arm, order = self.arm, np.argsort(self.arm.joints)
        back = np.argsort(order)
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

    @functools.cached_property
    def _turns(self) -> Array:
        """(D, 3, 3) the turns into the kernel's frames."""
        return self.arm.hangs[2]

    @functools.cached_property
    def _inertia(self) -> Array:
        """(D, D) mass matrix of the described links at the motors where the log begins."""
        drives = np.linalg.inv(self.transmission.motors)
        place = self._joints(self._begin.reshape(2, -1)[:, :, None])[0, :, 0]
        return np.asarray(drives.T @ self.arm.mass(place) @ drives)

    def effort_delay(self, theta: Array) -> Array:
        """Return (D,) how late each drive's effort is logged [s], for one candidate (N,)."""
        return super().effort_delay(theta) - self._lead

    def links_effort(self, change: Array) -> Array:
        """Return (D, K) what links ask that differ from the description by (D, 10) inertials."""
        position, velocity, acceleration = self.motion
        out: Array = self.arm.efforts(position, velocity, acceleration)
        if change.any():
            out = out + self.arm.terms(position, velocity, acceleration) @ change.ravel()
        return out

    @functools.cached_property
    def _firsts(self) -> npt.NDArray[np.int64]:
        """(D,) the first of a joint's terms that is not zero."""
        return np.asarray(np.argmax((self._terms != 0.0).any(axis=1), axis=1))

    @property
    def rigid(self) -> bool:
        """A joint and its rotor move as one."""
        return True

    @functools.cached_property
    def travels(self) -> tuple[str, ...]:
        """(D,) `m` where a joint slides, else `rad`."""
        return tuple('m' if slides else 'rad' for slides in self.arm.prismatic)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Compared outputs: quantity by quantity, drive by drive within."""
        turning, sliding = self.signals.described('N m', 'rad'), self.signals.described('N', 'm')
        return tuple(
            s if self.travels[place] == 'm' else t
            for place, s, t in zip(self.signals.sources, sliding, turning, strict=True)
        )

    @property
    def context(self) -> Context:
        """Properties for effects; behind a flexible joint all the other links would move."""
        return replace(super().context, lifted=True)

    @property
    def _boxed(self) -> Machine:
        own = {**self.machine.own_bounds, **self.inertials.rotors}
        return replace(self.machine, own_bounds=own)

    def _own(self) -> Mapping[str, Sequence[Parameter]]:
        return {**self.inertials.parameters, **self.transmission.parameters}

    def rows(self, theta: Array) -> Array:
        """Return (S, R + B) kernel rows of (S, N) candidates, what the links are behind.

        Coefficients of their terms, or their inertials where the arm runs freely.
        """
        block = self.candidates.rows(theta)
        self.candidates.of(block, 'log_delay')[:] += self._lead
        own, count = self.candidates.own_values(theta), len(block)
        balance = np.reshape(self.transmission.coefficients(own, count), (-1, count)).T
        if not self._closed:
            links = self.inertials.coefficients(own, count)
        else:
            each = self.inertials.whole(own, count).reshape(count, -1, INERTIALS)
            order = np.argsort(self.arm.joints)
            links = turned(each, self._turns)[:, order].reshape(count, -1)
        return np.concatenate([block, links, balance], axis=1)

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        """Return (S,) steps in a cycle, by the links' motion and what is stiff in each candidate.

        Runge-Kutta's own limits are 2.8, for what brakes and, in radians, for what swings; by hand
        a step is at most 1 and a fifth.
        """
        if not self._closed or self.substeps is not None:
            return np.full(len(block), self.substeps or 1, dtype=np.int64)
        of = functools.partial(self.candidates.of, block)
        whole = self._inertia + of('motor_mass')[:, :, None] * np.eye(len(self.machine.drives))
        with np.errstate(all='ignore'):  # of a candidate that is no number, or weighs nothing
            light = np.abs(np.diagonal(np.linalg.inv(whole), axis1=1, axis2=2))
            light = light * of('gear')
            width = of('regularisation')
            steep = np.where(width > 0.0, of('coulomb') / width, 0.0)
            braked = self.cycle * light * (of('viscous') + steep + of('velocity_gain'))
            sprung = of('position_gain') + self.candidates.contact(block) / of('gear')
            swung = self.cycle * np.sqrt(light * sprung) / 0.2
            need = np.maximum(np.maximum(braked, swung).max(axis=1), self.cycle / _STEP)
            counts = np.nan_to_num(np.clip(np.ceil(need), 1, 64), nan=1.0)
            return np.asarray(counts.astype(np.int64))

    @property
    def _kernel(self) -> Compiled:
        drives, effects = len(self.machine.drives), self.candidates
        if not self._closed:
            given = self._terms, self._firsts, self._driven, effects.on, self.cycle
            return kernel.simulate, kernel.sizes(drives), given
        motion = self._driven if self._motion.size else self._motion
        inputs = self._command, self._added, motion, self._begin, self._mode, effects.on
        free = *inputs, self._delayed, self.cycle, self.law, self.tree
        return kernel_free.simulate, kernel_free.sizes(drives), free

    @property
    def _delayed(self) -> bool:
        """Whether set-points are late."""
        known = self.machine.known('set_point_delay')
        return self.candidates.delayed or known
