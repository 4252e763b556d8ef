# SPDX-License-Identifier: Apache-2.0
"""What the diagnosis answers, rule by rule, on fits made of numbers."""

import math
from types import SimpleNamespace

from gap_fits import (
    Attribution,
    DRAG,
    DRIVES,
    explainer_of,
    floor_of,
    found,
    made,
    of_round,
    RULES,
    SPRING,
    STRIBECK,
)
import numpy as np
import pytest

from ros2_ident.gap.explain import Explainer
from ros2_ident.gap.reading import CoarseReading
from ros2_ident.gap.verdict import (
    judge,
    NONE,
    Temperatures,
    UNKNOWN,
)
from ros2_ident.models import EffectAt


@pytest.fixture
def attribution():
    return Attribution()


@pytest.fixture
def explainer(attribution):
    return explainer_of(attribution)


# ---------------------------------------------------------------------- limits


def test_an_effort_that_stays_below_what_is_asked_names_its_limit(explainer):
    chain = [made((2.0, 2.0)), made((1.5, 1.5), effects=[DRAG])]
    assert answered(explainer, chain, [chain[-1]], remaining=1.2).effect == UNKNOWN
    explainer.attribution.limits = {'one': 0.4}
    said = answered(explainer, chain, [chain[-1]], remaining=1.2)
    assert said.named == (EffectAt('torque_saturation', 'one'), DRAG)
    assert (said.probability, said.limits) == (0.9, {'one': 0.4})


def test_every_drive_with_a_limit_is_named_and_what_stood_in_for_it_is_not(explainer):
    beside = EffectAt('backlash', 'all')
    base, one = made((2.0, 2.0)), made((1.8, 1.8), effects=[STRIBECK])
    chain = [base, one, made((1.5, 1.5), effects=[STRIBECK, beside])]
    explainer.attribution.limits = {'one': 0.4, 'two': 0.3}
    rests, rivals = [one, one], [chain[-1]]
    said = answered(explainer, chain, [one], rivals, rests, remaining=1.2)
    limits = tuple(EffectAt('torque_saturation', drive) for drive in DRIVES)
    assert said.named == (*limits, beside)
    assert said.limits == {'one': 0.4, 'two': 0.3}
    cut = answered(explainer, chain, [one], rivals, rests, remaining=1.2, complete=False)
    assert cut.effect == UNKNOWN
    # What is named otherwise stays.
    closed = [base, made((0.0, 0.0), effects=[DRAG])]
    assert answered(explainer, closed, [closed[-1]]).named == (DRAG,)


# ---------------------------------------------------------------------- the answer


SHARP = Temperatures(size=1e-3, closed=1e-3)


def answered(explainer, chain, fitted=(), rivals=None, rests=None, **more):
    rounds = [of_round(chain[0], *fitted)] if fitted else []
    rivals = tuple(fitted) if rivals is None else rivals
    got = found(chain, rounds, rivals, [chain[0]] if rests is None else rests, **more)
    return judge(explainer, got, temperatures=SHARP)


def test_a_gap_that_is_not_material_is_none(explainer):
    said = answered(explainer, [made((0.2, 0.0))])
    assert (said.effect, said.where) == (NONE, ())
    assert said.probability == pytest.approx(1.0, abs=1e-6)


def test_a_small_gap_that_nothing_explains_is_none_and_a_large_one_unknown(explainer):
    assert answered(explainer, [made((0.6, 0.0))]).effect == NONE
    said = answered(explainer, [made((0.7, 0.0))])
    assert (said.effect, said.where) == (UNKNOWN, ('one',))
    assert said.probability == pytest.approx(0.88)
    assert answered(explainer, [made((0.7, 0.34))]).where == ('one',)
    assert answered(explainer, [made((0.7, 0.36))]).where == ('all',)
    cut = answered(explainer, [made((0.7, 0.0))], complete=False)
    assert (cut.effect, cut.probability) == (UNKNOWN, 0.0)


@pytest.mark.parametrize(
    ('left', 'remaining', 'effect'),
    [(0.7, 0.84, 'stribeck'), (0.9, 0.95, UNKNOWN), (0.9, 0.79, 'stribeck')],
)
def test_a_name_is_believed_where_enough_closes_or_little_is_left(
    explainer, left, remaining, effect
):
    base, one = made((2.0, 0.0)), made((left, 0.0), effects=[STRIBECK])
    said = answered(explainer, [base, one], [one], remaining=remaining)
    assert said.effect == effect
    assert said.closed == pytest.approx((2.0 - left) / 2.0)
    if effect != UNKNOWN:
        assert said.where == ('one',)
        assert said.probability > 0.85


def test_what_closes_nearly_as_much_cannot_be_told_apart(explainer):
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[STRIBECK])
    near, far = made((0.19, 0.0), effects=[DRAG]), made((0.21, 0.0), effects=[SPRING])
    said = answered(explainer, [base, one], [one, near, far])
    assert [w.at for w in said.confusable] == [STRIBECK, DRAG]
    assert all(any(w is x for x in said.ranking) for w in said.confusable)


