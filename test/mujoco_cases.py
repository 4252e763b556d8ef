# SPDX-License-Identifier: Apache-2.0
"""Blind cases from MuJoCo: effects in its own forms, their sizes, and the bags.

Shared with the package's own blind check are the motions, the parameters' ranges, noise, jitter
and losses of a log, and how the size of an effect is measured. The machine and its effects are
MuJoCo's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

from mujoco_tripod import (
    Array,
    Course,
    Drive,
    K_MOTOR,
    nominal,
    R_WINDING,
    reported,
    Simulation,
    True3,
)
import numpy as np

from ros2_ident.checks.blind.label import MotionOrder
from ros2_ident.checks.blind.probe import Probe
from ros2_ident.models import Machine
from ros2_ident.recording import write_bag
from ros2_ident.reference.bag_making import draw_parameters, make_streams, nuisance_of
from ros2_ident.reference.motions import Motion
from ros2_ident.reference.plant import Log

FIT_SECONDS, CHECK_SECONDS = 8.0, 6.0
MOTIONS = ('multi_point', 'mixed', 'pick_and_place', 'multisine', 'reversals', 'dwell', 'chirp')
SIZES = (1.5, 8.0)
TRIES = 2  # simulations for a size; the true one is measured in any case
Rng = np.random.Generator
# (the machine, drive, size, what was drawn once for the case) -> the machine with the effect
Write = Callable[[True3, int, float, Sequence[float]], True3]


@dataclass(frozen=True)
class Kind:
    """One effect in MuJoCo's form.

    Attributes:
        name: What it is called on the page.
        effect: The catalogue's name of it; empty outside the catalogue and for a null.
        form: How MuJoCo makes it.
        write: Puts it into a machine.
        start: First size to try, in the unit of `unit`.
        least: Smallest size.
        most: Largest size.
        unit: Unit of the size.
        place: `drive` or `all`.
        power: How the size goes with what the effect leaves, roughly.
        substeps: Integration steps in a controller cycle.
        sort: As in the package's blind check: single, none, outside.
    """

    name: str
    effect: str
    form: str
    write: Write
    start: float = 0.0
    least: float = 0.0
    most: float = 0.0
    unit: str = ''
    place: str = 'drive'
    power: float = 1.0
    substeps: int = 10
    sort: str = 'single'


def _changed(true: True3, i: int, **what: Any) -> True3:
    drives = tuple(replace(d, **what) if n == i else d for n, d in enumerate(true.drives))
    return replace(true, drives=drives)


def _lugre(d: Drive, way: float, static: float, stribeck: float) -> dict[str, Any]:
    """Return a drive's friction as LuGre; way in rad, stribeck in rad/s."""
    stiffness = d.forward / way
    damping = 0.3 * math.sqrt(stiffness * d.inertia)
    numbers = f'{stiffness!r} {damping!r} {d.forward!r} {static!r} {stribeck!r}'
    return {'forward': 0.0, 'backward': 0.0, 'dcmotor': (f'lugre="{numbers}"',)}


