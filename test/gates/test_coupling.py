# SPDX-License-Identifier: Apache-2.0
"""A joint of an arm is told from a machine of its own, and a diagnosis then names no effect."""

from identify_cases import axis, axis_bag, joint, recording_of
import numpy as np
import pytest

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.data import gather
from ros2_ident.recording import Recording, Stream
from ros2_ident.words.verdict import sentence

RATE, SECONDS = 250.0, 20.0
# Of an arm, as an axis of its own.
ELBOW = joint('elbow', 0.05)


def swing(seed: int) -> tuple[np.ndarray, ...]:
    """Return position, velocity and acceleration of a joint (T,) as a sum of slow waves."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    rates = 2.0 * np.pi * random.uniform(0.1, 0.8, 6)
    phases, sizes = random.uniform(0.0, 6.28, 6), random.uniform(0.1, 0.4, 6)
    angles = rates[:, None] * time + phases[:, None]
    terms = sizes * np.sin(angles.T), sizes * rates * np.cos(angles.T)
    change = -(sizes * rates**2 * np.sin(angles.T)).sum(axis=1)
    return terms[0].sum(axis=1), terms[1].sum(axis=1), change


def recording(gravity: float) -> Recording:
    """Return an elbow behind a shoulder; gravity acts by the sum of both angles."""
    (shoulder, _, _), (elbow, speed, change) = swing(1), swing(2)
    effort = 2.0 * change + 3.0 * np.tanh(speed / 0.01) + 4.0 * speed
    effort += gravity * np.cos(shoulder + elbow)
    effort += 0.05 * np.random.default_rng(3).standard_normal(effort.size)
    stamp = (np.arange(effort.size) * 1e9 / RATE).astype(np.int64)
    state = Stream(
        ('shoulder', 'elbow'),
        stamp,
        position=np.stack([shoulder, elbow], axis=1),
        effort=np.stack([0.0 * effort, effort], axis=1),
    )
    return Recording(state=state, source='arm')


def test_what_no_effect_makes_a_model_carry_is_another_machine():
    data = gather([recording(60.0)], ELBOW)
    found = diagnose(ELBOW, data.datasets)
    assert (found.effect, found.where) == ('model', ('elbow',))
    assert sentence(found).startswith('The model is not the one of this machine: ')
    assert sentence(found).endswith('No effect is named.')
    assert (found.also, found.confusable, found.ranking) == ((), (), ())
    assert found.complete


@pytest.mark.parametrize(
    ('factor', 'effect', 'first'),
    [(1.0 / 35.15, 'bookkeeping', True), (1.3, 'velocity_gain_error', False)],
)
def test_a_gain_comes_before_any_effect(factor, effect, first):
    machine = axis().with_constants(velocity_gain=factor * axis().number('velocity_gain'))
    data = gather([recording_of(axis_bag(6.0))], machine)
    kept = {'velocity_gain_error', 'position_gain_error', 'backlash', 'stribeck'}
    found = diagnose(machine, data.datasets, without=[e for e in CATALOGUE if e not in kept])
    assert found.effect == effect
    assert sentence(found).startswith('emps_axis: your velocity_gain is ')
    assert sentence(found).endswith('No effect is named.') == first
