# SPDX-License-Identifier: Apache-2.0
"""Forms of what carries and what is carried: frame, load, rods, geometry."""

from functools import partial

import numpy as np

from checks.blind.forms.form import Form, Range, Values
from checks.reference import layout as nominal
from checks.reference.plant import Plant

_UNEVEN = tuple(Range(f'uneven_{n}', '1', 0.72, 1.28) for n in range(1, 4))
TURNS = 3


def frame(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a frame whose joints soften and damp the more the faster it swings."""
    mass, rate = values['mass'], 2.0 * np.pi * values['frequency']
    damping = 2.0 * values['damping'] * mass * rate
    plant.shared[nominal.FRAME_MASS] = mass
    plant.shared[nominal.FRAME_STIFFNESS] = mass * rate**2
    plant.shared[nominal.FRAME_DAMPING] = (1.0 - values['dry']) * damping
    plant.shared[nominal.FRAME_QUADRATIC] = values['dry'] * damping / 4e-3
    plant.shared[nominal.FRAME_SOFTENING] = values['softening']
    plant.shared[nominal.FRAME_GIVE] = values['give'] / (mass * rate**2)


def payload(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a load that is taken up and put down again and again."""
    plant.shared[nominal.PAYLOAD] = values['mass']
    plant.shared[nominal.PAYLOAD_RAMP] = values['ramp']
    time = values['begin']
    for turn in range(TURNS):
        at = nominal.PAYLOAD_FROM + 2 * turn
        plant.shared[at] = time
        time += values[f'held_{turn + 1}']
        plant.shared[at + 1] = time
        time += values[f'free_{turn + 1}']


def rods(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write tubes with a heavy joint at either end: the moments of their mass along the rod."""
    lower, upper = values['at_platform'], values['at_carriage']
    tube = 1.0 - lower - upper
    plant.shared[nominal.ROD_MASS] = values['mass']
    plant.shared[nominal.ROD_AT_CARRIAGE] = tube / 3.0 + upper
    plant.shared[nominal.ROD_BETWEEN] = tube / 6.0
    plant.shared[nominal.ROD_AT_PLATFORM] = tube / 3.0 + lower
    plant.shared[nominal.ROD_CENTRE] = tube / 2.0 + lower


def _errors(values: Values) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    uneven = np.array([values[f'uneven_{n}'] for n in range(1, 4)])
    return np.asarray(values['length'] * uneven / uneven.mean())


def radius(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write rails that stand off by unequal amounts."""
    far = np.hypot(plant.drive[:, nominal.RAIL_X], plant.drive[:, nominal.RAIL_Y])
    for column in (nominal.RAIL_X, nominal.RAIL_Y):
        plant.drive[:, column] *= 1.0 + _errors(values) / far


def rod_length(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write rods that are long by unequal amounts."""
    plant.drive[:, nominal.ROD_LENGTH] += _errors(values)


_whole = partial(Form, place='all', needs='platform')
FORMS = (
    _whole(
        'frame.softening',
        'frame_resonance',
        "mass y'' + d (1 - q + q |y'| / 4 mm/s) y' + k y (1 - softening y^2 / (y^2 + g^2)) = -F",
        'Ibrahim and Pettit 2005, J. Sound Vib. 279: bolted joints soften and damp by slip',
        Range('mass', 'kg', 300.0, 8.0),
        (
            Range('frequency', 'Hz', 7.4, 36.0, counterpart='frequency'),
            Range('damping', '1', 0.02, 0.1),
            Range('dry', '1', 0.15, 0.6),
            Range('softening', '1', 0.03, 0.2),
            Range('give', 'N', 3.0, 25.0),
        ),
        frame,
    ),
    _whole(
        'payload.turns',
        'payload_change',
        'tool mass + mass while it is held, three times, taken up and put down within `ramp`',
        'Siciliano, Sciavicco, Villani, Oriolo 2009, Robotics, ch. 4: pick and place',
        Range('mass', 'kg', 0.02, 0.5, signed=True),
        (
            Range('begin', 's', 0.45, 1.35),
            *(Range(f'held_{n}', 's', 0.62, 1.9, counterpart='duration') for n in (1, 2, 3)),
            *(Range(f'free_{n}', 's', 0.55, 1.3) for n in (1, 2, 3)),
            Range('ramp', 's', 0.04, 0.19),
        ),
        payload,
    ),
    _whole(
        'rods.tubes',
        'rod_mass',
        'T = 1/2 integral m(u) |v_c + u (v_p - v_c)|^2 du, a tube with a joint at either end',
        'Codourey 1998, IJRR 17(12), eq. 4 before it is lumped',
        Range('mass', 'kg', 0.005, 0.12),
        (Range('at_carriage', '1', 0.08, 0.26), Range('at_platform', '1', 0.08, 0.26)),
        rods,
    ),
    _whole(
        'radius.uneven',
        'rail_radius_error',
        'rail radius + length u_i, another u on each rail, mean 1',
        'Vischer and Clavel 1998, Robotica 16(2): every strut of a Delta has its own error',
        Range('length', 'm', 5e-4, 1.8e-2, signed=True),
        _UNEVEN,
        radius,
    ),
    _whole(
        'rod_length.uneven',
        'rod_length_error',
        'rod length + length u_i, another u on each rod, mean 1',
        'Vischer and Clavel 1998, Robotica 16(2): every strut of a Delta has its own error',
        Range('length', 'm', 7e-4, 2.2e-2, signed=True),
        _UNEVEN,
        rod_length,
    ),
)
