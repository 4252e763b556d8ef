# SPDX-License-Identifier: Apache-2.0
"""The effects of the catalogue as the reference has them, and how each is written into a plant.

Symbols: z motor, v its speed, s carriage, F gear force, M torque, sigma(v) the regularised sign.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import lfilter

from checks.reference import layout as at
from checks.reference.effect_kind import Kind, Quantity, Write
from checks.reference.plant import Array, EffortFilter, Plant, set_columns

Values = Mapping[str, float]


def setter(internal: bool = False, **columns: int) -> Write:
    """Return a `write` that puts values into columns of their drive, by name."""

    def write(plant: Plant, i: int, values: Values) -> None:
        named = {column: values[name] for name, column in columns.items()}
        set_columns(plant, i, named, internal)

    return write


def adder(column: int, name: str) -> Write:
    """Return a `write` that adds a value to a column of its drive."""

    def write(plant: Plant, i: int, values: Values) -> None:
        plant.drive[i, column] += values[name]

    return write


def factor(column: int) -> Write:
    """Return a `write` that raises a column of its drive by a share."""

    def write(plant: Plant, i: int, values: Values) -> None:
        plant.drive[i, column] *= 1.0 + values['share']

    return write


def logged(change: Callable[[Array, int, Values, float], Array]) -> Write:
    """Return a `write` that changes what the log has of a drive.

    Args:
        change: Returns the drive's log (K,) of all torques (D, K), index, values and cycle [s].
    """

    def write(plant: Plant, i: int, values: Values) -> None:
        def changed(torque: Array, cycle: float) -> Array:
            out = torque.copy()
            out[i] = change(torque, i, values, cycle)
            return out

        plant.effort_filters.append(changed)

    return write


def lagged(signal: Array, time: float, cycle: float) -> Array:
    """Return a signal (K,) behind a first-order lag that has settled on its first value."""
    share = 1.0 - np.exp(-cycle / time)
    out, _ = lfilter([share], [1.0, share - 1.0], signal, zi=[(1.0 - share) * signal[0]])
    return np.asarray(out, dtype=float)


def torque_constant(plant: Plant, i: int, values: Values) -> None:
    """Write a motor that makes less of a current than its data sheet says; the log keeps that."""
    plant.drive[i, at.ACTUATOR_GAIN] = -values['share']


def flexible_load(plant: Plant, i: int, values: Values) -> None:
    """Write a load behind a spring."""
    rate = 2.0 * np.pi * values['frequency']
    columns = {at.LOAD_SHARE: values['share'], at.LOAD_RATE: rate}
    set_columns(plant, i, columns | {at.LOAD_DAMPING: values['damping']})


def drift(plant: Plant, i: int, values: Values) -> None:
    """Write friction that falls in proportion to the time."""
    set_columns(plant, i, {at.DRIFT_RATE: -values['share'] / 10.0})


def command_delay(plant: Plant, i: int, values: Values) -> None:
    """Write a set-point that comes late."""

    def delayed(target: Array, speed: Array, cycle: float) -> tuple[Array, Array]:
        instants = np.arange(target.shape[1]) * cycle
        when = instants - values['time']
        out, out_speed = target.copy(), speed.copy()
        out[i] = np.interp(when, instants, target[i])
        out_speed[i] = np.interp(when, instants, speed[i], left=0.0)
        return out, out_speed

    plant.command_filters.append(delayed)


def quantisation(plant: Plant, i: int, values: Values) -> None:
    """Write an encoder's steps, and a speed made of them that is smoothed."""
    set_columns(plant, i, {at.ENCODER_STEP: values['step'], at.ENCODER_VELOCITY: 2e-3})


def effort_delay(plant: Plant, i: int, values: Values) -> None:
    """Write a log that comes late."""
    plant.delay[i] += values['time']


