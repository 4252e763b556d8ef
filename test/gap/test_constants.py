# SPDX-License-Identifier: Apache-2.0
"""A number that the machine file states wrong is found, with what fits instead."""

import math

from identify_cases import axis, recording_of, ROOT, theta_of, tripod, tripod_bag, TRIPOD_TRUTH
import numpy as np
import pytest

from gap.test_servo import dataset, MACHINE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.fitter import Fitter
from ros2_ident.gap.recordings import recordings_of, Split
from ros2_ident.gap.suspects.constants import fitted_constants
from ros2_ident.identify.data import gather
from ros2_ident.identify.run import read_data
from ros2_ident.words.verdict import sentence


@pytest.mark.parametrize(('name', 'factor'), [('rail_mass', 1.4), ('velocity_feedforward', 0.95)])
def test_a_wrong_number_is_found_beside_the_parameters(name: str, factor: float) -> None:
    true = tripod().number(name)
    machine = tripod().with_constants(**{name: factor * true})
    data = gather([recording_of(tripod_bag())], machine).datasets
    fits = Fitter(Split(recordings_of(machine, data)), np.full(3, machine.effort_noise))
    parameters = fits.split.fit.with_effects(()).parameters
    base = fits.refit((), theta_of([p.name for p in parameters], TRIPOD_TRUTH))
    found, _ = min(fitted_constants(fits.fits, base), key=lambda one: one[1].loss)
    assert (found.key, found.stated) == (name, pytest.approx(factor * true))
    assert found.low < true < found.high
    assert found.high - found.low < 0.1 * true


def test_a_servo_with_another_load_than_stated_is_told_which() -> None:
    true = MACHINE.number('load_mass')
    wrong = MACHINE.with_constants(load_mass=0.5 * true)
    found = diagnose(wrong, [dataset(7)], [dataset(8)], seed=1)
    assert found.effect == 'bookkeeping' and 'load_mass is ' in sentence(found)
    mass = found.parameters['load_mass']
    assert mass.low < true < mass.high
    *_, before, after = found.prediction.stages
    # The armature makes up for the load in this motion: either may come first.
    assert after.label.partition(' ')[0] in {one.key for one in found.facts.constants}
    assert after.errors[0].rmse < 0.5 * before.errors[0].rmse


def test_a_number_that_is_off_by_what_does_not_count_is_given_and_not_named() -> None:
    true = MACHINE.number('load_mass')
    wrong = MACHINE.with_constants(load_mass=0.997 * true)
    found = diagnose(wrong, [dataset(7)], [dataset(8)], seed=1)
    assert found.effect == 'none'
    assert 'Or load_mass of the machine file is wrong: ' in sentence(found)
    mass = found.parameters['load_mass']
    assert mass.low < true < mass.high < 1.01 * true


def test_the_bundled_axis_needs_no_limit() -> None:
    # Bounds of effects follow the logged effort.
    fit = read_data(str(ROOT / 'bags/axis_reversals'), axis()).datasets
    machines = axis(), axis().with_constants(torque_limit=math.inf)
    stated, unstated = (diagnose(m, fit, seed=1) for m in machines)
    assert (unstated.effect, unstated.where) == (stated.effect, stated.where)
    assert sentence(unstated) == sentence(stated)
    assert unstated.not_testable == stated.not_testable
    for name, value in stated.parameters.items():
        # The fits' slopes are differences: processors differ by their rounding.
        rounding = 1e-6 * (value.high - value.low)
        assert unstated.parameters[name].value == pytest.approx(value.value, abs=rounding)
