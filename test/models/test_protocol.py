# SPDX-License-Identifier: Apache-2.0
"""Any model that meets the protocol is identified and diagnosed, on one recording or several."""

import numpy as np
import pytest
from values import parameter

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.layout import Conditions, read_conditions
from ros2_ident.identify.result import Outcome
from ros2_ident.identify.run import identify
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.machine.machine import Parameter
from ros2_ident.models.protocol import complete, Model, Output
from ros2_ident.search import GeneticSettings

SMALL = IdentifySettings(genetic=GeneticSettings(initial_population=64, generations=4))


class Pendulum:
    """A pendulum whose torque is recorded while it is moved: thirty lines, no import of ours."""

    cycle = 0.002
    noise = 0.02
    parameters = (
        Parameter('inertia', 'kg m^2', 0.01, 1.0, 'physical', 'Newton'),
        Parameter('weight', 'N m', 0.1, 10.0, 'physical', 'm g l'),
        Parameter('damping', 'N m s', 0.0, 1.0, 'physical', 'viscous'),
    )
    outputs = (Output('shaft', 'N m'),)

    def __init__(self, truth, seed, cubic=0.0, load=0.0):
        time = np.arange(3000) * self.cycle
        draw = np.random.default_rng(seed)
        waves = [(a, 6.0 * np.pi * f) for a, f in zip(*draw.random((2, 4)), strict=True)]
        self.angle = sum(a * np.sin(w * time) for a, w in waves)
        self.rate = sum(a * w * np.cos(w * time) for a, w in waves)
        self.bend = sum(-a * w * w * np.sin(w * time) for a, w in waves)
        torque = self.simulate(np.array([truth]))[0, 0] + cubic * self.rate**3
        torque += load * np.sin(self.angle)
        self.measured = (torque + self.noise * draw.standard_normal(time.size))[None]
        self.measured[0, ::2] = np.nan  # every second sample was logged

    def simulate(self, theta):
        inertia, weight, damping = theta.T[:, :, None]
        torque = inertia * self.bend + weight * np.sin(self.angle) + damping * self.rate
        return torque[:, None, :]


TRUTH = np.array([0.2, 3.0, 0.1])


def test_an_object_of_one_s_own_is_a_model():
    pendulum = Pendulum(TRUTH, 1)
    assert isinstance(pendulum, Model)
    found = identify(model=pendulum, settings=SMALL, seed=1)
    assert found.outcome is Outcome.IDENTIFIED
    assert found.model == 'Pendulum'
    for estimate, true in zip(found.parameters, TRUTH, strict=True):
        assert estimate.low <= true <= estimate.high
    assert found.best_cost == pytest.approx(pendulum.noise, rel=0.05)


