# SPDX-License-Identifier: Apache-2.0
"""Gates before any physics: is the log whole, is the effort a torque, is the law the stated one?

A wrong sign, a late clock, a controller gain that is not the machine file's, or a simulation step
that is too long all look like physics to a fit. They are looked for first, and directly.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ros2_ident.effects import shown_by
from ros2_ident.errors import IdentError
from ros2_ident.gap.floor import Floor
from ros2_ident.gap.law import fit_law, Law
from ros2_ident.models import FullModel, Machine
from ros2_ident.recording import Dataset, smooth_motion
from ros2_ident.recording.motion import best_lag, fill_gaps
from ros2_ident.recording.plausibility import lost_sign, unsigned

Array = NDArray[np.float64]
Level = Literal['ok', 'warn', 'fail']

# Shares of samples missing from which on a log is suspect, and of no use.
MISSING, TOO_MANY_MISSING = 0.02, 0.2
# A gain has to be off by this share, and leave this share of the law's misfit, to be spoken of.
GAIN_OFF, EXCESS = 0.02, 0.3
# The free law may leave so much more than the noise floor.
NOISY = 1.2
# A law that explains less of the effort is not the law that ran.
EXPLAINED = 0.9
# The simulation's own error, as a share of the noise floor.
STEP_ERROR = 0.1
# Motion faster than this is left out of the check of the sign, Hz.
_SLOW = 15.0

_WORDS = {
    'position_gain': 'position gain',
    'velocity_gain': 'velocity gain',
    'integral_gain': 'integral gain',
    'scale': 'scale of the effort',
}


@dataclass(frozen=True)
class Gate:
    """What one check says.

    Attributes:
        gate: `missing`, `jitter`, `sign`, `limit`, `law`, `law_noise`, `step`, or the id of the
            effect that a late set-point shows.
        drive: The drive, empty for the log as a whole.
        level: `ok`, `warn` (the verdict may suffer) or `fail` (no verdict should be trusted).
        number: What was measured.
        unit: Its unit.
        sentence: In words, with the remedy where there is one.
    """

    gate: str
    drive: str
    level: Level
    number: float
    unit: str
    sentence: str


@dataclass(frozen=True)
class GateReport:
    """All checks, worst first.

    Attributes:
        gates: The findings.
        laws: The controller law of each drive where it could be read from the log.
    """

    gates: tuple[Gate, ...]
    laws: tuple[Law, ...]

    @property
    def level(self) -> Level:
        """The worst level found."""
        return self.gates[0].level if self.gates else 'ok'

    def of(self, gate: str) -> tuple[Gate, ...]:
        """Return the findings of one check."""
        return tuple(g for g in self.gates if g.gate == gate)


def run_gates(
    model: FullModel, theta: Array | None = None, floor: Floor | None = None
) -> GateReport:
    """Run all gates on a model's recording.

    Args:
        model: The model with its data.
        theta: (N,) a candidate for the check of the integration step; left out where None.
        floor: The noise floor the step's error is compared with; the machine file's noise if None.

    Returns:
        The findings, worst first.
    """
    found = check_streams(model.data)
    laws = []
    # Sign, limit and law are those of an effort; a log need not hold one where it is not compared.
    compared = model.machine is not None and model.outputs[0].quantity == 'effort'
    for number, drive in enumerate(model.places if compared else ()):
        assert model.machine is not None
        found += check_effort(model.machine, model.data, drive)
        law = fit_law(model.machine, model.data, drive)
        if law is not None:
            laws.append(law)
        noise = None if floor is None else float(floor.per_drive[number])
        found += check_law(law, drive, model.unit, noise)
    if theta is not None:
        found += check_step(model, theta, floor)
    order = {'fail': 0, 'warn': 1, 'ok': 2}
    return GateReport(tuple(sorted(found, key=lambda g: order[g.level])), tuple(laws))


def check_streams(data: Dataset) -> list[Gate]:
    """Judge missing samples and the jitter of the stamps of every stream."""
    found = []
    for stream in data.quality.streams:
        share = stream.missing_share
        level: Level = 'fail' if share > TOO_MANY_MISSING else 'warn' if share > MISSING else 'ok'
        text = f'{stream.role}: {stream.samples} samples at {stream.rate:.6g} Hz'
        if level == 'ok':
            text += f', {stream.missing} missing' if stream.missing else ', none missing'
        else:
            text += (
                f', {100.0 * share:.2g} % are missing; record on the machine itself, or with a '
                'larger cache'
            )
        found.append(Gate('missing', '', level, share, '1', text))
        period = 1.0 / stream.rate if stream.rate else math.inf
        loose = stream.jitter > 0.15 * period
        text = f'{stream.role}: stamps scatter by {1e3 * stream.jitter:.2g} ms about the grid'
        if loose:
            text += '; a delay below that cannot be told, stamp where the sample is taken'
        found.append(
            Gate('jitter', '', 'warn' if loose else 'ok', stream.jitter, 's', text)
        )
    return found


def check_effort(machine: Machine, data: Dataset, drive: str) -> list[Gate]:
    """Judge whether a drive's effort has the sign and the size of a torque that moves it.

    The slow part of the effort is put down to acceleration, friction in both directions, position
    and a constant, at the lag that suits best. Inertia and friction have to come out positive.
    """
    d = data.names.index(drive)
    if data.effort is None or data.position is None:
        return []
    found = []
    limit = machine.number('torque_limit', drive)
    top = float(np.nanmax(np.abs(data.effort[d])))
    if math.isfinite(limit):
        bad = top > 1.2 * limit
        text = f'{drive}: the effort reaches {top:.4g}, the limit is {limit:.4g}'
        if bad:
            text += '; state the unit it is logged in as effort_unit in the machine file'
        found.append(Gate('limit', drive, 'fail' if bad else 'ok', top / limit, '1', text))
    stride = max(1, round(1.0 / (250.0 * data.cycle)))
    try:
        motion = smooth_motion(data.position[d : d + 1], data.cycle, _SLOW)
    except IdentError:
        return found
    position, velocity, acceleration = (row[0, ::stride] for row in motion)
    if lost_sign(fill_gaps(data.effort[d]), velocity):
        return [*found, Gate('sign', drive, 'fail', math.nan, '1', unsigned(drive))]
    still = 0.02 * float(np.abs(velocity).max())
    if still <= 0.0:
        return found
    columns = np.stack(
        [acceleration, np.tanh(velocity / still), velocity, position, np.ones_like(position)],
        axis=1,
    )
    effort = fill_gaps(data.effort[d])[::stride]
    lag, solution, share = best_lag(columns, effort, stride * data.cycle, 0.0)
    # What is small beside the rest of the effort has no sign that could be trusted.
    small = 0.1 * float(effort.std())
    weight = float(np.std(solution[0] * acceleration))
    sound = solution[0] > 0.0 or weight < small
    friction = columns[:, 1:3] @ solution[1:3]
    loses = float(np.mean(velocity * friction)) >= 0.0 or float(np.std(friction)) < 3.0 * small
    text = (
        f'{drive}: inertia and friction explain {100.0 * share:.0f} % of the effort, '
        f'{1e3 * lag:.0f} ms late'
    )
    level: Level = 'ok'
    if not sound or not loses:
        level = 'fail' if not sound and (weight > 3.0 * small or not loses) else 'warn'
        what = 'inertia' if not sound else 'friction'
        text += f', but {what} comes out negative; check the sign of effort and position'
    found.append(Gate('sign', drive, level, float(solution[0]), 'effort s^2/m', text))
    return found


def check_law(
    law: Law | None, drive: str, unit: str = 'N m', noise: float | None = None
) -> list[Gate]:
    """Judge a drive's controller law as its log shows it.

    Args:
        law: What `fit_law` returned.
        drive: The drive.
        unit: Unit of the effort.
        noise: The drive's noise floor, where known.
    """
    if law is None:
        text = f'{drive}: the controller law cannot be checked, that takes command and position'
        return [Gate('law', drive, 'warn', math.nan, '1', text)]
    found = []
    late = shown_by('late_set_point')
    if law.command_delay > 0.0 and late is not None:
        text = (
            f'{drive}: the controller takes up its set-point {1e3 * law.command_delay:.2f} ms '
            f'late; a {late.title} belongs into the model'
        )
        found.append(Gate(late.id, drive, 'warn', law.command_delay, 's', text))
    if law.explained < EXPLAINED:
        text = (
            f'{drive}: the stated control law explains {100.0 * law.explained:.0f} % of the '
            'logged effort, whatever its gains; check that effort, command and position belong '
            'together'
        )
        return [*found, Gate('law', drive, 'fail', law.explained, '1', text)]
    if noise is not None and law.misfit > NOISY * math.hypot(noise, law.steps):
        text = (
            f'{drive}: the control law leaves {law.misfit:.3g} {unit} of the logged effort where '
            f'the noise is {noise:.3g}, whatever its gains; something sits between controller and '
            'log: a filter, cross-talk, drift, a limit, or a reading of the position'
        )
        found.append(Gate('law_noise', drive, 'warn', law.misfit / noise, '1', text))
    if not law.gains:
        text = f'{drive}: the gains are to be found, so the log cannot contradict them'
        return [*found, Gate('law', drive, 'ok', law.explained, '1', text)]
    best = law.gains[0]
    if law.excess <= EXCESS * law.misfit or abs(best.ratio - 1.0) <= GAIN_OFF:
        text = (
            f'{drive}: the log follows the stated control law, {law.misfit_file:.3g} {unit} '
            'are left'
        )
        if noise is not None and law.misfit > NOISY * noise and law.steps > noise:
            text += f', no more than the steps of the logged position make ({law.steps:.3g})'
        return [*found, Gate('law', drive, 'ok', best.ratio, '1', text)]
    alone = best.misfit**2 - law.misfit**2 < (EXCESS * law.misfit) ** 2
    text = (
        f'{drive}: with the gains of the machine file the control law misses the logged effort by '
        f'{law.misfit_file:.3g} {unit}, with '
    )
    if alone:
        text += (
            f'a {_WORDS[best.name]} of {best.value:.4g} for {best.expected:.4g} '
            f'({100.0 * (best.ratio - 1.0):+.1f} %) by {best.misfit:.3g}'
        )
    else:
        text += f'its gains free by {law.misfit:.3g}; no single gain is to blame'
    text += '; correct the machine file, or look whether the drive runs other gains'
    return [*found, Gate('law', drive, 'warn', best.ratio if alone else math.nan, '1', text)]


def check_step(model: FullModel, theta: Array, floor: Floor | None = None) -> list[Gate]:
    """Compare the simulation with one of half the step: its error has to drown in the noise.

    Args:
        model: The model.
        theta: (N,) a candidate.
        floor: The noise floor; the machine file's noise where None.
    """
    row = np.atleast_2d(np.asarray(theta, dtype=float))
    finer = model.finer(row[0])
    if finer is None:
        return []
    error = np.sqrt(np.mean((model.simulate(row)[0] - finer.simulate(row)[0]) ** 2, axis=1))
    noise: Sequence[float] | Array = (
        [model.noise] * len(error) if floor is None else floor.per_drive
    )
    found = []
    what = model.outputs[0].quantity
    for drive, off, under in zip(model.places, error, noise, strict=True):
        share = float(off / under) if under > 0.0 else math.inf
        level: Level = 'ok' if share <= STEP_ERROR else 'warn' if share <= 0.5 else 'fail'
        text = f'{drive}: half the integration step changes the {what} by {share:.2g} of the noise'
        if level != 'ok':
            text += '; the step is too long to tell physics from numerics, raise substeps'
        found.append(Gate('step', drive, level, share, '1', text))
    return found