def smoothing(period: float) -> EffortFilter:
    """Return a filter without phase."""

    def smoothed(torque: Array, cycle: float) -> Array:
        count = torque.shape[1]
        # Continued by point reflection at both ends, long enough to end where it begins.
        before = 2.0 * torque[:, :1] - torque[:, :0:-1]
        behind = 2.0 * torque[:, -1:] - torque[:, -2::-1]
        whole = np.concatenate([before, torque, behind], axis=1)
        drift = np.linspace(whole[:, 0], whole[:, -1], whole.shape[1], axis=1)
        ratio = np.fft.rfftfreq(whole.shape[1], cycle) * period
        spectrum = np.fft.rfft(whole - drift) / (1.0 + ratio**4)
        passed = np.fft.irfft(spectrum, whole.shape[1]) + drift
        return np.ascontiguousarray(passed[:, count - 1 : 2 * count - 1])

    return smoothed


def effort_smoothing(plant: Plant, i: int, values: Values) -> None:
    """Write smoothed efforts."""
    plant.log_filters.append(smoothing(values['period']))


def frame(plant: Plant, i: int, values: Values) -> None:
    """Write a frame that swings."""
    mass, rate = values['mass'], 2.0 * np.pi * values['frequency']
    plant.shared[at.FRAME_MASS] = mass
    plant.shared[at.FRAME_STIFFNESS] = mass * rate**2
    plant.shared[at.FRAME_DAMPING] = 2.0 * values['damping'] * mass * rate


def payload(plant: Plant, i: int, values: Values) -> None:
    """Write a load that is taken up once and for all."""
    plant.shared[at.PAYLOAD] = values['mass']
    plant.shared[at.PAYLOAD_FROM] = values['time']
    plant.shared[at.PAYLOAD_UNTIL] = values['time'] + 1e6
    plant.shared[at.PAYLOAD_RAMP] = 1e-3


def rods(plant: Plant, i: int, values: Values) -> None:
    """Write rods whose mass is lumped at both ends, as calculations by hand do."""
    plant.shared[at.ROD_MASS] = values['mass']
    for column in (at.ROD_AT_CARRIAGE, at.ROD_AT_PLATFORM, at.ROD_CENTRE):
        plant.shared[column] = 0.5


def radius(plant: Plant, i: int, values: Values) -> None:
    """Write rails that stand off."""
    far = np.hypot(plant.drive[:, at.RAIL_X], plant.drive[:, at.RAIL_Y])
    for column in (at.RAIL_X, at.RAIL_Y):
        plant.drive[:, column] *= 1.0 + values['length'] / far


def rod_length(plant: Plant, i: int, values: Values) -> None:
    """Write longer rods."""
    plant.drive[:, at.ROD_LENGTH] += values['length']


def _share(low: float, high: float) -> Quantity:
    return Quantity('share', '1', low, high, signed=True)


def _torque(low: float, high: float, signed: bool = False) -> Quantity:
    return Quantity('torque', 'N m', low, high, signed)


def _time(low: float, high: float) -> Quantity:
    return Quantity('time', 's', low, high)


PHASE = Quantity('phase', 'rad', 0.0, 2.0 * np.pi)
# Friction of a gear that motor and load press.
PRESS = setter(motor=at.PRESS_MOTOR, load=at.PRESS_LOAD)
PRESS_FALLING = setter(motor=at.PRESS_MOTOR, load=at.PRESS_LOAD, speed=at.PRESS_SPEED)
SQUARE = setter(motor=at.SQUARE_MOTOR, load=at.SQUARE_LOAD, speed=at.SQUARE_SPEED)
PRESSED = Quantity('load', '1', 0.02, 0.3)
PRESSED_SPEED = Quantity('speed', 'rad/s', 0.2, 2.0)

