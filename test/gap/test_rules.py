# SPDX-License-Identifier: Apache-2.0
"""The rules of the diagnosis, one by one, on fits made of numbers: nothing is simulated here."""

from dataclasses import replace
import math
from pathlib import Path
import re
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_ident.arrays import NORMAL
from ros2_ident.effects import get_effect
from ros2_ident.gap.assemble import _values
from ros2_ident.gap.hypothesis import Hypothesis, Round, Samples, Selection
from ros2_ident.gap.rules import Rules, Temperatures
from ros2_ident.gap.suspects.encoder_steps import EncoderSteps
from ros2_ident.gap.verdict import judge, NONE, UNKNOWN
from ros2_ident.models import EffectAt, Parameter
from ros2_ident.report.page.steps import undetermined

ROOT = Path(__file__).parents[2]
DRIVES = ('one', 'two')
SAMPLES = 1000
RULES = Rules(
    material=0.5, unknown=0.8, step=0.4, share=0.1, closed=0.6, rival=0.1, alike=0.02, most=3
)
STRIBECK, DRAG = EffectAt('stribeck', 'one'), EffectAt('quadratic_drag', 'two')


def test_an_interval_ends_where_its_parameter_was_searched():
    """The end that noise alone allows was kept, 50 times as far as the box goes."""
    box = Parameter('measurement_delay', 's', 0.0, 0.08, 'measurement', '')
    joint = SimpleNamespace(parameters=(box,), low=np.array([0.0]), high=np.array([0.08]))
    ends = np.array([[0.0], [4.46], [-4.46], [4.46]])
    fit = SimpleNamespace(with_effects=lambda effects: joint)
    selector = SimpleNamespace(split=SimpleNamespace(fit=fit), rules=RULES)
    e = replace(made((0.0, 0.0)), theta=np.array([0.07]), unit=np.array([0.9]))
    e = replace(e, jacobian=np.ones((2, 1)), residual=np.zeros(2))
    found = _values(selector, e, ends)
    value = found['measurement_delay']
    assert (value.low, value.high, value.noise_low, value.noise_high) == (0.0, 0.08, 0.0, 0.08)
    assert undetermined(value) and not undetermined(replace(value, low=0.05))


def made(gap, effects=(), certain=1.0):
    """Return a fit that leaves a mean square beyond the noise's on each of two drives."""
    fit = SAMPLES * (1.0 + np.array(gap, dtype=float))
    own = sum(len(get_effect(at.effect).parameters) for at in effects)
    theta = np.array([1.0, 2.0] + [0.5] * own)
    empty, count = np.empty(0), np.full(2, float(SAMPLES))
    samples = Samples(count, count, np.full(2, certain))
    return Hypothesis(
        tuple(effects), theta, fit, fit, samples, *([empty] * 3), unit=np.full(theta.size, 0.5)
    )


def test_the_rules_are_those_that_the_docs_state():
    page = (ROOT / 'docs' / 'diagnosis.md').read_text()
    stated = {}
    row = r'^\| ((?:`\w+`(?:, )?)+) \| ([\d., ]+) \|'
    for names, values in re.findall(row, page, re.MULTILINE):
        numbers = [float(x) for x in values.split(',')]
        stated |= dict(zip(re.findall(r'\w+', names), numbers, strict=True))
    rules = vars(Rules())
    assert {k: v for k, v in stated.items() if k in rules} == rules


def test_a_further_order_of_a_ripple_counts_however_large_the_first_was():
    first, again, spring = (
        EffectAt(name, 'one') for name in ('torque_ripple', 'torque_ripple_2', 'cable_spring')
    )
    chain = [made([1000.0, 0.0]), made([10.0, 0.0], [first])]
    assert RULES.mends_a_form(chain, made([1.0, 0.0], [first, spring]))
    assert not RULES.mends_a_form(chain, made([1.0, 0.0], [first, again]))


def test_a_spring_that_rests_at_the_end_of_its_search_is_the_force_that_it_comes_to():
    base, forces, springs = made((900.0, 0.0)), [], []
    for drive in DRIVES:
        forces.append(EffectAt('constant_force', drive))
        springs.append(EffectAt('cable_spring', drive))
    spring, force, other = (made((0.0, 0.0), [at]) for at in (springs[0], *forces))
    force, other, far = (replace(e, fit=e.fit + 5.0 * SAMPLES) for e in (force, other, spring))
    assert RULES.plainest(base, [spring, force]) is spring
    for end in (0.0, 1.0):
        far = replace(spring, unit=np.array([0.5, 0.5, 0.5, end]))
        assert RULES.plainest(base, [far, force]) is force
        assert RULES.plainest(base, [far, other]) is far
    # More than two laws of a cause differ by.
    force = replace(force, fit=force.fit + 50.0 * SAMPLES)
    assert RULES.plainest(base, [far, force]) is far


