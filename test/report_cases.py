# SPDX-License-Identifier: Apache-2.0
"""Result directories that the tests of the page share."""

from functools import cache
import math
from pathlib import Path

from gap_signals import floor_of, motion, residual
from identify_cases import axis, axis_data, identified, tripod
import numpy as np

from ros2_ident.gap.bootstrap import Interval
from ros2_ident.gap.result import Cause, Diagnosis, DriveGap, Facts, Ranked, Step, Trace, Value
from ros2_ident.gap.where.localise import localise
from ros2_ident.gates import Gate
from ros2_ident.identify.data import Data
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.result import Identification
from ros2_ident.models import EffectAt
from ros2_ident.report.diagnosis import write_diagnosis
from ros2_ident.report.files import write_result
from ros2_ident.report.signals import Curves, Signals

EFFECT = EffectAt('stribeck', 'drive_1')


@cache
def diagnosed() -> Diagnosis:
    """Return a diagnosis of two drives, the first with friction that the model lacks.

    The motion, the residual, and where it lies are computed; the verdict's numbers are made up.
    """
    of = motion(4.0)
    noise = residual(of)
    row = residual(of, 0.03 * np.tanh(of.velocity[0] / 0.003))
    known = {
        'torque': Value(0.08, 'N m', 0.07, 0.09),
        'speed': Value(0.03, 'm/s', math.nan, math.nan),
    }
    return Diagnosis(
        effect='stribeck',
        where=('drive_1',),
        probability=0.93,
        also=(),
        confusable=(),
        ranking=(
            Ranked(EFFECT, 0.93, 0.0101, 0.97, known),
            Ranked(EffectAt('backlash', 'drive_1'), 0.004, math.nan, 0.2, {}),
        ),
        unit='N m',
        steps=(
            Step('nominal', Interval(0.031, 0.029, 0.033)),
            Step('Stribeck friction on drive_1', Interval(0.0101, 0.0099, 0.0103)),
        ),
        floor=floor_of(),
        share_closed=Interval(0.97, 0.95, 0.98),
        held_out='blocks',
        evidence={
            'size': 2.9,
            'remaining': 0.1,
            'closed': 0.97,
            'material': 0.2,
            'unexplained': 0.5,
        },
        per_drive={
            'drive_1': DriveGap(0.031, 0.0101, 0.01, 0.97, 0.3, 0.097),
            'drive_2': DriveGap(0.0101, 0.01, 0.01, 0.1, 0.3, 0.0047),
        },
        localisation=tuple(f for f in localise(of, row, floor_of()) if not f.likely),
        parameters={
            'drive_1.coulomb_torque': Value(0.05, 'N m', 0.049, 0.051),
            'drive_1.stribeck.torque': known['torque'],
        },
        nominal={'drive_1.coulomb_torque': 0.08},
        moved={'drive_1.coulomb_torque': -0.375},
        gates=(Gate('missing', '', 'ok', 0.0, '1', 'effort: 4000 <samples>'),),
        not_testable=(EffectAt('rod_length_error', 'all'),),
        complete=True,
        seconds=12.0,
        seed=5,
        traces=(Trace(False, of, of.torque + row, of.torque + row - noise, np.isfinite(row)),),
        facts=Facts(Cause.EFFECT, 'drive_1', 'N m'),
    )


def write_identified(folder: Path, result: Identification | None = None) -> None:
    """Write an identification as a run does."""
    write_result(folder, result or identified(), problem_of(axis(), axis_data()))


def write_diagnosed(folder: Path, found: Diagnosis | None = None) -> None:
    """Write a diagnosis as a run does."""
    folder.mkdir(exist_ok=True)
    write_diagnosis(folder, found or diagnosed(), tripod(), Data((), source='bags/fit'))


def long_signals(samples: int = 100_000, drives: int = 3) -> Signals:
    """Return efforts of a long log with one spike that may not be lost."""
    generator = np.random.default_rng(0)
    time = np.arange(samples) * 1e-3
    clean = np.sin(time[None] * (1.0 + np.arange(drives)[:, None]))
    measured = clean + 0.02 * generator.standard_normal(clean.shape)
    measured[0, 618 * samples // 1000] = 4.0
    return Signals(
        'N m',
        tuple(f'drive_{d + 1}' for d in range(drives)),
        ('identified',),
        (
            Curves(
                '',
                time,
                measured.astype(np.float32),
                clean[None].astype(np.float32),
                (1e-4 * clean).astype(np.float32),
            ),
        ),
    )