def _stribeck(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    d = true.drives[i]
    speed = (0.015 + 0.045 * u[0]) * true.gear
    return _changed(true, i, **_lugre(d, 4e-5 * true.gear, d.forward + size, speed))


def _presliding(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    d = true.drives[i]
    return _changed(true, i, **_lugre(d, size * true.gear, d.forward, 0.05 * true.gear))


def _cogging(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    poles = (4, 6, 8, 12)[int(4 * u[0])]
    phase = 2.0 * math.pi * u[1]
    waves = (
        f'cogging="{size!r} {poles} {phase!r}"',
        f'cogging="{0.4 * size!r} {2 * poles} {1.7 * phase!r}"',
    )
    return _changed(true, i, dcmotor=waves)


def _saturation(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, limit=1.0 / size)


def _delay(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, delay=size)


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


def _backlash(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, gap=size)


def _payload(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    sign = 1.0 if u[1] < 0.7 else -1.0
    taken = 1.0 + 3.0 * u[0]
    return replace(true, whole=replace(true.whole, payload=sign * size, taken=taken))


def _gain(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return _changed(true, i, gain=1.0 + (size if u[0] < 0.5 else -size))


def _bias(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    bias = [0.0] * len(true.drives)
    bias[i] = size if u[0] < 0.5 else -size
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
    frame = (1.0 / size, 8.0 + 17.0 * u[0], 0.02 + 0.05 * u[1])
    return replace(true, whole=replace(true.whole, frame=frame))


def _hanging(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    whole = true.whole
    rest = whole.tool_mass - size
    hanging = (size, 0.03 + 0.07 * u[0])
    # The nominal load stays what it is: a part of the tool swings.
    return replace(true, whole=replace(whole, tool_mass=rest, hanging=hanging))


def _nothing(true: True3, i: int, size: float, u: Sequence[float]) -> True3:
    return true


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
             0.03, 0.002, 0.3, 'N m'),
        Kind('saturation', 'torque_saturation', '`forcerange`', _saturation,
             1.6, 0.5, 2.2, '1/N m', power=0.15),
        Kind('delay', 'current_loop_lag', 'dead time of the actuator', _delay,
             1.5e-3, 1e-4, 6e-3, 's'),
        Kind('inductance', 'current_loop_lag', '`dcmotor` with a winding', _inductance,
             1.5e-3, 2e-4, 8e-3, 's'),
        Kind('backlash', 'backlash', 'two joints, the second within limits', _backlash,
             2e-4, 1e-5, 2e-3, 'm', substeps=20),
        Kind('payload', 'payload_change', "the platform's mass changes", _payload,
             0.2, 0.01, 0.9, 'kg', 'all'),
        Kind('torque constant', 'torque_constant_error', "the actuator's gear", _gain,
             0.1, 0.01, 0.28, '1'),
        Kind('effort bias', 'effort_bias', 'added to the log', _bias, 0.03, 0.005, 0.4, 'N m'),
        Kind('cable spring', 'cable_spring', 'joint stiffness with a cubic term', _spring,
             30.0, 2.0, 400.0, 'N/m'),
        Kind('asymmetric friction', 'asymmetric_friction', 'two levels of dry friction',
             _asymmetric, 0.05, 0.005, 0.4, 'N m'),
        Kind('drag', 'quadratic_drag', 'damping with quadratic and cubic terms', _drag,
             0.15, 0.01, 2.0, 'N m s^2/m^2'),
        Kind('frame', 'frame_resonance', 'the frame is a body on a spring', _frame,
             0.03, 0.002, 0.2, '1/kg', 'all'),
        Kind('heating winding', '', '`dcmotor` thermal: torque falls as it warms', _thermal,
             3.0, 0.1, 60.0, 'K/W', sort='outside'),
        Kind('hanging load', '', 'a part of the tool swings on two hinges', _hanging,
             0.3, 0.02, 0.8, 'kg', 'all', sort='outside'),
        Kind('dry friction', '', '`frictionloss` with its own softness in place of the sign',
             _dry, sort='outside', place='all'),
        Kind('none', '', 'friction as the machine file states it', _nothing, sort='none'),
    )
}  # fmt: skip


class MujocoProbe(Probe):
    """Measures what an effect leaves; the logs are MuJoCo's. An `effect` is a whole machine."""

    substeps = 10

    def __init__(self, machine: Machine, parameters: Any, motions: Sequence[Motion]) -> None:
        super().__init__(machine, parameters, motions)
        self.true = nominal(machine, self.parameters)
        self.courses: dict[tuple[int, str], Course] = {}
        self._bases[0] = self._model(0).simulate(self.theta[None])[0]

    def course(self, which: int, true: True3) -> Course:
        """Return what a machine does on one of the motions; simulated once."""
        key = which, repr(true)
        if key not in self.courses:
            motion = self.motions[which]
            run = Simulation(self.machine, true, self.substeps).run
            self.courses[key] = run(motion.position, motion.velocity)
        return self.courses[key]

    def effort(self, which: int, effects: Sequence[Any]) -> Array:
        """Return (D, K) the logged effort before noise, on one of the motions."""
        true = effects[0] if effects else self.true
        cycle = self.machine.number('cycle')
        return reported(self.course(which, true), true, cycle)


@dataclass(frozen=True)
class Drawn:
    """One case.

    Attributes:
        kind: The effect.
        drive: Which drive it sits on.
        size: Its size, in the kind's unit.
        rho: What the nominal parameters cannot imitate, in units of the noise.
        parameters: The machine's.
        motions: Of the two recordings.
        probe: The logs behind it.
        true: The machine.
    """

    kind: Kind
    drive: int
    size: float
    rho: float
    parameters: dict[str, float]
    motions: tuple[MotionOrder, MotionOrder]
    probe: MujocoProbe
    true: True3

    @property
    def where(self) -> str:
        """The place as the catalogue calls it."""
        return 'all' if self.kind.place == 'all' else self.probe.machine.drives[self.drive]

    def label(self, case: int) -> dict[str, Any]:
        """Return what is to be kept from the diagnosis."""
        return {
            'case': case,
            'sort': self.kind.sort,
            'kind': self.kind.name,
            'effect': self.kind.effect,
            'where': self.where,
            'size': self.size,
            'rho': self.rho,
            'parameters': self.parameters,
            'motions': [m.kind for m in self.motions],
        }


def draw_case(
    machine: Machine,
    kind: Kind,
    target: float,
    rng: Rng,
    seconds: tuple[float, float] = (FIT_SECONDS, CHECK_SECONDS),
) -> Drawn:
    """Draw a case: parameters, motions, and the size at which the effect leaves `target`."""
    parameters = draw_parameters(machine, rng)
    first, second = (str(name) for name in rng.choice(MOTIONS, 2, replace=False))
    seeds = [int(x) for x in rng.integers(2**31, size=2)]
    motions = (
        MotionOrder(first, seconds[0], seeds[0]),
        MotionOrder(second, seconds[1], seeds[1]),
    )
    probe = MujocoProbe(machine, parameters, [m.draw(machine) for m in motions])
    probe.substeps = kind.substeps
    drive = int(rng.integers(len(machine.drives)))
    shape = [float(x) for x in rng.random(2)]
    size = kind.start
    for _ in range(TRIES if kind.start else 0):
        left = probe.linear([kind.write(probe.true, drive, size, shape)])
        ratio = min(10.0, max(0.1, target / max(left, 1e-3)))
        size = min(kind.most, max(kind.least, size * ratio**kind.power))
        if 0.5 < ratio < 2.0:
            break
    true = kind.write(probe.true, drive, size, shape)
    rho = probe.truth([true]).size
    return Drawn(kind, drive, size, rho, parameters, motions, probe, true)


def write_bags(drawn: Drawn, folder: Path, rng: Rng) -> None:
    """Write `fit` and `check` as a recorder would have; neither says what is in them."""
    nuisance = replace(
        nuisance_of(drawn.probe.machine),
        jitter=float(rng.uniform(5e-6, 4e-5)),
        drop=float(rng.uniform(5e-4, 3e-3)),
    )
    for which, name in enumerate(('fit', 'check')):
        course = drawn.probe.course(which, drawn.true)
        motion = drawn.probe.motions[which]
        effort = drawn.probe.effort(which, [drawn.true])
        streams = make_streams(_log(drawn.probe, course, effort), motion, nuisance, rng)
        write_bag(folder / name, streams)


def _log(probe: MujocoProbe, course: Course, effort: Array) -> Log:
    none = np.zeros((3, 0))
    return Log(
        names=probe.machine.drives,
        cycle=probe.machine.number('cycle'),
        effort=effort,
        position=course.position,
        velocity=course.velocity,
        torque=course.torque,
        carriage=none,
        platform=none,
        frame=none,
        carriage_velocity=none,
        platform_velocity=none,
        frame_velocity=none,
        steps=0,
        rod_error=float(np.abs(course.rods).max()),
    )