# Name, equation, writer, size, and what is drawn beside it.
KINDS = (
    Kind('coulomb_friction', 'torque tanh(v / width)', setter(torque=at.EXTRA_COULOMB),
         _torque(0.008, 0.12)),
    Kind('viscous_friction', 'slope v', setter(slope=at.EXTRA_VISCOUS),
         Quantity('slope', 'N m s/m', 0.02, 0.25)),
    Kind('stribeck', 'torque exp(-(v / speed)^2) sigma(v)',
         setter(torque=at.STRIBECK_TORQUE, speed=at.STRIBECK_SPEED),
         _torque(0.01, 0.15), (Quantity('speed', 'm/s', 0.012, 0.06),)),
    Kind('load_dependent_friction', 'share |F / gear| sigma(v)', setter(share=at.LOAD_FRICTION),
         Quantity('share', '1', 0.01, 0.15), needs='gear'),
    Kind('directional_load_friction', '|motor M + load F / gear| sigma(v)', PRESS,
         Quantity('motor', '1', 0.02, 0.3), (PRESSED,), needs='supply'),
    Kind('stribeck_load_friction', '|motor M + load F / gear| exp(-(v / speed)^2) sigma(v)',
         PRESS_FALLING, Quantity('motor', '1', 0.02, 0.3), (PRESSED, PRESSED_SPEED),
         needs='supply'),
    Kind('quadratic_load_friction',
         'load F^2 / gear^2 where |F / gear| < |M|, else motor M^2, with exp(-(v / speed)^2)',
         SQUARE, Quantity('motor', '1/(N m)', 0.02, 0.3),
         (Quantity('load', '1/(N m)', 0.02, 0.3), PRESSED_SPEED), needs='supply'),
    Kind('asymmetric_friction', 'friction + share (M_C + M_V |v|) |sigma(v)|',
         setter(share=at.ASYMMETRY), _share(0.04, 0.7)),
    # The damping of LuGre's bristle falls off with speed, to stay passive (Olsson 1996).
    Kind('presliding', "M_C (a + damping exp(-(v / 10 mm/s)^2) a'), a' = (v - |v| a) / length",
         setter(True, length=at.PRESLIDE_LENGTH, damping=at.PRESLIDE_DAMPING),
         Quantity('length', 'm', 2e-5, 5e-4), (Quantity('damping', 's'),)),
    Kind('quadratic_drag', 'slope |v| v', setter(slope=at.DRAG),
         Quantity('slope', 'N m s^2/m^2', 0.02, 0.3)),
    Kind('degressive_friction',
         'torque tanh(v / speed) (Weigand, Ulmen, Janot, Ruskowski 2021)',
         setter(torque=at.DEGRESSIVE_TORQUE, speed=at.DEGRESSIVE_SPEED),
         _torque(0.01, 0.15), (Quantity('speed', 'm/s', 0.04, 0.3),)),
    Kind('gear_flexibility',
         "share of the moved mass behind c x + d x', x motor less load (Spong 1987)",
         flexible_load, Quantity('share', '1', 0.02, 0.6),
         (Quantity('frequency', 'Hz', 12.0, 40.0), Quantity('damping', '1', 0.02, 0.1)),
         needs='rigid'),
    Kind('backlash', "F = c (|z - s| - width/2) + d (z' - s') outside the gap",
         setter(width=at.BACKLASH), Quantity('width', 'm', 2e-5, 6e-4), needs='gear'),
    Kind('torque_ripple', 'torque sin(order gear z + phase)',
         setter(torque=at.RIPPLE_TORQUE, order=at.RIPPLE_ORDER, phase=at.RIPPLE_PHASE),
         _torque(0.008, 0.12), (Quantity('order', '1', choices=(1.0, 2.0, 4.0, 6.0)), PHASE)),
    Kind('transmission_eccentricity',
         'gear stretch + amplitude sin(gear z + phase), lever by virtual work',
         setter(amplitude=at.ECCENTRICITY, phase=at.ECCENTRICITY_PHASE),
         Quantity('amplitude', 'm', 2e-5, 5e-4), (PHASE,), needs='gear'),
    Kind('torque_constant_error', 'torque on the rotor (1 - share), log as commanded',
         torque_constant, _share(0.01, 0.12)),
    Kind('torque_saturation', 'clip(M, +-limit)', setter(limit=at.TORQUE_LIMIT),
         Quantity('limit', 'N m', 2.5, 1.3)),
    Kind('current_loop_lag', "tau' = (M - tau) / time", setter(True, time=at.CURRENT_LAG),
         _time(2e-4, 4e-3)),
    Kind('cable_spring', '-stiffness (s - place)',
         setter(stiffness=at.CABLE_STIFFNESS, place=at.CABLE_PLACE),
         Quantity('stiffness', 'N/m', 4.0, 150.0), (Quantity('place', 'm', 0.42, 0.53),)),
    Kind('end_stop', 'stiffness (s cut off at lower and upper - s)',
         setter(stiffness=at.STOP_STIFFNESS, lower=at.STOP_LOWER, upper=at.STOP_UPPER),
         Quantity('stiffness', 'N/m', 40.0, 4000.0),
         (Quantity('lower', 'm', 0.42, 0.44), Quantity('upper', 'm', 0.50, 0.52))),
    Kind('constant_force', 'load of `force` against the positive direction',
         adder(at.CONSTANT_FORCE, 'force'), Quantity('force', 'N', 0.4, 12.0, signed=True)),
    Kind('effort_bias', 'logged torque + torque',
         logged(lambda all_, i, values, cycle: all_[i] + values['torque']),
         _torque(0.005, 0.12, signed=True)),
    Kind('friction_drift', 'friction max(0, 1 - share t / 10 s)', drift,
         Quantity('share', '1', 0.05, 0.8)),
    Kind('position_dependent_friction', 'M_C (1 + slope (z - middle)) sigma(v)',
         setter(slope=at.PLACE_SLOPE, middle=at.PLACE_MIDDLE),
         Quantity('slope', '1/m', 0.5, 9.0, signed=True),
         (Quantity('middle', 'm', 0.42, 0.52),)),
    Kind('effort_delay', 'log later by time', effort_delay, _time(2e-4, 5e-3)),
    Kind('effort_filter', "log through time x' = M - x",
         logged(lambda all_, i, values, cycle: lagged(all_[i], values['time'], cycle)),
         _time(2e-4, 5e-3)),
    Kind('effort_smoothing', 'log of gain 1 / (1 + (f period)^4) without phase',
         effort_smoothing, Quantity('period', 's', 5e-3, 0.5), place='all'),
    Kind('integral_gain_error', 'k_I (1 + share)', factor(at.INTEGRAL_GAIN), _share(0.05, 0.7),
         needs='integral'),
    Kind('velocity_gain_error', 'k_v (1 + share)', factor(at.VELOCITY_GAIN), _share(0.02, 0.4)),
    Kind('position_gain_error', 'k_p (1 + share)', factor(at.POSITION_GAIN), _share(0.02, 0.4)),
    Kind('command_delay', 'set-point of t - time', command_delay, _time(3e-4, 6e-3)),
    Kind('position_dependent_stiffness', 'c (1 + slope (s - place))',
         setter(slope=at.STIFFNESS_SLOPE, place=at.STIFFNESS_PLACE),
         Quantity('slope', '1/m', 0.3, 3.0, signed=True), (Quantity('place', 'm', 0.44, 0.50),),
         needs='gear'),
    Kind('encoder_quantisation',
         'controller sees z rounded to step, and the error in its speed through a lag of 2 ms',
         quantisation, Quantity('step', 'm', 3e-6, 1e-4)),
    Kind('frame_resonance', "mass y'' + d y' + k y = -sum of the drives' forces", frame,
         Quantity('mass', 'kg', 300.0, 8.0),
         (Quantity('frequency', 'Hz', 8.0, 35.0), Quantity('damping', '1', 0.02, 0.10)),
         'all', 'platform'),
    Kind('payload_change', 'tool mass + mass from `time` on', payload,
         Quantity('mass', 'kg', 0.02, 0.5, signed=True), (_time(1.0, 4.0),), 'all', 'platform'),
    Kind('rod_mass', 'half of each rod at either end (Codourey 1998)', rods,
         Quantity('mass', 'kg', 0.005, 0.12), (), 'all', 'platform'),
    Kind('rail_radius_error', 'rail radius + length', radius,
         Quantity('length', 'm', 5e-4, 1.8e-2, signed=True), (), 'all', 'platform'),
    Kind('rod_length_error', 'rod length + length', rod_length,
         Quantity('length', 'm', 7e-4, 2.2e-2, signed=True), (), 'all', 'platform'),
    Kind('effort_crosstalk', 'logged torque + share (sum of the others)',
         logged(lambda all_, i, values, cycle:
                all_[i] + values['share'] * (all_.sum(axis=0) - all_[i])),
         _share(0.01, 0.15), needs='drives'),
)  # fmt: skip