def test_twins_are_one_answer_under_two_names(explainer):
    force, bias = EffectAt('constant_force', 'one'), EffectAt('effort_bias', 'one')
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[force])
    said = answered(explainer, [base, one], [one, made((0.3, 0.0), effects=[bias])])
    assert (said.effect, [w.at for w in said.confusable]) == ('constant_force', [force, bias])
    each = [w.probability for w in said.ranking]
    assert each[0] == each[1]
    assert said.probability == sum(each) > 0.85
    twin, third = made((0.3, 0.0), effects=[bias]), made((0.4, 0.0), effects=[DRAG])
    said = answered(explainer, [base, one], [one, twin, third])
    weights = {w.at: w.probability for w in said.ranking}
    mean = 0.5 * (0.02**-5 + 0.17**-5)
    assert weights[force] / weights[DRAG] == pytest.approx(mean / 0.22**-5)
    # One that was not fitted stands beside it all the same.
    said = answered(explainer, [base, one], [one])
    assert [w.at for w in said.confusable] == [force, bias]
    assert said.confusable[1].probability == said.confusable[0].probability


def test_further_effects_are_told_in_their_order(explainer):
    base, one = made((2.0, 2.0)), made((0.0, 2.0), effects=[STRIBECK])
    both = made((0.0, 0.0), effects=[STRIBECK, DRAG])
    said = answered(explainer, [base, one, both], [one], [both], [made((2.0, 0.0)), one])
    assert (said.effect, said.also) == ('stribeck', (DRAG,))
    # The first one is weighed by the fit that has both.
    assert [(w.at, w.model) for w in said.ranking] == [(STRIBECK, both)]


# ---------------------------------------------------------------------- steps of encoders


STEPS = EffectAt('encoder_quantisation', 'one')


def read_coarsely(explainer, chain, *drives, remaining=0.0):
    readings = [CoarseReading(drive, 1e-4, 1e-6, 100.0) for drive in drives]
    rests = tuple(chain[:-1])[-len(chain[-1].effects) :] or (chain[0],)
    got = found(chain, [], [(chain[-1],)] * len(rests), rests, remaining)
    return judge(explainer, got, readings, SHARP)


def test_steps_of_an_encoder_are_the_answer_where_its_drive_has_the_gap(explainer):
    said = read_coarsely(explainer, [made((2.0, 0.1))], 'one')
    assert (said.effect, said.where, said.also) == (STEPS.effect, ('one',), ())
    assert said.probability == pytest.approx(0.95)
    assert [r.drive for r in said.readings] == ['one']
    small = found([made((0.54**2, 0.0))])
    unsure = judge(explainer, small, [CoarseReading('one', 1e-4, 1e-6, 100.0)])
    assert unsure.probability == pytest.approx(0.95 / (1.0 + math.exp(-1.0)))
    both = read_coarsely(explainer, [made((2.0, 3.0))], 'one', 'two')
    assert (both.where, both.also) == (('two',), (STEPS,))


def test_steps_on_a_drive_without_a_gap_are_no_answer(explainer):
    for chain in ([made((2.0, 0.2))], [made((0.2, 0.0))]):
        said = read_coarsely(explainer, chain, 'two')
        assert said.effect in (UNKNOWN, NONE) and said.readings == ()


def test_more_than_steps_is_missing_where_another_drive_has_a_gap(explainer):
    assert read_coarsely(explainer, [made((2.0, 0.6))], 'one').effect == STEPS.effect
    said = read_coarsely(explainer, [made((2.0, 0.7))], 'one')  # 0.8 squared is 0.64
    assert (said.effect, said.readings) == (UNKNOWN, ())


def test_an_effect_is_named_where_only_steps_are_left(explainer):
    """It closes too little to be believed, for the steps' part of the gap cannot be closed."""
    base, one = made((1.9, 2.0)), made((1.9, 0.0), effects=[DRAG])
    assert answered(explainer, [base, one], [one], remaining=1.9).effect == UNKNOWN
    said = read_coarsely(explainer, [base, one], 'one', remaining=1.9)
    assert (said.effect, said.where, said.also) == ('quadratic_drag', ('two',), (STEPS,))
    # Not where the other drive keeps a gap of its own.
    base, one = made((1.9, 4.0)), made((1.9, 0.9), effects=[DRAG])
    said = read_coarsely(explainer, [base, one], 'one', remaining=1.9)
    assert (said.effect, said.also) == (UNKNOWN, (STEPS,))


# ---------------------------------------------------------------------- what is left to tell


def test_a_floor_that_is_no_noise_is_something_unknown(explainer):
    explainer.floor = floor_of(1.0, restless=('two',))
    base = made((0.3**2, 0.0))
    said = judge(explainer, found([base]))
    assert (said.effect, said.where, said.probability) == (UNKNOWN, ('two',), 0.7)
    assert said.restless == {'two': 1.0}
    explainer.floor = floor_of(1.0, restless=('one', 'two'))
    assert judge(explainer, found([base])).where == ('all',)
    assert judge(explainer, found([base], complete=False)).effect == NONE
    explainer.attribution.machine = SimpleNamespace(stated=lambda name: True)
    assert judge(explainer, found([base])).restless == {'one': 1.0, 'two': 1.0}
    # A noise that the machine file does not state says nothing.
    explainer.attribution.machine = SimpleNamespace(stated=lambda name: False)
    assert judge(explainer, found([base])).restless == {'one': 0.0, 'two': 0.0}
    # Below a frequency all noise is slow.
    explainer.attribution.thinned = True
    assert judge(explainer, found([base])).effect == NONE
    # What is left to explain goes first.
    assert not judge(explainer, found([made((2.0, 0.0))])).restless


@pytest.mark.parametrize(('high', 'said'), [(1.05, 'unknown'), (1.2, 'none')])
def test_what_noise_may_be_is_nothing_unknown(attribution, high, said):
    # 0.9 of the noise are left, and what is called noise may be larger.
    floor = floor_of(1.0)
    floor.high = np.full(2, high)
    verdict = answered(Explainer(attribution, floor, RULES), [made((0.81, 0.0))])
    assert verdict.effect == said
