# SPDX-License-Identifier: Apache-2.0
"""One frequency or one speed tells no effect from something else that does the same there."""

import numpy as np
import scipy

from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.result import Cause, Diagnosis
from ros2_ident.models import machine_from_mapping
from ros2_ident.recording import Dataset
from ros2_ident.words.verdict import advice, sentence

CYCLE, NOISE = 0.002, 0.1
CART = machine_from_mapping(
    {
        'machine': 'linear_axis',
        'drives': ['cart'],
        'controller': {'cycle': CYCLE},
        'parameters': {
            'moving_mass': [0.0, 40.0, 'kg'],
            'coulomb_friction': [0.0, 30.0, 'N'],
            'viscous_friction': [0.0, 90.0, 'N s/m'],
            'constant_force': [-20.0, 20.0, 'N'],
            'measurement_delay': [0.0, 0.004, 's'],
        },
    }
)


def diagnosed(place: np.ndarray, width: float, late: float = 0.0) -> Diagnosis:
    """Diagnose a cart of which friction takes a speed `width` [m/s], and is `late` [s]."""
    rng = np.random.default_rng(5)
    speed, time = np.gradient(place, CYCLE), CYCLE * np.arange(place.size)
    then = np.interp(time - late, time, speed)
    force = 6.5 * np.gradient(speed, CYCLE) + 5.0 * np.tanh(then / width) + 12.0 * then + 0.7
    force += NOISE * rng.standard_normal(place.size)
    place = place + 1e-6 * rng.standard_normal(place.size)
    log = Dataset(('cart',), CYCLE, 0, None, None, place[None], None, force[None])
    return diagnose(CART, [log], seed=1)


def test_one_frequency_gives_a_tie_and_several_a_name() -> None:
    time = CYCLE * np.arange(6000)
    one = diagnosed(0.2 * np.sin(9.0 * time), 0.03)
    assert one.facts.cause == Cause.UNKNOWN and one.also == ()
    assert ('cable_spring', ('parameters',)) in {(x.effect, x.like[:1]) for x in one.facts.ties}
    assert 'that this motion cannot tell' in sentence(one)
    assert next(advice(one)).startswith('Tell them apart: ')
    several = 0.1 * (np.sin(0.7 * time) + np.sin(2.3 * time) + 0.4 * np.sin(9.0 * time))
    named = diagnosed(several, 0.2)
    assert (named.effect, named.where) == ('degressive_friction', ('cart',))
    assert named.probability > 0.5


def test_reversals_that_are_all_alike_do_not_tell_way_from_time() -> None:
    time = CYCLE * np.arange(6000)
    triangle = 0.1 * scipy.signal.sawtooth(2.0 * np.pi * time / 1.5, 0.5)
    rounded = scipy.ndimage.uniform_filter1d(triangle, 60)
    alike = diagnosed(scipy.ndimage.uniform_filter1d(rounded, 60), 0.002, 0.012)
    assert alike.facts.cause == Cause.UNKNOWN and alike.also == ()
    (tie,) = [tie for tie in alike.facts.ties if tie.effect == 'presliding']
    assert 'time since reversal' in tie.like and tie.closed > 0.95
    assert 'the time since reversal do about as well' in sentence(alike)