# ---------------------------------------------------------------------- the answer


SHARP = Temperatures(size=1e-3, closed=1e-3)


def answered(chain, fitted=(), rivals=None, rests=None, **more):
    rounds = (Round(chain[0], {}, tuple(fitted)),) if fitted else ()
    rivals = tuple(fitted if rivals is None else rivals)
    rests = tuple([chain[0]] if rests is None else rests)
    found = Selection(DRIVES, tuple(chain), rounds, rivals, rests, **more)
    return judge(found, (), RULES, SHARP)


def test_a_small_gap_that_nothing_explains_is_none_and_a_large_one_unknown():
    assert answered([made((0.6, 0.0))]).effect == NONE
    said = answered([made((0.7, 0.0))])
    assert (said.effect, said.where) == (UNKNOWN, ('one',))
    assert said.probability == pytest.approx(0.88)
    assert answered([made((0.7, 0.34))]).where == ('one',)
    assert answered([made((0.7, 0.36))]).where == ('all',)
    cut = answered([made((0.7, 0.0))], complete=False)
    assert (cut.effect, cut.probability) == (UNKNOWN, 0.0)


@pytest.mark.parametrize(
    ('before', 'left', 'effect'),
    [(2.0, 0.7, 'stribeck'), (2.0, 0.9, UNKNOWN), (1.0, 0.6, 'stribeck')],
)
def test_a_name_is_believed_where_enough_closes_or_little_is_left(before, left, effect):
    base, one = made((before, 0.0)), made((left, 0.0), effects=[STRIBECK])
    said = answered([base, one], [one])
    assert said.effect == effect
    assert said.closed == pytest.approx((before - left) / before)
    if effect != UNKNOWN:
        assert said.where == ('one',)
        assert said.probability > 0.85


@pytest.mark.parametrize(('end', 'share'), [(0.5, 1.0), (1.0, 0.5), (0.0, 1.0)])
def test_a_size_at_the_end_of_its_search_may_stand_for_another_cause(end, share):
    # at the lower end of its way presliding is nothing
    slid = EffectAt('presliding', 'one')
    base, one = made((2.0, 0.0)), made((0.1, 0.0), effects=[slid])
    sure = answered([base, one], [one]).probability
    one = replace(one, unit=np.array([0.5, 0.5, end]))
    said = answered([base, one], [one])
    assert said.effect == slid.effect
    assert said.probability == pytest.approx(share * sure)


def test_no_gap_is_as_certain_as_the_noise_is_known():
    """A log of 10 s with slow noise said 1.00 beside "slow noise may hide more"."""
    sure, short = (answered([made([0.0, 0.0], certain=c**2)]).probability for c in (0.95, 0.6))
    # Noise of 0.6 times the size leaves a gap: an end of the interval, half the odds beyond it.
    assert sure > 0.97 and short == pytest.approx(1.0 - 0.5 / NORMAL**2, abs=1e-3)


def test_twins_are_one_answer_under_two_names():
    force, bias = EffectAt('constant_force', 'one'), EffectAt('effort_bias', 'one')
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[force])
    said = answered([base, one], [one, made((0.3, 0.0), effects=[bias])])
    assert (said.effect, [w.at for w in said.confusable]) == ('constant_force', [force, bias])
    each = [w.probability for w in said.ranking]
    assert each[0] == each[1]
    assert said.probability == sum(each) > 0.85
    twin, third = made((0.3, 0.0), effects=[bias]), made((0.4, 0.0), effects=[DRAG])
    said = answered([base, one], [one, twin, third])
    weights = {w.at: w.probability for w in said.ranking}
    mean = 0.5 * (0.02**-5 + 0.17**-5)
    assert weights[force] / weights[DRAG] == pytest.approx(mean / 0.22**-5)
    # One that was not fitted stands beside it all the same.
    said = answered([base, one], [one])
    assert [w.at for w in said.confusable] == [force, bias]
    assert said.confusable[1].probability == said.confusable[0].probability


def test_what_holds_the_law_of_the_named_one_is_as_likely():
    """Asymmetric friction, which closed as much with a number more, was told at 0.006."""
    force, rubs = EffectAt('constant_force', 'one'), EffectAt('asymmetric_friction', 'one')
    for left, other in ((0.0, 0.0), (0.0, 0.01), (0.3, 0.0)):
        base, one = made((2.0, 0.0)), made((left, 0.0), effects=[force])
        said = answered([base, one], [one, made((other, 0.0), effects=[rubs])])
        weights = {w.at: w.probability for w in said.ranking}
        assert (weights[rubs] == weights[force]) == (other >= left)


