# SPDX-License-Identifier: Apache-2.0
"""Blind cases from MuJoCo: effects in its own forms, drawn as the package's own blind check does.

Shared with that are machines, motions, noise, faults, the label, and how the size of an effect is
measured. The simulation and its effects are MuJoCo's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from checks.blind.draw import Drawer
from checks.blind.probe import Probe
from checks.blind.run import drawn_by
from checks.generators.mujoco_tripod import (
    Course,
    Drive,
    K_MOTOR,
    nominal,
    R_WINDING,
    reported,
    Simulation,
    True3,
)
from checks.reference.plant import Log
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import Machine
from ros2_ident.simulate.motions import Motion

# (the machine, drive, size, what was drawn once for the case) -> the machine with the effect
Write = Callable[[True3, int, float, Sequence[float]], True3]


@dataclass(frozen=True)
class Kind:
    """One effect in MuJoCo's form.

    Attributes:
        effect: The catalogue's name of it; empty outside the catalogue.
        law: How MuJoCo makes it.
        start: First size to try, in the unit of `unit`; 0 where it has none.
        place: `drive` or `all`.
        power: How the size goes with what the effect leaves, roughly.
        substeps: Integration steps in a controller cycle.
        beside: Whether it can stand beside any other on one drive, as an imperfection.
    """

    name: str
    effect: str
    law: str
    write: Write
    start: float = 0.0
    least: float = 0.0
    most: float = 0.0
    unit: str = ''
    place: str = 'drive'
    power: float = 1.0
    substeps: int = 6
    beside: bool = False

    @property
    def label(self) -> str:
        """What a case's label calls it."""
        return self.effect or self.name.replace(' ', '_')


@dataclass(frozen=True)
class Added:
    """A kind with its numbers, at a place.

    Attributes:
        where: Its name, or `all`.
        shape: Numbers from 0 to 1 that were drawn once for it.
    """

    form: Kind
    drive: int
    where: str
    value: float
    shape: tuple[float, ...]

    @property
    def effect(self) -> str:
        """See `Kind.label`."""
        return self.form.label

    @property
    def values(self) -> dict[str, float]:
        """Its numbers by name."""
        return {'size': self.value, **{f'shape_{n}': u for n, u in enumerate(self.shape)}}

    def apply(self, true: True3) -> True3:
        """Return a machine with it."""
        return self.form.write(true, self.drive, self.value, self.shape)


def _changed(true: True3, i: int, **what: Any) -> True3:
    drives = tuple(replace(d, **what) if n == i else d for n, d in enumerate(true.drives))
    return replace(true, drives=drives)


def _lugre(d: Drive, way: float, static: float, stribeck: float) -> dict[str, Any]:
    """Return a drive's friction as LuGre; way in rad, stribeck in rad/s."""
    stiffness = d.forward / way
    damping = 0.3 * math.sqrt(stiffness * d.inertia)
    numbers = f'{stiffness!r} {damping!r} {d.forward!r} {static!r} {stribeck!r}'
    more = (*d.dcmotor, f'lugre="{numbers}"')
    return {'forward': 0.0, 'backward': 0.0, 'dcmotor': more}


