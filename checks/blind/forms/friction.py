# SPDX-License-Identifier: Apache-2.0
"""Forms of friction.

v motor speed at the rail, z its position, M_C and M_V nominal friction, F gear force.
"""

import numpy as np

from checks.blind.forms import columns as at
from checks.blind.forms import friction_law as law
from checks.blind.forms.form import Form, Range, setter, Values, Write
from checks.reference import layout as nominal
from checks.reference.plant import Plant

PHASE = Range('phase', 'rad', 0.0, 2.0 * np.pi)
_WAY = Range('way', 'm', 2.3e-5, 4.6e-4, geometric=True, counterpart='way')
_STRIBECK = (
    Range('torque', 'N m', 0.01, 0.15),
    Range('speed', 'm/s', 0.0115, 0.066, geometric=True, counterpart='velocity'),
)
_THINNING = (
    Range('torque', 'N m', 0.012, 0.18),
    Range('speed', 'm/s', 0.045, 0.24, geometric=True, counterpart='velocity'),
)


def bristles(kind: float) -> Write:
    """Return a `write` of a presliding law."""

    def write(plant: Plant, i: int, values: Values, seed: int) -> None:
        plant.drive[i, at.BRISTLE_KIND] = kind
        plant.drive[i, at.BRISTLE_LENGTH] = values['way']
        plant.drive[i, at.BRISTLE_SHAPE] = values.get('shape', 1.0)
        plant.drive[i, at.BRISTLE_TIME] = values.get('time', 0.0)

    return write


def _presliding(name: str, law: str, source: str, number: Range, kind: float) -> Form:
    write = bristles(kind)
    return Form(name, 'presliding', law, source, _WAY, (number,), write, fades=False)


