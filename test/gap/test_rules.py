# SPDX-License-Identifier: Apache-2.0
"""The rules of the diagnosis, one by one, on fits made of numbers: nothing is simulated here."""

from dataclasses import replace
import math
from pathlib import Path
import re
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_ident.effects import get_effect
from ros2_ident.gap.attribute import Round
from ros2_ident.gap.explain import Explained, Explainer, Rules
from ros2_ident.gap.fits import Explanation
from ros2_ident.gap.reading import CoarseReading
from ros2_ident.gap.verdict import judge, NONE, Temperatures, UNKNOWN
from ros2_ident.models import EffectAt

ROOT = Path(__file__).parents[2]
DRIVES = ('one', 'two')
SAMPLES = 1000
RULES = Rules(
    material=0.5, unknown=0.8, step=0.4, share=0.1, closed=0.6, rival=0.1, alike=0.02, most=3
)
STRIBECK, DRAG = EffectAt('stribeck', 'one'), EffectAt('quadratic_drag', 'two')


def made(gap, effects=()):
    """Return a fit that leaves a mean square beyond the noise's on each of two drives."""
    fit = SAMPLES * (1.0 + np.array(gap, dtype=float))
    own = sum(len(get_effect(at.effect).parameters) for at in effects)
    theta = np.array([1.0, 2.0] + [0.5] * own)
    empty = np.empty(0)
    return Explanation(tuple(effects), theta, fit, fit, *([empty] * 4))


def floor_of(variance, restless=()):
    """Return a floor whose noise has a variance that many times its innovation's."""
    noise = SimpleNamespace(variance=0.1 * variance, innovation=0.1)
    return SimpleNamespace(
        noise=(noise, noise),
        per_drive=np.ones(2),
        high=np.ones(2),
        restless=lambda drives, stated: {d: 10.0 * stated for d in drives if d in restless},
    )


def found(chain, rounds=(), rivals=(), rests=(), remaining=0.0, complete=True):
    return Explained(tuple(chain), tuple(rounds), tuple(rivals), tuple(rests), remaining, complete)


def scaled(at):
    """Return an effect's parameters, all in shares of one."""
    return [replace(p, low=-1.0, high=1.0, neutral=0.0) for p in get_effect(at.effect).parameters]


@pytest.fixture
def explainer():
    """Return the rules on fits by number, under a noise that stays what it is."""
    model = SimpleNamespace(machine=None, noise=0.1, thinned=False, scaled=scaled)
    part = SimpleNamespace(drive=np.repeat([0, 1], SAMPLES), models=[model])
    case = SimpleNamespace(fit=part, check=part, drives=DRIVES)
    rules = Explainer(case, floor_of(1.0), RULES)
    rules.ends = lambda e, evidence: (e.theta - 0.1, e.theta + 0.1)
    return rules


def test_the_rules_are_those_that_the_docs_state():
    page = (ROOT / 'docs' / 'diagnosis.md').read_text()
    stated = {}
    row = r'^\| ((?:`\w+`(?:, )?)+) \| ([\d., ]+) \|'
    for names, values in re.findall(row, page, re.MULTILINE):
        numbers = [float(x) for x in values.split(',')]
        stated |= dict(zip(re.findall(r'\w+', names), numbers, strict=True))
    rules = vars(Rules())
    assert {k: v for k, v in stated.items() if k in rules} == rules


# ---------------------------------------------------------------------- the answer


SHARP = Temperatures(size=1e-3, closed=1e-3)


def answered(explainer, chain, fitted=(), rivals=None, rests=None, **more):
    rounds = [Round(chain[0], {}, tuple(fitted))] if fitted else []
    rivals = tuple(fitted) if rivals is None else rivals
    got = found(chain, rounds, rivals, [chain[0]] if rests is None else rests, **more)
    return judge(explainer, got, temperatures=SHARP)


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


def test_numbers_that_bring_nothing_speak_against_a_law(explainer):
    force, spring = EffectAt('constant_force', 'one'), EffectAt('cable_spring', 'one')
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[force])
    weights = []
    for left in (0.0, -0.01, 0.01):
        other = made((left, 0.0), effects=[spring])
        said = answered(explainer, [base, one], [one, other])
        weights.append({w.at: w.probability for w in said.ranking})
    assert weights[0][spring] == pytest.approx(weights[0][force] / math.sqrt(4 * SAMPLES))
    # Twenty units of the loss are worth a number.
    assert weights[1][spring] == pytest.approx(weights[1][force])
    # However much more it leaves beside a plainer form, that is what its form is weighed by.
    assert weights[2][spring] == pytest.approx(
        weights[2][force] / math.sqrt(4 * SAMPLES) * (0.025 / 0.02) ** -5
    )