def _stribeck(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    d = true.drives[i]
    speed = (0.015 + 0.045 * u[0]) * true.gear
    return _changed(true, i, **_lugre(d, 4e-5 * true.gear, d.forward + size, speed))


def _presliding(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    d = true.drives[i]
    return _changed(true, i, **_lugre(d, size * true.gear, d.forward, 0.05 * true.gear))


def _cogging(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    poles = (9, 11, 13, 15)[int(4 * u[0])]  # orders from which no search starts
    phase = 2.0 * math.pi * u[1]
    waves = (
        f'cogging="{size!r} {poles} {phase!r}"',
        f'cogging="{0.4 * size!r} {2 * poles} {1.7 * phase!r}"',
    )
    return _changed(true, i, dcmotor=(*true.drives[i].dcmotor, *waves))


def _sets(name: str, of: Callable[[float], float] = float) -> Write:
    """Return a `write` of one number of a drive, by the size."""
    return lambda true, i, size, u: _changed(true, i, **{name: of(size)})


def _winding(inductance: float, thermal: str = '') -> str:
    return (
        f'motorconst="{K_MOTOR!r} {K_MOTOR!r}" resistance="{R_WINDING!r}" '
        f'inductance="0 {inductance!r}" {thermal}'
    )


def _inductance(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, winding=_winding(size), inductive=True)


def _thermal(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    heat = f'thermal="{size!r} 0 {2.0 + 4.0 * u[0]!r} 0.0039 25 25"'
    return _changed(true, i, winding=_winding(0.0, heat))


def _payload(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    sign = 1.0 if u[1] < 0.7 else -1.0
    taken = 0.6 + u[0]
    # Held and left alone in turns of uneven length, twice.
    turns = (taken, taken + 1.3 + 0.8 * u[1], taken + 2.9 + 0.9 * u[2], taken + 5.4 + u[2])
    return replace(true, whole=replace(true.whole, payload=sign * size, turns=turns))


def _gain(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, gain=1.0 + (size if u[0] < 0.5 else -size))


def _bias(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    bias = list(true.bias)
    bias[i] += size if u[0] < 0.5 else -size
    return replace(true, bias=tuple(bias))


def _spring(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, spring=(size, 20.0 * size), rest=0.45 + 0.15 * u[0])


def _asymmetric(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    d = true.drives[i]
    part = 0.5 * size if u[0] < 0.5 else -0.5 * size
    return _changed(true, i, forward=d.forward + part, backward=d.backward - part)


def _drag(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, drag=(size / true.gear**2, 0.3 * size / true.gear**3))


def _frame(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    # Between the frequencies from which a search starts.
    gaps = ((6.4, 8.6), (9.5, 12.4), (13.7, 17.2), (18.9, 23.9))
    low, high = gaps[int(4 * u[0])]
    frame = (1.0 / size, low + (high - low) * u[2], 0.02 + 0.05 * u[1])
    return replace(true, whole=replace(true.whole, frame=frame))


def _hanging(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    whole = true.whole
    rest = whole.tool_mass - size
    hanging = (size, 0.03 + 0.07 * u[0])
    # The nominal load stays what it is: a part of the tool swings.
    return replace(true, whole=replace(whole, tool_mass=rest, hanging=hanging))


def _dry(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return replace(true, drives=tuple(replace(d, dry=True) for d in true.drives))


KINDS = {
    kind.name: kind
    for kind in (
        Kind('LuGre, Stribeck', 'stribeck', '`dcmotor` LuGre, static above Coulomb', _stribeck,
             0.04, 0.003, 0.3, 'N m'),
        Kind('LuGre, presliding', 'presliding', '`dcmotor` LuGre, static as Coulomb', _presliding,
             3e-4, 4e-5, 2e-3, 'm'),
        Kind('cogging', 'torque_ripple', 'two `dcmotor` cogging terms, second at 40 %', _cogging,
             0.03, 1e-4, 0.3, 'N m', beside=True),
        Kind('saturation', 'torque_saturation', '`forcerange`', _sets('limit', lambda x: 1.0 / x),
             1.6, 0.5, 2.2, '1/N m', power=0.15),
        Kind('delay', 'current_loop_lag', 'dead time of the actuator', _sets('delay'),
             1.5e-3, 1e-4, 6e-3, 's'),
        Kind('inductance', 'current_loop_lag', '`dcmotor` with a winding', _inductance,
             1.5e-3, 2e-4, 8e-3, 's'),
        Kind('backlash', 'backlash', 'two joints, the second within limits', _sets('gap'),
             2e-4, 1e-5, 2e-3, 'm', substeps=12),
        Kind('payload', 'payload_change', "the platform's mass changes", _payload,
             0.2, 0.01, 0.9, 'kg', 'all'),
        Kind('torque constant', 'torque_constant_error', "the actuator's gear", _gain,
             0.1, 0.01, 0.28, '1'),
        Kind('effort bias', 'effort_bias', 'added to the log', _bias, 0.03, 1e-4, 0.4, 'N m',
             beside=True),
        Kind('cable spring', 'cable_spring', 'joint stiffness with a cubic term', _spring,
             30.0, 2.0, 400.0, 'N/m'),
        Kind('asymmetric friction', 'asymmetric_friction', 'two levels of dry friction',
             _asymmetric, 0.05, 2e-4, 0.4, 'N m', beside=True),
        Kind('drag', 'quadratic_drag', 'damping with quadratic and cubic terms', _drag,
             0.15, 1e-3, 2.0, 'N m s^2/m^2', beside=True),
        Kind('frame', 'frame_resonance', 'the frame is a body on a spring', _frame,
             0.03, 0.002, 0.2, '1/kg', 'all'),
        Kind('heating winding', '', '`dcmotor` thermal: torque falls as it warms', _thermal,
             3.0, 0.1, 60.0, 'K/W'),
        Kind('hanging load', '', 'a part of the tool swings on two hinges', _hanging,
             0.3, 0.02, 0.8, 'kg', 'all'),
        Kind('dry friction', '', '`frictionloss` with its own softness in place of the sign',
             _dry, place='all'),
    )
}  # fmt: skip


class MujocoProbe(Probe):
    """Measures what effects leave; the logs are MuJoCo's."""

    def __init__(
        self, machine: Machine, parameters: Any, motions: Sequence[Motion], noise: float
    ) -> None:
        super().__init__(machine, parameters, motions, noise)
        self.true = nominal(machine, self.parameters)

    def with_effects(self, effects: Sequence[Added]) -> tuple[True3, int]:
        """Return the machine with effects, and the integration steps in a cycle it needs."""
        true, substeps = self.true, 6
        for added in effects:
            true, substeps = added.apply(true), max(substeps, added.form.substeps)
        # The same step whatever the controllers' cycle.
        return true, round(substeps * self.machine.number('cycle') / 5e-4)

    def course(self, motion: Motion, effects: Sequence[Added] = ()) -> tuple[Course, True3]:
        """Return what the machine does, and the machine.

        Raises:
            IdentError: DIVERGED where MuJoCo lost it.
        """
        true, substeps = self.with_effects(effects)
        try:
            run = Simulation(self.machine, true, substeps).run
            return run(motion.position, motion.velocity), true
        except ArithmeticError as exc:
            raise IdentError(ErrorCode.DIVERGED, str(exc)) from None

    def _simulate(self, motion: Motion, effects: Sequence[Any]) -> Log:
        course, true = self.course(motion, effects)
        cycle = self.machine.number('cycle')
        return Log(
            self.machine.drives,
            cycle,
            reported(course, true, cycle),
            course.position,
            course.velocity,
            course.torque,
            rod_error=float(np.abs(course.rods).max()),
        )


class MujocoDrawer(Drawer):
    """Draws one case from MuJoCo."""

    generator = 'mujoco'
    pi_only = True
    probing = MujocoProbe

    @staticmethod
    def known(machine: Machine) -> dict[str, list[str]]:
        """Return the names of the kinds, by what a label calls them."""
        out: dict[str, list[str]] = {}
        for kind in KINDS.values():
            out.setdefault(kind.label, []).append(kind.name)
        return out

    def maker(self, effect: str, taken: Sequence[str] = ()) -> Callable[[float], Any]:
        """Return what gives an effect, at a place and of a form drawn now, a size."""
        kind = KINDS[str(self.rng.choice(self.forms()[effect]))]
        # Two of MuJoCo's elements on one drive would replace each other.
        free = [d for d in self.machine.drives if d not in taken]
        return self._at(kind.name, str(self.rng.choice(free)))

    def _at(self, form: str, where: str) -> Callable[[float], Any]:
        kind = KINDS[form]
        drive = self.machine.drives.index(where) if where in self.machine.drives else 0
        place = 'all' if kind.place == 'all' else where
        shape = tuple(float(u) for u in self.rng.random(3))

        def make(size: float) -> Added:
            value = kind.start * 10.0 ** (size - 0.5)
            return Added(kind, drive, place, min(kind.most, max(kind.least, value)), shape)

        return make

    def decades(self, hidden: Any) -> float:
        """Return how many powers of e lie between sizes 0 and 1 of an effect."""
        return math.log(10.0) / hidden.form.power

    def _imperfect_seeds(self, names: Sequence[str]) -> list[tuple[Callable[[float], Any], float]]:
        """Return a maker for each drive, of effects that can stand beside any other."""
        kinds = [k.name for k in KINDS.values() if k.beside and k.label in names]
        drawn = [str(self.rng.choice(kinds)) for _ in self.machine.drives]
        sizes = self.rng.uniform(-0.9, -0.3, len(drawn))
        both = zip(drawn, self.machine.drives, sizes, strict=True)
        return [(self._at(kind, drive), float(size)) for kind, drive, size in both]

    def small_names(self, without: Sequence[str]) -> list[str]:
        """Return the effects that may be small in any drive."""
        return [k.label for k in KINDS.values() if k.beside and k.label not in without]

    def _logger(self) -> list[Any]:
        return []  # here the logger's mean is of the noise alone

    def _left(self, effects: Sequence[Any]) -> float:
        # One simulation instead of two and a fit: imperfections are small, so it is linear.
        return self.probe.linear(effects)


GENERATOR = drawn_by(MujocoDrawer)