class Uneven(Pendulum):
    """Every second second hardly shows its inertia."""

    def __init__(self, shown):
        super().__init__(TRUTH, 5)
        time = np.arange(self.bend.size) * self.cycle
        self.bend = self.bend * np.where((time // 1.0) % 2.0 == shown, 1.0, 2e-3)
        noise = self.noise * np.random.default_rng(7).standard_normal(time.size)
        self.measured = self.simulate(np.array([TRUTH]))[0] + noise


@pytest.mark.parametrize('shown', [0.0, 1.0])
def test_what_blocks_fitted_on_do_not_show_is_no_gap_of_the_others(shown):
    found = diagnose(model=Uneven(shown), seed=1)
    assert found.effect == 'none'
    assert found.evidence['size'] < found.evidence['material']


def test_it_is_diagnosed():
    nothing = diagnose(model=Pendulum(TRUTH, 1), check_model=Pendulum(TRUTH, 2), seed=1)
    assert nothing.effect == 'none'

    def found(cubic):
        both = [Pendulum(TRUTH, number, cubic=cubic) for number in (1, 2)]
        return diagnose(model=both[0], check_model=both[1], seed=1)

    cubic = found(2e-4)
    assert cubic.effect == 'unknown'
    # What misses more than half of the torque is another machine.
    assert found(2e-3).effect == 'unknown'
    assert found(2e-2).effect == 'model'
    assert cubic.where == ('shaft',)
    assert cubic.unit == 'N m'
    assert cubic.per_drive['shaft'].before > 1.5 * cubic.per_drive['shaft'].noise_floor


def test_held_and_bounded_parameters_and_the_protocol_s_refusals():
    pendulum = Pendulum(TRUTH, 1)
    found = identify(
        model=pendulum, fixed={'damping': 0.1}, bounds={'inertia': (0.1, 0.3)}, settings=SMALL
    )
    assert [p.name for p in found.parameters] == ['inertia', 'weight']
    assert found.parameters[0].upper_bound == 0.3
    assert found.fixed == {'damping': 0.1}
    with pytest.raises(IdentError, match="'mass' cannot be fixed") as caught:
        identify(model=pendulum, fixed={'mass': 1.0})
    assert caught.value.code is ErrorCode.UNKNOWN_PARAMETER
    with pytest.raises(IdentError, match='is no model: it has no outputs, cycle'):
        complete(type('Half', (), {'parameters': (), 'measured': 0, 'simulate': 0})())

    class Wrong(Pendulum):
        def simulate(self, theta):
            return super().simulate(theta)[:, 0]

        def __init__(self):
            self.__dict__.update(pendulum.__dict__)

    with pytest.raises(IdentError, match=r'it has to return \(\d+, 1, 3000\)'):
        identify(model=Wrong(), settings=SMALL)


def test_a_parameter_can_have_a_value_of_its_own_in_every_recording():
    bags = [Pendulum(TRUTH, 1), Pendulum(TRUTH, 2, load=0.8)]
    shared = identify(model=bags, settings=SMALL, seed=1)
    assert shared.best_cost > 3.0 * bags[0].noise
    found = identify(model=bags, conditions=Conditions(each=('weight',)), settings=SMALL, seed=1)
    assert [p.name for p in found.parameters] == ['inertia', 'weight@1', 'weight@2', 'damping']
    assert found.best_cost == pytest.approx(bags[0].noise, rel=0.05)
    first, second = (parameter(found, f'weight@{n}') for n in (1, 2))
    assert first.low <= 3.0 <= first.high
    assert second.low <= 3.8 <= second.high


def test_what_is_known_to_differ_is_taken_into_account():
    bags = [Pendulum(TRUTH, 1), Pendulum(TRUTH, 2, load=0.8)]
    known = Conditions(known={'2': {'weight': 0.8}})
    found = identify(model=bags, conditions=known, settings=SMALL, seed=1)
    weight = parameter(found, 'weight')
    assert weight.low <= 3.0 <= weight.high
    assert found.best_cost == pytest.approx(bags[0].noise, rel=0.05)


def test_a_recording_without_a_sample_is_told_by_its_number():
    empty = Pendulum(TRUTH, 2)
    empty.measured = np.full_like(empty.measured, np.nan)
    with pytest.raises(IdentError, match='recording 2 of 2 has no effort sample; leave it out'):
        identify(model=[Pendulum(TRUTH, 1), empty], settings=SMALL)


def test_conditions_that_make_no_sense_are_refused(tmp_path):
    pendulum = Pendulum(TRUTH, 1)
    for conditions, text in (
        (Conditions(each=('weight',)), 'one recording only'),
        (Conditions(known={'other': {'weight': 1.0}}), "no recording is called 'other'"),
    ):
        with pytest.raises(IdentError, match=text):
            identify(model=pendulum, conditions=conditions, settings=SMALL)
    pair = [pendulum, Pendulum(TRUTH, 2)]
    with pytest.raises(IdentError, match="'colour' cannot have a value for each recording"):
        identify(model=pair, conditions=Conditions(each=('colour',)), settings=SMALL)
    path = tmp_path / 'differences.yaml'
    for content in ('- a\n', 'bag: 1\n', 'bag: {weight: heavy}\n', 'bag: [\n'):
        path.write_text(content)
        with pytest.raises(IdentError, match='write what differs in each bag'):
            read_conditions((), path)
    path.write_text('with_load: {tool_mass: 0.5}\n')
    assert read_conditions(('a',), path) == Conditions(('a',), {'with_load': {'tool_mass': 0.5}})
