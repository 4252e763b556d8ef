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
from ros2_ident.models.protocol import EffectAt, RecordedMotion
from ros2_ident.models.serial import kernel, kernel_free
from ros2_ident.models.serial.arm import Arm, INERTIALS
from ros2_ident.models.serial.law import by_regression, GAINS, JOINT, Signals
from ros2_ident.models.serial.log import ArmLog
from ros2_ident.models.serial.parameters import hand_load, INERTIAL, Inertials, turned, UNITS
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, fill_gaps, low_pass, smooth_motion

# Longest step [s]: with 4 ms links alone are 7e-7 rad off on the arms of
# `checks/benchmarks/arm.py`, with friction 3e-6 rad.
_STEP = 0.005
# Rows of what hangs at the last joint.
_HAND = ('hand_mass', *(f'hand_moment_{axis}' for axis in 'xyz'))


class Serial(DriveModel):
    """An arm's joints; see `DriveModel`.

    Where the controllers' gains are known they follow the set-point: PID on position, and what the
    description says of gravity or dynamics added. Else the recorded motion drives the joints, and
    a set-point is not looked at.
    """

    gains = ('position_gain',)
    features = frozenset({'links'})

    reads = ArmLog
    log: ArmLog

    @property
    def arm(self) -> Arm:
        """The rigid bodies."""
        return self.log.arm

    @property
    def inertials(self) -> Inertials:
        """Unknown part of the links."""
        return self.log.inertials

    @property
    def described(self) -> tuple[str, ...]:
        """Names of the links' inertials, see `FullModel.described`."""
        return self.inertials.listed

    def as_described(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return the base parameters of the links as described, see `FullModel.as_described`."""
        return self.inertials.as_described(given)

    def bodies(self) -> Mapping[str, tuple[Mapping[str, str], tuple[str, ...], Array]]:
        """Return what a body at a link adds, see `FullModel.bodies`; the last has `hand_load`."""
        drives = self.machine.drives
        names = np.array([*self.inertials.inertias, *self.inertials.names])
        free, found = {p.name for p in self.parameters}, {}
        for drive, (own, by) in zip(drives[:-1], self.inertials.links, strict=False):
            there = by.any(axis=1)
            of = tuple(names[there].tolist())
            if own.size > 1 and free.issuperset(of):
                body = {f'load_{INERTIAL[n]}': UNITS[n] for n in own.tolist()}
                found[drive] = body, of, by[there]
        return found

    def decided(self, theta: Array, noise: Array) -> DriveModel:
        """Return the model itself: of an arm every instant counts."""
        return self

    # ------------------------------------------------------------------ under its controllers

    @functools.cached_property
    def law(self) -> npt.NDArray[np.int64]:
        """(D,) the controllers' laws."""
        return np.full(len(self.machine.drives), drive_kernel.PID, dtype=np.int64)

    def _constants(self) -> Array:
        base = super()._constants()
        if self.log.closed and not self.machine.known('coulomb_regularisation'):
            # Friction that holds at rest.
            rows.of(base[None], 'regularisation', len(self.machine.drives))[:] = 0.0
        return base

    @property
    def replayed(self) -> Array:
        """(P, K) logged efforts that `replay_law` makes, also where positions are compared."""
        return self.log.efforts

    def recorded_motion(self) -> RecordedMotion | None:
        """Return the motion that the controllers saw; None where a motor turns with two joints."""
        return None if self.log.transmission.coupled else super().recorded_motion()

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
        asked = self.log.transmission.at_motors(self.arm.efforts(*middle)) / gear[:, None]
        effort = None
        if data.effort is not None:
            logged = data.effort[order]
            rows = [fill_gaps(x) if np.isfinite(x).any() else x for x in logged]
            effort = low_pass(np.stack(rows), self.cycle, cutoff)
        wanted = self.log.command[0]
        added = self.log.added if self.log.added.size else 0.0 * wanted
        wanted, asked, added = (low_pass(x, self.cycle, cutoff) for x in (wanted, asked, added))
        at = functools.partial(np.einsum, 'de,xek->xdk', self.log.transmission.motors)
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
        if not self.log.closed or self.data.position is None:
            return None
        try:
            return self._begun(self.regressed()[0])
        except IdentError:  # a joint has hardly a position
            return None

    def effort_delay(self, theta: Array) -> Array:
        """Return (D,) how late each drive's effort is logged [s], for one candidate (N,)."""
        return super().effort_delay(theta) - self.log.lead

    def links_effort(self, change: Array) -> Array:
        """Return (D, K) what links ask that differ from the description by (D, 10) inertials."""
        out: Array = self.arm.efforts(*self.motion)
        return out + self.arm.terms(*self.motion) @ change.ravel() if change.any() else out

    @property
    def rigid(self) -> bool:
        """A joint and its rotor move as one."""
        return True

    @functools.cached_property
    def travels(self) -> tuple[str, ...]:
        """(D,) `m` where a joint slides, else `rad`."""
        return tuple('m' if slides else 'rad' for slides in self.arm.prismatic)

    @property
    def effort_units(self) -> tuple[str, ...]:
        """(D,) unit of the joints' efforts."""
        return tuple('N' if x == 'm' else 'N m' for x in self.travels)

    @property
    def context(self) -> Context:
        """Properties for effects; behind a flexible joint all the other links would move."""
        context, hand, none = super().context, frozenset(_HAND), frozenset[str]()
        return replace(
            context,
            lifted=True,
            identified=context.identified | (hand if self.inertials.carries else none),
            combined=hand if self.inertials.tell_hand else none,
        )

    def _sought(self) -> tuple[Machine, Mapping[str, Sequence[Parameter]]]:
        boxed = replace(
            self.machine, own_bounds={**self.machine.own_bounds, **self.inertials.rotors}
        )
        return boxed, {**self.inertials.parameters, **self.log.transmission.parameters}

    def rows(self, theta: Array) -> Array:
        """Return (S, R + B) kernel rows of (S, N) candidates, what the links are behind.

        Coefficients of their terms, or their inertials where the arm runs freely.
        """
        block = self.candidates.rows(theta)
        self.candidates.of(block, 'log_delay')[:] += self.log.lead
        own, count = self.candidates.own_values(theta), len(block)
        balance = np.reshape(self.log.transmission.coefficients(own, count), (-1, count)).T
        hand, zeros = self._hand(block), self.candidates.of(block, 'log_zero')
        if not self.log.closed:
            links = self.inertials.coefficients(own, hand)
            if self._homed:
                balance = np.hstack([balance, -zeros])
        else:
            zeros[:] = zeros @ self.log.transmission.motors.T
            each = self.inertials.whole(own, hand).reshape(count, -1, INERTIALS)
            order = np.argsort(self.arm.joints)
            links = turned(each, self.log.turns)[:, order].reshape(count, -1)
        return np.concatenate([block, links, balance], axis=1)

    def _hand(self, block: Array) -> Array:
        """Return (S, 10) inertials of what effects hang at the last joint; (S, 0) for nothing."""
        if not self.loads:
            return np.empty((len(block), 0))
        mass, *moment = (self.candidates.of(block, name) for name in _HAND)
        return hand_load(mass, np.array(moment))

    @property
    def loads(self) -> list[EffectAt]:
        """Effects that are inertials of the last link."""
        return self.candidates.acting(_HAND[0])

    @property
    def _homed(self) -> bool:
        """Whether effects move zeros of joints."""
        return bool(self.candidates.acting('log_zero'))

    def carried(self, theta: Array) -> Array:
        """Return (10,) inertials of payload and load at the last joint, of one candidate (N,)."""
        own, block = self.candidates.own_values(theta), self.candidates.rows(theta)
        found = self.inertials.coefficients(own, self._hand(block))[0]
        beside = found[len(self.inertials.names) : -1]
        return beside if beside.size else np.zeros(INERTIALS)

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        """Return (S,) steps in a cycle, by the links' motion and what is stiff in each candidate.

        Runge-Kutta's own limits are 2.8, for what brakes and, in radians, for what swings; by hand
        a step is at most 1 and a fifth.
        """
        if not self.log.closed or self.substeps is not None:
            return np.full(len(block), self.substeps or 1, dtype=np.int64)
        of = functools.partial(self.candidates.of, block)
        whole = self.log.inertia + of('motor_mass')[:, :, None] * np.eye(len(self.machine.drives))
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
        drives, effects, log = len(self.machine.drives), self.candidates, self.log
        if not self.log.closed:
            terms = log.terms(hand=bool(self.loads), zeros=self._homed)
            given = *terms, log.driven.ravel(), effects.on, self.cycle
            return kernel.simulate, kernel.sizes(drives), given
        read = log.command, log.added, log.driven, log.begin
        inputs = *(x.ravel() for x in read), log.mode, effects.on
        free = *inputs, effects.delayed, self.cycle, self.law, log.tree
        return kernel_free.simulate, kernel_free.sizes(drives), free
