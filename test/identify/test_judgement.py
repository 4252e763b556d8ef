# SPDX-License-Identifier: Apache-2.0
"""What is said of a result whose log contradicts the machine file, or that its model lacks."""

from dataclasses import replace
import math
from typing import Any

from identify_cases import (
    axis,
    axis_data,
    identified,
    QUICK,
)
import numpy as np
import pytest

from ros2_ident.errors import ErrorCode
from ros2_ident.identify.outcome import state_of
from ros2_ident.identify.result import bound_of, Identification, Outcome
from ros2_ident.identify.run import FLOORS, identify, LARGE, NOTE
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.machine.machine import Parameter
from ros2_ident.models.protocol import Output
from ros2_ident.words.identification import message


def wrong(**factors: float) -> Any:
    """Return the axis with other constants."""
    return axis().with_constants(**{k: v * axis().number(k) for k, v in factors.items()})


@pytest.fixture(scope='module')
def without_force_constant() -> Identification:
    """Return what the axis' log gives with a velocity gain in V instead of N."""
    return identify(wrong(velocity_gain=1.0 / 35.15065), axis_data(), settings=QUICK)


def test_a_wrong_gain_is_the_headline_and_nothing_is_identified(without_force_constant):
    result = without_force_constant
    assert result.outcome is Outcome.CONTRADICTED
    assert result.outcome.error_code is ErrorCode.CONTRADICTED
    assert message(result).startswith('emps_axis: your velocity_gain is 243.5; 85')
    assert message(result).endswith('No parameter is identified.')
    assert not any(p.identifiable for p in result.parameters)
    assert {p.note for p in result.parameters} == {NOTE}
    assert result.gates[0].key == 'velocity_gain'


def test_bounds_are_suspected_where_a_model_does_not_fit_and_nothing_is_none():
    good = identified()
    first, second, *rest = good.parameters
    end = replace(first, value=first.upper_bound, at_bound=True)
    none = replace(second, value=0.0, lower_bound=0.0, at_bound=True)
    found = replace(good, outcome=Outcome.CONTRADICTED, parameters=(end, none, *rest))
    said = message(found)
    assert f'No parameter is identified. {end.name} (' in said and none.name not in said
    assert said.endswith('lies at a bound: the true value can lie beyond; check the bounds in the '
                         'machine file.')  # fmt: skip


def test_a_gain_that_is_a_little_off_comes_first_and_leaves_the_result():
    result = identify(wrong(velocity_gain=1.05), axis_data(), settings=QUICK)
    assert message(result).startswith('emps_axis: your velocity_gain is 8985; 85')
    assert result.outcome is Outcome.IDENTIFIED
    assert message(result).endswith('All 4 parameters are identified.')


class Line:
    """A model that can be a straight line only."""

    outputs = (Output('line', 'N'),)
    parameters = (Parameter('slope', 'N/s', 0.0, 2.0, 'physical', ''),)
    cycle = 0.01

    def __init__(self, bent: float, noise: float, offset: float = 0.0) -> None:
        time = self.cycle * np.arange(2000)
        self._time = time / time[-1]
        random = noise * np.random.default_rng(0).standard_normal(time.size)
        self.measured = (self._time + bent * np.sin(9.0 * self._time) + random + offset)[None]

    def simulate(self, theta):
        return theta[:, :, None] * self._time


@pytest.mark.parametrize(
    ('bent', 'noise', 'offset', 'refused'),
    [
        (1.0, 0.01, 0.0, True),
        (0.05, 0.001, 0.0, False),  # tens of times the noise, a small share
        (0.0, 0.5, 0.0, False),  # a large share, noise all of it
        (0.0, 0.001, -0.2, False),  # a sensor's offset is no other machine's motion
    ],
)
def test_a_large_residual_is_one_of_the_effort_and_of_the_noise(bent, noise, offset, refused):
    model = Line(bent, noise, offset)
    result = identify(model=model, settings=QUICK)
    (slope,) = (p.value for p in result.parameters)
    left = (model.measured - model.simulate(np.array([[slope]]))[0]).std()
    share = left / float(model.measured.std())
    assert (share > LARGE and left > FLOORS * noise) == refused
    assert (result.outcome is Outcome.CONTRADICTED) == refused
    if refused:
        assert f'The model leaves {100.0 * share:.0f} % of what varies in line' in message(result)


@pytest.mark.parametrize(('least', 'refused'), [(1.0, True), (0.0, False)])
def test_a_model_that_leaves_more_than_all_of_what_varies_is_refused(least, refused):
    # An effort that is hardly measured, and links that have to be carried all the same.
    model = Line(0.0, 0.2)
    model.measured = model.measured - np.linspace(0.0, 1.0, model.measured.size)
    model.parameters = (Parameter('slope', 'N/s', least, 2.0, 'physical', ''),)
    result = identify(model=model, settings=QUICK)
    assert (result.outcome is Outcome.CONTRADICTED) == refused
    assert ('The model leaves 17' in message(result)) == refused


# ---------------------------------------------------------------------- what is identified

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
        ((1.7, 2.4), 'identified', 'between 1.7 and 2.4 kg'),
        ((1.6, 2.5), 'bounded', 'between 1.6 and 2.5 kg'),
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


def test_an_inertia_below_zero_is_called_impossible():
    model = Drive(-40.0, 3.0)
    rotor = Parameter('elbow.drive_inertia', 'kg m^2', -100.0, 100.0, 'base', '')
    model.parameters = (rotor, *model.parameters[1:])
    result = found(model)
    assert result.parameters[0].note == 'physically impossible, below 0'
    (warning,) = [x for x in result.quality.warnings if 'physically impossible' in x]
    assert warning.startswith('elbow.drive_inertia: ')
    assert warning.endswith('correct the description or effort_unit')