def oil(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write an oil that thins as friction heats it; the scale of the power is the drive's."""
    d = plant.drive[i]
    rated = d[nominal.TORQUE_LIMIT] * d[nominal.GEAR] * 1e-3
    columns = {at.OIL_SHARE: 'share', at.OIL_TIME: 'time'}
    for column, name in columns.items():
        d[column] = values[name]
    d[at.OIL_POWER] = values['power'] * (rated if np.isfinite(rated) else 1.0)


FORMS = (
    Form(
        'coulomb.algebraic',
        'coulomb_friction',
        'torque v / sqrt(v^2 + width^2)',
        'Specker, Buchner, Threlfall and others 2014, regularised friction, eq. 6',
        Range('torque', 'N m', 0.008, 0.12),
        (Range('width', 'm/s', 1.5e-3, 7e-3),),
        setter(torque=at.DRY_EXTRA, width=at.DRY_EXTRA_WIDTH),
    ),
    Form(
        'viscous.power',
        'viscous_friction',
        'slope |v|^n sgn v',
        'Armstrong-Helouvry 1991, Control of Machines with Friction, ch. 2: lubricants thin',
        Range('slope', 'N m s/m', 0.02, 0.25),
        (Range('exponent', '1', 0.75, 0.93),),
        setter(slope=at.VISCOUS_EXTRA, exponent=at.VISCOUS_EXPONENT),
    ),
    Form(
        'stribeck.exponential',
        'stribeck',
        'torque exp(-|v / speed|^n) sgn v',
        'Tustin 1947 (n = 1); Bo and Pavelescu 1982, n from 1/2 to 1',
        _STRIBECK[0],
        (_STRIBECK[1], Range('exponent', '1', 0.55, 1.25)),
        setter(torque=at.STRIBECK_TORQUE, speed=at.STRIBECK_SPEED, exponent=at.STRIBECK_EXPONENT),
    ),
    Form(
        'stribeck.rational',
        'stribeck',
        'torque / (1 + |v| / speed) sgn v',
        'Popp and Stelter 1990, Phil. Trans. R. Soc. A 332, eq. 2',
        *(_STRIBECK[0], (_STRIBECK[1],)),
        setter(torque=at.STRIBECK_TORQUE, speed=at.STRIBECK_SPEED),
    ),
    Form(
        'load.power',
        'load_dependent_friction',
        'share |F / gear|^n sgn v',
        'Palmgren 1959, Ball and Roller Bearing Engineering: n = 1 + y, y from 0.33 to 0.55',
        Range('share', '1', 0.01, 0.15),
        (Range('exponent', '1', 1.15, 1.5),),
        setter(share=at.LOAD_SHARE_TORQUE, exponent=at.LOAD_EXPONENT),
        needs='gear',
    ),
    Form(
        'asymmetry.power',
        'asymmetric_friction',
        'share (M_C + M_V |v|^n) v^2 / (v^2 + width^2)',
        'Armstrong-Helouvry 1991, ch. 4: by direction; growth as Waiboer, Aarts, Jonker 2005',
        Range('share', '1', 0.04, 0.7, signed=True),
        (Range('exponent', '1', 0.55, 0.9), Range('width', 'm/s', 1.2e-3, 9e-3)),
        setter(share=at.ASYMMETRY, exponent=at.ASYMMETRY_EXPONENT, width=at.ASYMMETRY_WIDTH),
    ),
    _presliding(
        'presliding.dahl',
        "M_C a, a' = v / way |1 - a sgn v|^n sgn(1 - a sgn v)",
        'Dahl 1976, AIAA J. 14(12), eq. 4, with his exponent',
        Range('shape', '1', 1.12, 1.8),  # below 1 it is no longer smooth
        law.DAHL,
    ),
    _presliding(
        'presliding.elasto_plastic',
        "M_C a, a' = v / way (1 - alpha(a) |a|), alpha = 0 up to break-away",
        'Dupont, Hayward, Armstrong, Altpeter 2002, IEEE TAC 47(5), eqs. 3 and 16',
        Range('shape', '1', 0.25, 0.8),
        law.ELASTO_PLASTIC,
    ),
    _presliding(
        'presliding.elements',
        'M_C mean(a_j), four elements of ways spread by a factor each',
        'Iwan 1966, J. Appl. Mech. 33(4); Lampaert, Al-Bender, Swevers 2003; Wen 1976 for each',
        Range('shape', '1', 1.4, 2.6),
        law.ELEMENTS,
    ),
    _presliding(
        'presliding.lugre',
        "M_C (a + time a'), a' = (v - |v| a) / way",
        'Canudas de Wit, Olsson, Astrom, Lischinsky 1995, IEEE TAC 40(3), eqs. 1-3, F_S = F_C',
        Range('time', 's', 3e-4, 2e-3),
        law.LUGRE,
    ),
    Form(
        'drag.churning',
        'quadratic_drag',
        'slope |v|^n sgn v',
        'Changenet and Velex 2007, J. Mech. Des. 129(2): churning losses, n below 2',
        Range('slope', 'N m s^2/m^2', 0.02, 0.3),
        (Range('exponent', '1', 1.6, 1.88),),
        setter(slope=at.DRAG, exponent=at.DRAG_EXPONENT),
    ),
    Form(
        'drag.turbulent',
        'quadratic_drag',
        'slope |v|^n sgn v',
        'Blasius 1913 and Wilcock 1950: seals and films at higher Reynolds numbers, n above 2',
        Range('slope', 'N m s^2/m^2', 0.02, 0.3),
        (Range('exponent', '1', 2.12, 2.45),),
        setter(slope=at.DRAG, exponent=at.DRAG_EXPONENT),
    ),
    Form(
        'thinning.rational',
        'degressive_friction',
        'torque |v| / (speed + |v|) sgn v',
        'Bittencourt, Wernholt, Sander-Tavallaey, Brogardh 2010 (levelling off); Michaelis form',
        *(_THINNING[0], (_THINNING[1],)),
        setter(torque=at.THINNING_TORQUE, speed=at.THINNING_SPEED),
    ),
    Form(
        'thinning.power',
        'degressive_friction',
        'torque / 2 |v / speed|^n sgn v',
        'Waiboer, Aarts, Jonker 2005, Multibody Dynamics, eq. 11: film friction, n well below 1',
        _THINNING[0],
        (_THINNING[1], Range('exponent', '1', 0.18, 0.5)),
        setter(torque=at.THINNING_TORQUE, speed=at.THINNING_SPEED, exponent=at.THINNING_EXPONENT),
    ),
    Form(
        'drift.two_times',
        'friction_drift',
        'friction (1 - share (q (1 - exp(-t / fast)) + (1 - q) (1 - exp(-t / slow))))',
        'Simoni, Beschi, Legnani, Visioli 2015, IROS: a fast and a slow part of warming',
        Range('share', '1', 0.06, 0.85),
        (
            Range('fast', 's', 0.9, 2.6, counterpart='time_constant'),
            Range('slow', 's', 11.0, 70.0, geometric=True, counterpart='time_constant'),
            Range('split', '1', 0.4, 0.75),
        ),
        setter(
            share=at.WARMING_SHARE,
            fast=at.WARMING_FAST,
            slow=at.WARMING_SLOW,
            split=at.WARMING_SPLIT,
        ),
    ),
    Form(
        'drift.oil',
        'friction_drift',
        "M_V v exp(-share w), w' = (friction power / power - w) / time; M_C stays",
        'Reynolds 1886: viscosity falls exponentially; heated by its own loss, Kennel 1968',
        Range('share', '1', 0.2, 6.0),
        (
            Range('time', 's', 1.7, 6.6, geometric=True, counterpart='time_constant'),
            Range('power', '1', 0.6, 2.2, geometric=True),
        ),
        oil,
    ),
    Form(
        'place.misalignment',
        'position_dependent_friction',
        'M_C (1 + share sin(2 pi z / length + phase)) sgn v',
        'Armstrong-Helouvry 1991, fig. 4.6; waves of a rail: Zhong, Rao, Xu 2011',
        Range('share', '1', 0.05, 0.8),
        (Range('length', 'm', 0.33, 0.85), PHASE),
        setter(share=at.PLACE_SHARE, length=at.PLACE_LENGTH, phase=at.PLACE_PHASE),
    ),
)
