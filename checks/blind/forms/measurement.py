# SPDX-License-Identifier: Apache-2.0
"""Forms of what lies between the controllers' torque M and its log."""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from checks.blind.forms.form import Form, Range, Values, Write
from checks.reference import effect_table
from checks.reference.plant import Array

Change = Callable[[Array, int, Values, float], Array]


def logged(change: Change) -> Write:
    """Return a `write` of a change of a drive's log, see `reference.effect_table.logged`."""
    write = effect_table.logged(change)
    return lambda plant, i, values, seed: write(plant, i, values)


def delay(torque: Array, i: int, values: Values, cycle: float) -> Array:
    """Return a log whose clock beats with the controller's: its delay is a saw-tooth in time."""
    instants = np.arange(torque.shape[1]) * cycle
    beat = (instants / values['period']) % 1.0 - 0.5
    when = instants - values['time'] * (1.0 + values['depth'] * beat)
    return np.asarray(np.interp(when, instants, torque[i]))


def sinc(torque: Array, i: int, values: Values, cycle: float) -> Array:
    """Return the log of a converter that takes the mean over twice `time`."""
    width = 2.0 * values['time'] / cycle
    # Weights of a moving mean of any width: the last one is cut.
    taps = np.clip(width + 1.0 - np.arange(int(np.ceil(width)) + 1), 0.0, 1.0)
    taps /= taps.sum()
    start = np.full(taps.size - 1, torque[i, 0])
    return np.convolve(np.concatenate([start, torque[i]]), taps, mode='valid')


def butterworth(torque: Array, i: int, values: Values, cycle: float) -> Array:
    """Return the log behind a low-pass of second order; `time` is its delay at low frequency."""
    rate = 2.0 * values['damping'] / values['time']
    pole = rate * (-values['damping'] + 1j * np.sqrt(1.0 - values['damping'] ** 2))
    a = np.poly(np.exp(np.array([pole, pole.conjugate()]) * cycle)).real
    return np.asarray(torque[i, 0] + lfilter([a.sum()], a, torque[i] - torque[i, 0]))


def bias(torque: Array, i: int, values: Values, cycle: float) -> Array:
    """Return a log with a current sensor's offset, part of which comes as it warms."""
    time = np.arange(torque.shape[1]) * cycle
    warm = 1.0 - np.exp(-time / values['time'])
    return np.asarray(torque[i] + values['torque'] * (1.0 + values['warming'] * warm))


def crosstalk(torque: Array, i: int, values: Values, cycle: float) -> Array:
    """Return a log with what the others' currents leave in a shunt: unequal, behind a lag."""
    others = [j for j in range(torque.shape[0]) if j != i]
    weights = np.linspace(1.0 + values['uneven'], 1.0 - values['uneven'], len(others))
    mixed = effect_table.lagged(weights @ torque[others], values['lag'], cycle)
    return np.asarray(torque[i] + values['share'] * mixed)


def _filter(name: str, law: str, source: str, others: tuple[Range, ...], change: Change) -> Form:
    size = Range('time', 's', 2.1e-4, 4.6e-3, counterpart='time_constant')
    return Form(name, 'effort_filter', law, source, size, others, logged(change))


FORMS = (
    Form(
        'log.beating_delay',
        'effort_delay',
        'M(t - time (1 + depth saw(t / period)))',
        'Sivrikaya and Yener 2004, IEEE Network 18(4): clocks that are not synchronised',
        Range('time', 's', 2.2e-4, 5e-3, counterpart='delay'),
        (Range('depth', '1', 0.05, 0.4), Range('period', 's', 0.3, 2.5)),
        logged(delay),
    ),
    _filter(
        'log.mean',
        'mean of M over the last 2 time',
        'Candy and Temes 1992, Oversampling Delta-Sigma Converters: a sinc filter',
        (),
        sinc,
    ),
    _filter(
        'log.second_order',
        "M_log'' = w^2 (M - M_log) - 2 D w M_log', w = 2 D / time",
        'Butterworth 1930, Wireless Engineer 7; Oppenheim and Schafer 1989 for its samples',
        (Range('damping', '1', 0.55, 0.9),),
        butterworth,
    ),
    Form(
        'bias.warming',
        'effort_bias',
        'M + torque (1 + warming (1 - exp(-t / time)))',
        'Ripka 2001, Magnetic Sensors and Magnetometers, ch. 11: offset of Hall sensors drifts',
        Range('torque', 'N m', 0.005, 0.12, signed=True),
        (Range('warming', '1', -0.16, 0.16), Range('time', 's', 1.4, 6.0)),
        logged(bias),
    ),
    Form(
        'crosstalk.shunt',
        'effort_crosstalk',
        'M + share (weighted sum of the others behind a lag)',
        'Ott 2009, Electromagnetic Compatibility Engineering, ch. 3: common impedance',
        Range('share', '1', 0.01, 0.15, signed=True),
        (Range('uneven', '1', 0.1, 0.45), Range('lag', 's', 4e-4, 2.6e-3)),
        logged(crosstalk),
        needs='drives',
    ),
)
