# SPDX-License-Identifier: Apache-2.0
"""Forms of gear and carriage: z motor, s carriage, x = z - s, c and d stiffness and damping."""

import numpy as np

from checks.blind.forms import columns as at
from checks.blind.forms.form import Form, Range, setter, Values, Write
from checks.reference import layout as nominal
from checks.reference.plant import Plant

_PHASE = Range('phase', 'rad', 0.0, 2.0 * np.pi)
HARMONICS = (
    Range('second', '1', 0.08, 0.45),
    Range('second_phase', 'rad', 0.0, 2.0 * np.pi),
    Range('third', '1', 0.03, 0.25),
    Range('third_phase', 'rad', 0.0, 2.0 * np.pi),
)


def harmonics(phase: int) -> dict[str, int]:
    """Return the columns of `HARMONICS` and the phase before them, see `force_law.wave`."""
    names = ('phase', *(number.name for number in HARMONICS))
    return {name: phase + n for n, name in enumerate(names)}


_GAP = Range('gap', 'm', 2e-5, 6e-4, counterpart='gap')


def gap(kind: float) -> Write:
    """Return a `write` of play."""

    def write(plant: Plant, i: int, values: Values, seed: int) -> None:
        plant.drive[i, at.GAP_KIND] = kind
        plant.drive[i, at.GAP] = values['gap']
        plant.drive[i, at.GAP_SHAPE] = values['shape']

    return write


def flexible(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a load behind a spring that stiffens: by `hardening` at 5 m/s^2."""
    rate = 2.0 * np.pi * values['frequency']
    plant.drive[i, nominal.LOAD_SHARE] = values['share']
    plant.drive[i, nominal.LOAD_RATE] = rate
    plant.drive[i, nominal.LOAD_DAMPING] = values['damping']
    plant.drive[i, nominal.LOAD_HARDENING] = values['hardening'] * (rate**2 / 5.0) ** 2


FORMS = (
    Form(
        'backlash.contact',
        'backlash',
        "c y + d min(1, y / ground) y', never pulling; y depth beyond the play",
        'Hunt and Crossley 1975, J. Appl. Mech. 42(2): damping comes with the depth',
        _GAP,
        (Range('shape', '1', 0.06, 0.5),),
        gap(1.0),
        needs='gear',
    ),
    Form(
        'backlash.rounded',
        'backlash',
        'c (x + (hypot(x - gap/2, r) - hypot(x + gap/2, r)) / 2), r = shape gap',
        'Kim, Rook, Singh 2005, J. Sound Vib. 281: smoothed clearance',
        _GAP,
        (Range('shape', '1', 0.03, 0.16),),
        gap(2.0),
        needs='gear',
    ),
    Form(
        'flexibility.hardening',
        'gear_flexibility',
        "c x (1 + h x^2) + d x' before a share of the moved mass",
        'Tuttle and Seering 1996, IEEE T-RA 12(3): gears stiffen with their load',
        Range('share', '1', 0.02, 0.6),
        (
            Range('frequency', 'Hz', 11.0, 41.0, counterpart='frequency'),
            Range('damping', '1', 0.02, 0.11),
            Range('hardening', '1', 0.1, 0.5),
        ),
        flexible,
        needs='rigid',
    ),
    Form(
        'eccentricity.harmonics',
        'transmission_eccentricity',
        'x + amplitude (sin a + h_2 sin(2 a + p_2) + h_3 sin(3 a + p_3)), a = gear z + phase',
        'Tavakoli and Houser 1986, J. Mech. Trans. Autom. Des. 108(1): transmission error',
        Range('amplitude', 'm', 2e-5, 5e-4),
        (_PHASE, *HARMONICS),
        setter(amplitude=at.ERROR_LENGTH, **harmonics(at.ERROR_PHASE)),
        needs='gear',
    ),
    Form(
        'stiffness.spans',
        'position_dependent_stiffness',
        'c (1 - p + p (q l / (l + s - place) + (1 - q) u / (u - s + place))), d ln c / ds = slope',
        'Hace, Jezernik, Sabanovic 2007, IEEE TIE 54(5): two spans of a belt',
        Range('slope', '1/m', 0.3, 3.0, signed=True),
        (
            Range('place', 'm', 0.44, 0.5),
            Range('lower', 'm', 0.2, 0.3),
            Range('upper', 'm', 0.22, 0.3),
        ),
        setter(slope=at.SPAN_SLOPE, place=at.SPAN_PLACE, lower=at.SPAN_LOWER, upper=at.SPAN_UPPER),
        needs='gear',
    ),
    Form(
        'cable.exponential',
        'cable_spring',
        '-stiffness length (exp((s - place) / length) - 1)',
        'Fung 1967, Am. J. Physiol. 213(6): elastomers and hoses stiffen exponentially',
        Range('stiffness', 'N/m', 4.0, 150.0),
        (Range('place', 'm', 0.42, 0.53), Range('length', 'm', 0.14, 0.5)),
        setter(stiffness=at.HOSE_STIFFNESS, place=at.HOSE_PLACE, length=at.HOSE_LENGTH),
    ),
    Form(
        'end_contact',
        'end_stop',
        "-stiffness y^(3/2) (1 + damping y'), y = s - place where positive",
        'Hunt and Crossley 1975, J. Appl. Mech. 42(2), eq. 10',
        Range('stiffness', 'N/m^1.5', 250.0, 3e4, counterpart='stiffness'),
        (Range('place', 'm', 0.49, 0.53), Range('damping', 's/m', 0.1, 0.9)),
        setter(stiffness=at.STOP_STIFFNESS, place=at.STOP_PLACE, damping=at.STOP_DAMPING),
        fades=False,
    ),
    Form(
        'force.gas_spring',
        'constant_force',
        '-force (length / (length - s + place))^n',
        'polytropic gas spring, Bauer 2010, Hydropneumatic Suspension Systems, eq. 2.20',
        Range('force', 'N', 0.4, 12.0, signed=True),
        (
            Range('place', 'm', 0.44, 0.5),
            Range('length', 'm', 1.1, 2.6),
            Range('exponent', '1', 1.02, 1.35),
        ),
        setter(
            force=at.GAS_FORCE, place=at.GAS_PLACE, length=at.GAS_LENGTH, exponent=at.GAS_EXPONENT
        ),
    ),
)
