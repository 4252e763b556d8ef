# SPDX-License-Identifier: Apache-2.0
"""One frequency tells no effect from the parameters that do the same there."""

import numpy as np

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


def diagnosed(place: np.ndarray, width: float) -> Diagnosis:
    """Diagnose a cart of which friction takes a speed `width` [m/s] to build up."""
    rng = np.random.default_rng(5)
    speed = np.gradient(place, CYCLE)
    force = 6.5 * np.gradient(speed, CYCLE) + 5.0 * np.tanh(speed / width) + 12.0 * speed + 0.7
    force += NOISE * rng.standard_normal(place.size)
    place = place + 1e-6 * rng.standard_normal(place.size)
    log = Dataset(('cart',), CYCLE, 0, None, None, place[None], None, force[None])
    return diagnose(CART, [log], seed=1)


def test_one_frequency_gives_a_tie_and_several_a_name() -> None:
    time = CYCLE * np.arange(6000)
    one = diagnosed(0.2 * np.sin(9.0 * time), 0.03)
    assert one.facts.cause == Cause.UNKNOWN and one.also == ()
    assert 'cable_spring' in {tie.effect for tie in one.facts.ties if tie.own < 0.05}
    assert 'that this motion cannot tell' in sentence(one)
    assert next(advice(one)).startswith('Tell it from the parameters: ')
    several = 0.1 * (np.sin(0.7 * time) + np.sin(2.3 * time) + 0.4 * np.sin(9.0 * time))
    named = diagnosed(several, 0.2)
    assert (named.effect, named.where) == ('degressive_friction', ('cart',))
    assert named.probability > 0.5
