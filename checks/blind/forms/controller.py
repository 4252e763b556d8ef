# SPDX-License-Identifier: Apache-2.0
"""Forms of motor and controller: M torque, k gains, T cycle."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from checks.blind.forms import columns as at
from checks.blind.forms.form import Form, Range, setter, Values
from checks.blind.forms.transmission import HARMONICS, harmonics
from checks.reference import layout as nominal
from checks.reference.plant import Array, Plant

FASTEST = 4e-5  # s
_SHARE = Range('share', '1', 0.02, 0.4, signed=True)


def second_order(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a closed current loop of second order whose delay at low frequency is `time`."""
    # A loop faster than that is seen by nobody, and only makes the integration slow.
    time = max(FASTEST, values['time'])
    plant.drive[i, at.CURRENT_RATE] = 2.0 * values['damping'] / time
    plant.drive[i, at.CURRENT_DAMPING] = values['damping']


def flux(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a torque constant that is off, and falls further as the iron saturates."""
    plant.drive[i, at.FLUX_SHARE] = values['share']
    limit = plant.drive[i, nominal.TORQUE_LIMIT]
    lost = values['saturation'] * abs(values['share'])
    plant.drive[i, at.FLUX_SATURATION] = lost / limit if np.isfinite(limit) else 0.0


def times(share: float) -> float:
    """Return the factor on a gain that is off: never a negative one, however large the share."""
    return 1.0 + share if share > 0.0 else 1.0 / (1.0 - share)


def velocity_gain(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a velocity gain whose integral part follows in part: set by a reset time."""
    plant.drive[i, nominal.VELOCITY_GAIN] *= times(values['share'])
    plant.drive[i, nominal.INTEGRAL_GAIN] *= times(values['following'] * values['share'])


def gain(column: int) -> object:
    """Return a `write` of a gain that is off."""

    def write(plant: Plant, i: int, values: Values, seed: int) -> None:
        plant.drive[i, column] *= times(values['share'])

    return write


def smoothed_command(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write a set-point that arrives late, and through an interpolator's moving mean."""

    def late(target: Array, speed: Array, cycle: float) -> tuple[Array, Array]:
        instants = np.arange(target.shape[1]) * cycle
        width = max(1, round(2.0 * values['smooth'] * values['time'] / cycle))
        # A mean over the last `width` cycles is late by half of them.
        when = instants - values['time'] + 0.5 * (width - 1) * cycle
        shift = (width - 1) // 2
        out, out_speed = target.copy(), speed.copy()
        for signal, there in ((target, out), (speed, out_speed)):
            moved = np.interp(when, instants, signal[i])
            there[i] = uniform_filter1d(moved, width, mode='nearest', origin=shift)
        return out, out_speed

    plant.command_filters.append(late)


def reading(plant: Plant, i: int, values: Values, seed: int) -> None:
    """Write an encoder's steps; the controller's speed is a smoothed difference of them."""
    plant.drive[i, nominal.ENCODER_STEP] = values['step']
    plant.drive[i, nominal.ENCODER_PHASE] = values['offset']
    plant.drive[i, nominal.ENCODER_VELOCITY] = values['lag']


FORMS = (
    Form(
        'ripple.harmonics',
        'torque_ripple',
        'torque (sin a + h_2 sin(2 a + p_2) + h_3 sin(3 a + p_3)), a = order gear z + phase',
        'Hanselman 1994, Brushless Motor Design, ch. 5: cogging; a gearhead makes orders uneven',
        Range('torque', 'N m', 0.008, 0.12),
        (
            Range('order', '1', 1.2, 13.4, counterpart='order'),
            Range('phase', 'rad', 0.0, 2.0 * np.pi),
            *HARMONICS,
        ),
        setter(torque=at.COGGING, order=at.COGGING_ORDER, **harmonics(at.COGGING_PHASE)),
    ),
    Form(
        'torque_constant.saturation',
        'torque_constant_error',
        'M (1 - share - saturation |share| |M| / limit) on the rotor, the log as commanded',
        'Hendershot and Miller 1994, Design of Brushless PM Motors, ch. 7: k_T falls with current',
        Range('share', '1', 0.01, 0.12, signed=True),
        (Range('saturation', '1', 0.2, 0.9),),
        flux,
    ),
    Form(
        'limit.speed',
        'torque_saturation',
        'limit (1 - fade |v|) (1 +- skew), bent with a knee',
        'Krishnan 2001, Electric Motor Drives, ch. 9: the supply limits torque at speed',
        Range('limit', 'N m', 2.5, 1.3),
        (
            Range('fade', 's/m', 0.03, 0.2),
            Range('skew', '1', -0.05, 0.05),
            Range('knee', '1', 14.0, 40.0),
        ),
        setter(
            limit=nominal.TORQUE_LIMIT,
            fade=nominal.TORQUE_FADE,
            skew=nominal.TORQUE_SKEW,
            knee=nominal.TORQUE_KNEE,
        ),
        fades=False,
    ),
    Form(
        'current_loop.second_order',
        'current_loop_lag',
        "M'' = w^2 (M_c - M) - 2 D w M', w = 2 D / time",
        'Leonhard 2001, Control of Electrical Drives, sect. 7.1: the closed current loop',
        Range('time', 's', 2.1e-4, 4e-3, counterpart='time_constant'),
        (Range('damping', '1', 0.55, 0.95),),
        second_order,
        fades=False,  # where it has all but faded it makes the integration slow
    ),
    Form(
        'command.interpolator',
        'command_delay',
        'mean of the set-point over 2 smooth time, late by time in all',
        'Biagiotti and Melchiorri 2012, Robotics CIM 28(2): moving means shape set-points',
        Range('time', 's', 4e-4, 6e-3, counterpart='delay'),
        (Range('smooth', '1', 0.2, 0.9),),
        smoothed_command,
    ),
    Form(
        'gain.integral',
        'integral_gain_error',
        'k_I (1 + share), or k_I / (1 + |share|) where it is too small',
        'Astrom and Hagglund 1995, PID Controllers: a gain has one form; its size is drawn',
        Range('share', '1', 0.05, 0.7, signed=True),
        (),
        gain(nominal.INTEGRAL_GAIN),  # type: ignore[arg-type]
        needs='integral',
    ),
    Form(
        'gain.velocity',
        'velocity_gain_error',
        'k_v (1 + share), k_I (1 + following share), or their inverse',
        'Astrom and Hagglund 1995, eq. 3.1: a controller set by gain and reset time',
        _SHARE,
        (Range('following', '1', 0.1, 0.55),),
        velocity_gain,
    ),
    Form(
        'gain.position',
        'position_gain_error',
        'k_p (1 + share), or k_p / (1 + |share|) where it is too small',
        'Astrom and Hagglund 1995: a gain has one form; its size is drawn',
        _SHARE,
        (),
        gain(nominal.POSITION_GAIN),  # type: ignore[arg-type]
    ),
    Form(
        'encoder.steps',
        'encoder_quantisation',
        'step floor(z / step + 1/2 + offset), its difference in the speed behind a lag',
        'Brown, Schneider, Mulligan 1992, IEEE TIE 39(1): speed from encoders',
        Range('step', 'm', 3e-6, 1e-4, counterpart='step'),
        (Range('offset', '1', -0.45, 0.45), Range('lag', 's', 7e-4, 4e-3, geometric=True)),
        reading,
    ),
)