def test_what_the_fit_before_closes_on_its_way_is_no_merit_of_an_effect(explainer):
    base, best = made((2.0, 0.0)), made((0.2, 0.0), effects=[STRIBECK])
    explainer.round = lambda before, candidates: Round(before, {}, (best,))
    explainer.with_new_floor = lambda chain, rounds: (chain, rounds)
    for left, names in ((0.3, ()), (1.9, (STRIBECK,))):
        explainer.refit = lambda effects, theta, left=left: made((left, 0.0), effects)
        said = explainer.explain(base, [STRIBECK], lambda e: None)
        assert (said.chain[-1].effects, float(said.chain[0].fit[0])) == (
            names, SAMPLES * (1.0 + left),
        )  # fmt: skip


def test_a_law_whose_numbers_another_cause_took_up_is_put_in_plainer_words(explainer):
    force, spring = EffectAt('constant_force', 'one'), EffectAt('cable_spring', 'one')
    base, both = made((4.0, 2.0)), [DRAG, spring]
    first = Round(base, {}, (made((0.5, 2.0), [spring]), made((1.0, 2.0), [force])))
    left = {(DRAG,): 4.0, (force,): 1.0}
    explainer.refit = lambda effects, theta: made((left[tuple(effects)], 0.0), effects)
    chain = [base, made((4.0, 0.0), [DRAG]), made((0.0, 0.0), both)]
    for gap, named in ((0.03, force), (0.2, spring)):
        left[DRAG, force] = gap
        ended, rests = explainer.with_plainer_laws(chain, (base, chain[1]), [first])
        assert ended[-1].effects == (DRAG, named)
        assert len(rests) == 2


# ---------------------------------------------------------------------- steps of encoders


STEPS = EffectAt('encoder_quantisation', 'one')


def read_coarsely(explainer, chain, *drives, remaining=0.0):
    readings = [CoarseReading(drive, 1e-4) for drive in drives]
    rests = tuple(chain[:-1])[-len(chain[-1].effects) :] or (chain[0],)
    got = found(chain, [], [(chain[-1],)] * len(rests), rests, remaining)
    return judge(explainer, got, readings, SHARP)


def test_steps_of_an_encoder_are_the_answer_where_its_drive_has_the_gap(explainer):
    said = read_coarsely(explainer, [made((2.0, 0.1))], 'one')
    assert (said.effect, said.where, said.also) == (STEPS.effect, ('one',), ())
    assert said.probability == pytest.approx(0.95)
    assert [r.drive for r in said.readings] == ['one']
    small = found([made((0.54**2, 0.0))])
    unsure = judge(explainer, small, [CoarseReading('one', 1e-4)])
    assert unsure.probability == pytest.approx(0.95 / (1.0 + math.exp(-1.0)))
    both = read_coarsely(explainer, [made((2.0, 3.0))], 'one', 'two')
    assert (both.where, both.also) == (('two',), (STEPS,))


# ---------------------------------------------------------------------- what is left to tell


def test_a_floor_that_is_no_noise_is_something_unknown(explainer):
    explainer.floor = floor_of(1.0, restless=('two',))
    base = made((0.3**2, 0.0))
    said = judge(explainer, found([base]))
    assert (said.effect, said.where, said.probability) == (UNKNOWN, ('two',), 0.7)
    assert said.facts.slow == {'two': 1.0}
    explainer.floor = floor_of(1.0, restless=('one', 'two'))
    assert judge(explainer, found([base])).where == ('all',)
    assert judge(explainer, found([base], complete=False)).effect == NONE
    explainer.case.fit.models[0].machine = SimpleNamespace(stated=lambda name: True)
    assert judge(explainer, found([base])).facts.slow == {'one': 1.0, 'two': 1.0}
    # A noise that the machine file does not state says nothing.
    explainer.case.fit.models[0].machine = SimpleNamespace(stated=lambda name: False)
    assert judge(explainer, found([base])).facts.slow == {'one': 0.0, 'two': 0.0}
    # Below a frequency all noise is slow.
    explainer.case.fit.models[0].thinned = True
    assert judge(explainer, found([base])).effect == NONE
    # What is left to explain goes first.
    assert not judge(explainer, found([made((2.0, 0.0))])).facts.slow