def test_numbers_that_bring_nothing_speak_against_a_law():
    force, spring = EffectAt('constant_force', 'one'), EffectAt('cable_spring', 'one')
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[force])
    weights = []
    for left in (0.0, -0.01, 0.01):
        other = made((left, 0.0), effects=[spring])
        said = answered([base, one], [one, other])
        weights.append({w.at: w.probability for w in said.ranking})
    assert weights[0][spring] == pytest.approx(weights[0][force] / math.sqrt(4 * SAMPLES))
    # Twenty units of the loss are worth a number.
    assert weights[1][spring] == pytest.approx(weights[1][force])
    # However much more it leaves beside a plainer form, that is what its form is weighed by.
    assert weights[2][spring] == pytest.approx(
        weights[2][force] / math.sqrt(4 * SAMPLES) * (0.025 / 0.02) ** -5
    )


# ---------------------------------------------------------------------- steps of encoders


STEPS = EffectAt('encoder_quantisation', 'one')


def read_coarsely(gap, *drives):
    encoders = [EncoderSteps(drive, 1e-4) for drive in drives]
    return judge(Selection(DRIVES, (made(gap),)), encoders, RULES, SHARP)


def test_steps_of_an_encoder_are_the_answer_where_its_drive_has_the_gap():
    said = read_coarsely((2.0, 0.1), 'one')
    assert (said.effect, said.where, said.also) == (STEPS.effect, ('one',), ())
    assert said.probability == pytest.approx(0.95)
    assert [r.drive for r in said.encoders] == ['one']
    small = Selection(DRIVES, (made((0.54**2, 0.0)),))
    unsure = judge(small, [EncoderSteps('one', 1e-4)], RULES)
    assert unsure.probability == pytest.approx(0.95 / (1.0 + math.exp(-1.0)))
    both = read_coarsely((2.0, 3.0), 'one', 'two')
    assert (both.where, both.also) == (('two',), (STEPS,))


# ---------------------------------------------------------------------- what is left to tell


def test_a_floor_that_is_no_noise_is_something_unknown():
    base = made((0.3**2, 0.0))
    said = answered([base], restless={'two': 1.0})
    assert (said.effect, said.where, said.probability) == (UNKNOWN, ('two',), 0.7)
    assert said.facts.slow == {'two': 1.0}
    both = {'one': 1.0, 'two': 1.0}
    assert answered([base], restless=both).where == ('all',)
    assert answered([base], restless=both, complete=False).effect == NONE
    # What is left to explain goes first.
    assert not answered([made((2.0, 0.0))], restless=both).facts.slow


# ---------------------------------------------------------------------- whatever was found


EFFECTS = [EffectAt(x, d) for x in ('stribeck', 'cable_spring', 'effort_bias') for d in DRIVES]


def drawn(generator):
    """Return a selection of up to two effects of gaps by chance, the nominal one the largest."""
    before = generator.exponential(1.0, 2)
    chosen = [EFFECTS[i] for i in generator.permutation(len(EFFECTS))]
    left = [before * generator.uniform(-0.1, 1.0, 2) for _ in chosen]
    fitted = [made(gap, [at]) for gap, at in zip(left, chosen, strict=True)]
    chain = [made(before)]
    if generator.random() < 0.7:
        chain.append(fitted[0])
    if len(chain) == 2 and generator.random() < 0.4:
        chain.append(made(left[0] * generator.uniform(0.0, 1.0, 2), chosen[:2]))
    rests = [chain[0]] if len(chain) < 3 else [chain[0], chain[1]]
    return chain, fitted, rests


def test_answers_keep_their_promises_whatever_was_found():
    generator = np.random.default_rng(5)
    seen = {}
    for _ in range(2000):
        chain, fitted, rests = drawn(generator)
        said = answered(chain, fitted, rests=rests)
        seen[said.effect] = seen.get(said.effect, 0) + 1
        assert 0.0 <= said.probability <= 1.0 + 1e-12
        weights = [w.probability for w in said.ranking]
        assert weights == sorted(weights, reverse=True) and sum(weights) <= 1.0 + 1e-12
        if chain[0].size < RULES.material:
            assert said.effect == NONE
        elif len(chain) == 1:
            assert said.effect == (UNKNOWN if chain[0].size >= RULES.unknown else NONE)
        elif chain[-1].closes(chain[0]) >= RULES.closed:
            assert said.named == chain[-1].effects
        else:
            assert (said.effect == UNKNOWN) == (chain[-1].size >= RULES.unknown)
    assert min(seen.values()) > 50 and {NONE, UNKNOWN} < set(seen)
