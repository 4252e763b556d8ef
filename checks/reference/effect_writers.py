# SPDX-License-Identifier: Apache-2.0
"""How each effect of the catalogue is written into a plant: one function an effect.

Each takes the plant, the drive's index (-1 for the whole machine), the values, whether the other
form is wanted, and the seed of what is random in it. The equations stand in `effect_table`.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from checks.reference import layout as at
from checks.reference.plant import Array, Plant, set_columns

Values = Mapping[str, float]


def coulomb(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write coulomb."""
    set_columns(
        plant, i, {at.EXTRA_COULOMB: values['torque'], at.EXTRA_COULOMB_FORM: float(other)}
    )


def viscous(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write viscous."""
    exponent = 0.85 if other else 1.0
    set_columns(plant, i, {at.EXTRA_VISCOUS: values['slope'], at.EXTRA_VISCOUS_EXPONENT: exponent})


def stribeck(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write stribeck."""
    set_columns(
        plant,
        i,
        {
            at.STRIBECK_TORQUE: values['torque'],
            at.STRIBECK_SPEED: values['speed'],
            at.STRIBECK_FORM: float(other),
        },
    )


def load(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write load."""
    set_columns(plant, i, {at.LOAD_FRICTION: values['share'], at.LOAD_FRICTION_FORM: float(other)})


def press(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write friction of a gear that motor and load press."""
    columns = {
        at.PRESS_MOTOR: values['motor'],
        at.PRESS_LOAD: values['load'],
        at.PRESS_SPEED: values.get('speed', 0.0),
        at.PRESS_FORM: float(other),
    }
    set_columns(plant, i, columns)


def square(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write friction by the square of what presses a gear."""
    columns = {
        at.SQUARE_MOTOR: values['motor'],
        at.SQUARE_LOAD: values['load'],
        at.SQUARE_SPEED: values['speed'],
        at.SQUARE_FORM: float(other),
    }
    set_columns(plant, i, columns)


def asymmetry(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write asymmetry."""
    width = 0.03 if other else 0.0
    set_columns(plant, i, {at.ASYMMETRY: values['share'], at.ASYMMETRY_WIDTH: width})


def presliding(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write presliding."""
    form = values['kind'] if other else 0.0
    columns = {at.PRESLIDE_LENGTH: values['length'], at.PRESLIDE_FORM: form}
    set_columns(plant, i, columns, internal=True)


def drag(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write drag."""
    set_columns(plant, i, {at.DRAG: values['slope'], at.DRAG_EXPONENT: 1.75 if other else 2.0})


def degressive(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write degressive."""
    columns = {
        at.DEGRESSIVE_TORQUE: values['torque'],
        at.DEGRESSIVE_SPEED: values['speed'],
        at.DEGRESSIVE_FORM: float(other),
    }
    set_columns(plant, i, columns)


def flexible_load(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write flexible load."""
    rate = 2.0 * np.pi * values['frequency']
    # A third stiffer where the load is accelerated by 5 m/s^2.
    columns = {
        at.LOAD_SHARE: values['share'],
        at.LOAD_RATE: rate,
        at.LOAD_DAMPING: values['damping'],
        at.LOAD_HARDENING: (rate**2 / 5.0) ** 2 / 3.0 * other,
    }
    set_columns(plant, i, columns)


def backlash(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write backlash."""
    set_columns(plant, i, {at.BACKLASH: values['width'], at.BACKLASH_FORM: float(other)})


def ripple(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write ripple."""
    set_columns(
        plant,
        i,
        {
            at.RIPPLE_TORQUE: values['torque'],
            at.RIPPLE_ORDER: values['order'],
            at.RIPPLE_PHASE: values['phase'],
            at.RIPPLE_SECOND: 0.3 * other,
            at.RIPPLE_THIRD: 0.15 * other,
            at.RIPPLE_CURRENT: 0.1
            * values['torque']
            / plant.drive[i, at.TORQUE_LIMIT]
            * 6.0
            * other,
        },
    )


def eccentricity(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write eccentricity."""
    set_columns(
        plant,
        i,
        {
            at.ECCENTRICITY: values['amplitude'],
            at.ECCENTRICITY_PHASE: values['phase'],
            at.ECCENTRICITY_SECOND: 0.25 * other,
        },
    )


def torque_constant(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write torque constant."""
    if other:
        # The motor makes less of a current than its data sheet says; the log keeps the latter.
        plant.drive[i, at.ACTUATOR_GAIN] = -values['share']
        return

    def scaled(torque: Array, cycle: float) -> Array:
        out = torque.copy()
        out[i] *= 1.0 + values['share']
        return out

    plant.effort_filters.append(scaled)


def saturation(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write saturation."""
    set_columns(plant, i, {at.TORQUE_LIMIT: values['limit'], at.TORQUE_KNEE: 12.0 * other})


def current_lag(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write current lag."""
    columns = {at.CURRENT_LAG: values['time'], at.CURRENT_LAG_FORM: float(other)}
    set_columns(plant, i, columns, internal=True)


def cable(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write cable."""
    stiffness = values['stiffness']
    columns = {at.CABLE_STIFFNESS: stiffness, at.CABLE_PLACE: values['place']}
    if other:
        columns |= {
            at.CABLE_CUBIC: 40.0,
            at.CABLE_HYSTERESIS: 0.008 * stiffness,
            at.CABLE_LENGTH: 0.01,
        }
    set_columns(plant, i, columns, internal=other)


def constant(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write constant."""
    plant.drive[i, at.CONSTANT_FORCE] += values['force']
    if other:
        # A spring balancer pulls almost evenly: a tenth less force per metre of its stroke.
        plant.drive[i, at.CONSTANT_SLOPE] += -0.1 * values['force']


def bias(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write bias."""

    def biased(torque: Array, cycle: float) -> Array:
        out = torque.copy()
        time = np.arange(torque.shape[1]) * cycle
        out[i] += values['torque'] * (1.0 + (0.1 * np.sin(0.4 * time) if other else 0.0))
        return out

    plant.effort_filters.append(biased)


def drift(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write drift."""
    if not other:
        set_columns(plant, i, {at.DRIFT_RATE: -values['share'] / 10.0})
        return
    # Half a watt of friction warms the tripod's drive; others by their torque limit.
    power = plant.drive[i, at.TORQUE_LIMIT] * plant.drive[i, at.GEAR] / (6.0 * 25.0 * np.pi)
    power = 0.5 * (power if np.isfinite(power) else 1.0)
    columns = {
        at.DRIFT_SHARE: values['share'],
        at.DRIFT_TIME: values['time'],
        at.DRIFT_POWER: power,
    }
    set_columns(plant, i, columns, internal=True)


def velocity_gain(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write velocity gain."""
    plant.drive[i, at.VELOCITY_GAIN] *= 1.0 + values['share']
    if other:
        # A controller that is set by gain and reset time keeps the integral gain in step, partly.
        plant.drive[i, at.INTEGRAL_GAIN] *= 1.0 + 0.3 * values['share']


def position_gain(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write position gain."""
    plant.drive[i, at.POSITION_GAIN] *= 1.0 + values['share']


def command_delay(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write command delay."""

    def delayed(target: Array, speed: Array, cycle: float) -> tuple[Array, Array]:
        instants = np.arange(target.shape[1]) * cycle
        when = instants - values['time']
        if other:
            # Whole cycles; behind a long delay there is a queue, and now and then one cycle more.
            late = np.random.default_rng(seed).random(instants.size) < 0.05
            late &= values['time'] > 2.0 * cycle
            when = np.floor(when / cycle + 0.5) * cycle - cycle * late
        out, out_speed = target.copy(), speed.copy()
        out[i] = np.interp(when, instants, target[i])
        out_speed[i] = np.interp(when, instants, speed[i], left=0.0)
        return out, out_speed

    plant.command_filters.append(delayed)


def stiffness(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write stiffness."""
    columns = {
        at.STIFFNESS_SLOPE: values['slope'],
        at.STIFFNESS_PLACE: values['place'],
        at.STIFFNESS_FORM: float(other),
    }
    set_columns(plant, i, columns)


def quantisation(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write quantisation."""
    set_columns(
        plant, i, {at.ENCODER_STEP: values['step'], at.ENCODER_VELOCITY: 2e-3 if other else 1e-9}
    )


def frame(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write frame."""
    mass = values['mass']
    rate = 2.0 * np.pi * values['frequency']
    damping = 2.0 * values['damping'] * mass * rate
    plant.shared[at.FRAME_MASS] = mass
    plant.shared[at.FRAME_STIFFNESS] = mass * rate**2
    plant.shared[at.FRAME_DAMPING] = damping * (0.5 if other else 1.0)
    # Joints damp with the square of the speed: as strong as the linear part at 4 mm/s.
    plant.shared[at.FRAME_QUADRATIC] = 0.5 * damping / 4e-3 * other


def payload(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write payload."""
    plant.shared[at.PAYLOAD] = values['mass']
    plant.shared[at.PAYLOAD_FROM] = values['time']
    plant.shared[at.PAYLOAD_UNTIL] = values['time'] + (2.5 if other else 1e6)
    plant.shared[at.PAYLOAD_RAMP] = 0.12 if other else 1e-3


def rods(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write rods."""
    # Lumped at both ends, as calculations by hand do; or uniform, which is exact.
    plant.shared[at.ROD_MASS] = values['mass']
    plant.shared[at.ROD_AT_CARRIAGE] = 1.0 / 3.0 if other else 0.5
    plant.shared[at.ROD_BETWEEN] = 1.0 / 6.0 if other else 0.0
    plant.shared[at.ROD_AT_PLATFORM] = 1.0 / 3.0 if other else 0.5
    plant.shared[at.ROD_CENTRE] = 0.5


def radius(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write radius."""
    uneven = np.array([0.85, 1.05, 1.1]) if other else np.ones(3)
    radius = np.hypot(plant.drive[:, at.RAIL_X], plant.drive[:, at.RAIL_Y])
    plant.drive[:, at.RAIL_X] *= 1.0 + values['length'] * uneven / radius
    plant.drive[:, at.RAIL_Y] *= 1.0 + values['length'] * uneven / radius


def rod_length(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write rod length."""
    uneven = np.array([1.1, 0.85, 1.05]) if other else np.ones(3)
    plant.drive[:, at.ROD_LENGTH] += values['length'] * uneven


def lagged(signal: Array, time: float, cycle: float) -> Array:
    """Return a signal (K,) behind a first-order lag that has settled on its first value."""
    share = 1.0 - np.exp(-cycle / time)
    out, _ = lfilter([share], [1.0, share - 1.0], signal, zi=[(1.0 - share) * signal[0]])
    return np.asarray(out, dtype=float)


def effort_delay(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write effort delay."""
    if not other:
        plant.delay[i] += values['time']
        return

    def late(torque: Array, cycle: float) -> Array:
        instants = np.arange(torque.shape[1])
        more = np.random.default_rng(seed).random(instants.size) < 0.1
        taken = np.maximum(0, instants - round(values['time'] / cycle) - more)
        out = torque.copy()
        out[i] = torque[i, taken]
        return out

    plant.effort_filters.append(late)


def effort_filter(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write effort filter."""

    def filtered(torque: Array, cycle: float) -> Array:
        out = torque.copy()
        if other:
            half = 0.5 * values['time']
            out[i] = lagged(lagged(torque[i], half, cycle), half, cycle)
        else:
            out[i] = lagged(torque[i], values['time'], cycle)
        return out

    plant.effort_filters.append(filtered)


def effort_smoothing(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write smoothed efforts."""

    def smoothed(torque: Array, cycle: float) -> Array:
        count = torque.shape[1]
        # Continued by point reflection at both ends, long enough to end where it begins.
        before = 2.0 * torque[:, :1] - torque[:, :0:-1]
        behind = 2.0 * torque[:, -1:] - torque[:, -2::-1]
        whole = np.concatenate([before, torque, behind], axis=1)
        drift = np.linspace(whole[:, 0], whole[:, -1], whole.shape[1], axis=1)
        ratio = np.fft.rfftfreq(whole.shape[1], cycle) * values['period']
        gain = 0.5 ** (ratio**2) if other else 1.0 / (1.0 + ratio**4)
        passed = np.fft.irfft(gain * np.fft.rfft(whole - drift), whole.shape[1]) + drift
        return np.ascontiguousarray(passed[:, count - 1 : 2 * count - 1])

    plant.log_filters.append(smoothed)


def integral_gain(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write integral gain."""
    plant.drive[i, at.INTEGRAL_GAIN] *= 1.0 + values['share']


def place_friction(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write place friction."""
    columns = {
        at.PLACE_SLOPE: values['slope'],
        at.PLACE_MIDDLE: values['middle'],
        at.PLACE_FORM: float(other),
    }
    set_columns(plant, i, columns)


def crosstalk(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write crosstalk."""

    def mixed(torque: Array, cycle: float) -> Array:
        others = [j for j in range(torque.shape[0]) if j != i]
        weights = (
            np.linspace(1.3, 0.7, len(others))
            if other and len(others) > 1
            else np.ones(len(others))
        )
        leak = weights @ torque[others]
        if other:
            leak = lagged(leak, 1.5e-3, cycle)
        out = torque.copy()
        out[i] += values['share'] * leak
        return out

    plant.effort_filters.append(mixed)


def sign(plant: Plant, i: int, values: Values, other: bool, seed: int) -> None:
    """Write sign."""
    set_columns(plant, i, {at.SIGN_FORM: 1.0, at.SIGN_WIDTH: values['width']})
