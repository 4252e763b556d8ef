# SPDX-License-Identifier: Apache-2.0
"""What is called identified, what bounded and what not determined, and the words for it."""

import math

import numpy as np
import pytest

from ros2_ident.identify.certainty import state_of
from ros2_ident.identify.result import bound_of, Outcome
from ros2_ident.identify.run import identify
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.machine.parameter import Parameter
from ros2_ident.models.protocol import Output
from ros2_ident.words.identification import message

TIME = 1e-2 * np.arange(400)
SPEED = np.cos(3.0 * TIME)
NOISE = 0.3 * np.random.default_rng(1).normal(size=TIME.size)


class Drive:
    """A mass on a spring with friction, straight in all of them; the noise is `NOISE`.

    Args:
        truth: Mass and friction.
        absent: What a mass and what friction of nothing is called.
    """

    cycle = 1e-2
    outputs = (Output('drive', 'N', 1.0),)

    def __init__(self, *truth):
        self.rows = np.stack([np.sin(3.0 * TIME), np.sign(SPEED), np.ones(TIME.size)])
        self.measured = (np.array([*truth, 50.0]) @ self.rows + NOISE)[None]
        self.parameters = (
            Parameter('mass', 'kg', 0.0, 100.0, 'physical', ''),
            Parameter('friction', 'N', 0.0, 100.0, 'physical', '', absent=0.0),
            Parameter('load', 'N', -100.0, 100.0, 'base', ''),
        )

    def simulate(self, theta):
        return (theta @ self.rows)[:, None]


def found(model):
    return identify(model=model, settings=IdentifySettings(method='algebraic', decimation=1))


@pytest.mark.parametrize(
    ('interval', 'state', 'words'),
    [
        ((1.5, 2.4), 'identified', 'between 1.5 and 2.4 kg'),
        ((0.5, 4.0), 'bounded', 'between 0.5 and 4 kg'),
        ((-3.0, 4.0), 'bounded', 'at most 4 kg'),
        ((1.0, 11.0), 'bounded', 'at least 1 kg'),
        ((-3.0, 11.0), 'not determined', ''),
        ((-math.inf, math.inf), 'not determined', ''),
        ((math.nan, math.nan), 'not determined', ''),
    ],
)
def test_an_interval_is_held_against_value_and_box(interval, state, words):
    assert state_of(2.0, *interval, 0.0, 10.0) == state
    assert bound_of(*interval, 0.0, 10.0, 'kg') == words


def test_an_interval_that_leaves_half_of_a_narrow_box_open_identifies_nothing():
    assert state_of(100.0, 99.0, 101.0, 98.5, 101.5) == 'bounded'


def test_no_friction_is_an_answer_and_no_mass_is_none():
    result = found(Drive(0.0, 0.0))
    mass, friction, load = result.parameters
    assert (mass.state, friction.state, load.state) == ('bounded', 'identified', 'identified')
    assert mass.value >= 0.0 and friction.value >= 0.0
    assert mass.note.startswith(f'at most {mass.high:.3g} kg')
    assert friction.note.startswith(f'at most {friction.high:.3g} N: below 1 % of the output')
    assert load.note == 'base parameter, of either sign'
    assert result.outcome is Outcome.NOT_IDENTIFIABLE
    assert f'1 of 3 parameters: mass ({mass.bound}); record' in message(result)


def test_friction_that_may_matter_is_not_called_nothing():
    model = Drive(5.0, 0.05)
    model.measured = model.measured - 50.0 + 8.0 * NOISE
    friction = found(model).parameters[1]
    assert friction.state == 'bounded' and friction.note.startswith('at most ')


def test_all_of_it_is_identified():
    result = found(Drive(5.0, 3.0))
    assert message(result) == 'All 3 parameters are identified.'
    assert [p.note for p in result.parameters[:2]] == ['', '']
