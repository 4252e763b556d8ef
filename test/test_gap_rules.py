# SPDX-License-Identifier: Apache-2.0
"""The rules of the diagnosis, one by one, on fits made of numbers: nothing is simulated here."""

from dataclasses import replace
import math
from pathlib import Path
import re
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_ident.effects import CATALOGUE, get_effect
from ros2_ident.gap.attribute import Round
from ros2_ident.gap.compose import _hidden_by_noise
from ros2_ident.gap.criteria import at_bound, Rules
from ros2_ident.gap.explain import Explained, Explainer
from ros2_ident.gap.fits import Explanation
from ros2_ident.gap.reading import CoarseReading
from ros2_ident.gap.verdict import (
    advice,
    judge,
    NONE,
    Temperatures,
    UNKNOWN,
    Verdict,
    Weighed,
)
from ros2_ident.gates.law import Gain
from ros2_ident.models import EffectAt

ROOT = Path(__file__).parents[1]
DRIVES = ('one', 'two')
SAMPLES = 1000
RULES = Rules(
    material=0.5,
    unknown=0.8,
    step=0.4,
    later=0.5,
    share=0.1,
    part=0.05,
    closed=0.6,
    rival=0.1,
    contradicted=0.3,
    instead=0.7,
    alike=0.02,
    most=3,
)
STRIBECK, FRICTION = EffectAt('stribeck', 'one'), EffectAt('asymmetric_friction', 'one')
DRAG, SPRING = EffectAt('quadratic_drag', 'two'), EffectAt('cable_spring', 'two')


class Attribution:
    """Fits by number: what `refit` and `round` return is told beforehand."""

    def __init__(self):
        part = SimpleNamespace(drive=np.repeat([0, 1], SAMPLES), models=[self])
        self.case = SimpleNamespace(fit=part, check=part, drives=DRIVES)
        self.floor = np.ones(2)
        self.rounds, self.refits, self.asked = [], {}, []
        self.stop = False
        self.errors = np.inf
        self.limits = {}

    def standing(self, before, after):
        return self.errors

    def scaled(self, at):
        """Return an effect's parameters, all in shares of one."""
        return [
            replace(p, low=-1.0, high=1.0, neutral=0.0) for p in get_effect(at.effect).parameters
        ]

    def stopped(self):
        return self.stop

    def round(self, base, candidates, fits):
        self.asked.append((base, fits))
        return Round(base, {}, {}, tuple(self.rounds.pop(0)))

    def refit(self, effects, theta, iterations=12):
        told = self.refits[tuple(effects)]
        return told if isinstance(told, Explanation) else told(theta)


def size_of(effect):
    return len(get_effect(effect.effect).parameters)


def made(gap, check=None, effects=(), law=(1.0, 1.0), own=0.5):
    """Return a fit that leaves a mean square beyond the noise's on each of two drives."""
    fit = SAMPLES * (1.0 + np.array(gap, dtype=float))
    held = SAMPLES * (1.0 + np.array(gap if check is None else check, dtype=float))
    theta = np.array([1.0, 2.0] + [own] * sum(map(size_of, effects)))
    empty = np.empty(0)
    return Explanation(tuple(effects), theta, fit, held, np.array(law), *([empty] * 4))


def floor_of(variance):
    """Return a floor whose noise has a variance that many times its innovation's."""
    noise = SimpleNamespace(variance=variance, innovation=1.0)
    return SimpleNamespace(noise=(noise, noise), per_drive=np.ones(2), high=np.ones(2))


@pytest.fixture
def attribution():
    return Attribution()


@pytest.fixture
def explainer(attribution):
    made_ = Explainer(attribution, floor_of(1.0), RULES)
    made_.with_new_floor = lambda chain, rounds: (chain, rounds)
    made_.less_noise = lambda chain, rounds, best: None
    return made_


def found(chain, rounds=(), rivals=(), rests=(), remaining=0.0, complete=True):
    return Explained(tuple(chain), tuple(rounds), tuple(rivals), tuple(rests), remaining, complete)


# ---------------------------------------------------------------------- sizes


def test_the_rules_are_those_that_the_docs_state():
    page = (ROOT / 'docs' / 'diagnosis.md').read_text()
    stated = {}
    row = r'^\| ((?:`\w+`(?:, )?)+) \| ([\d., ]+) \|'
    for names, values in re.findall(row, page, re.MULTILINE):
        numbers = [float(x) for x in values.split(',')]
        stated |= dict(zip(re.findall(r'\w+', names), numbers, strict=True))
    rules = vars(Rules())
    assert {k: v for k, v in stated.items() if k in rules} == rules
    assert Temperatures() == Temperatures(0.04, 0.1, 0.12, 0.9, 5.0, 0.02, 0.02)


def test_a_gap_is_the_mean_square_beyond_the_noise_on_both_parts(explainer):
    e = made((0.3, -0.1), (0.5, -0.3))
    assert explainer.gap(e) == pytest.approx([0.4, -0.2])
    assert explainer.size(e) == pytest.approx(math.sqrt(0.4))
    assert explainer.size(made((-0.1, -0.2))) == 0.0
    assert e.loss == pytest.approx(SAMPLES * 4.4)
    assert e.cost == pytest.approx(SAMPLES * 2.2)


def test_a_share_is_of_what_there_is_to_explain_on_the_part_asked_for(explainer):
    before, after = made((1.0, 0.0), (3.0, 0.0)), made((0.5, 0.0), (0.0, 0.0))
    assert explainer.share(before, after) == pytest.approx(3.5 / 4.0)
    assert explainer.share(before, after, 'fit') == pytest.approx(0.5)
    assert explainer.share(before, after, 'check') == pytest.approx(1.0)
    assert explainer.share(after, before, 'check') == 0.0
    assert explainer.share(made((-0.1, 0.0)), made((-0.2, 0.0))) == 0.0


def test_bic_penalises_every_parameter(explainer):
    e = made((1.0, 0.0), effects=[STRIBECK])
    penalty = math.log(4 * SAMPLES) * (2 + size_of(STRIBECK))
    assert explainer.score(e) == pytest.approx(e.loss + penalty)


# ---------------------------------------------------------------------- what counts


@pytest.mark.parametrize(
    ('fall', 'first', 'counts'),
    [
        (0.41**2, True, True),
        (0.39**2, True, False),
        (0.49**2, False, False),
        (0.51**2, False, True),
    ],
)
def test_a_step_has_to_take_enough_away_and_a_later_one_more(explainer, fall, first, counts):
    before = made((1.0, 0.0), effects=[] if first else [STRIBECK])
    after = made((1.0 - fall, 0.0), effects=[*before.effects, FRICTION])
    assert explainer.material(before, after) is counts


def test_a_step_has_to_close_a_share_however_much_it_takes_away(explainer):
    before = made((9.0, 0.0))
    assert not explainer.material(before, made((9.0 - 0.8, 0.0)))
    assert explainer.material(before, made((9.0 - 1.0, 0.0)))
    # Of all data, however much of those held out.
    before = made((9.0, 0.0), check=(1.0, 0.0))
    assert not explainer.material(before, made((9.0, 0.0), check=(0.2, 0.0)))
    assert explainer.material(before, made((8.7, 0.0), check=(0.2, 0.0)))


def test_what_the_data_held_out_refute_does_not_count(explainer):
    before = made((2.0, 0.0))
    assert explainer.material(before, made((0.0, 0.0), check=(1.7, 0.0)))
    assert not explainer.material(before, made((0.0, 0.0), check=(1.9, 0.0)))


def test_data_held_out_that_cannot_speak_must_not_speak_against_it(explainer):
    silent = made((2.0, 0.0), check=(0.2, 0.0))
    worse = (0.5 * RULES.material) ** 2
    for change, said in ((0.9 * worse, True), (1.1 * worse, False)):
        after = made((0.0, 0.0), check=(0.2 + change, 0.0))
        assert explainer.material(silent, after) is said
        elsewhere = made((0.0, 0.0), check=(0.2, change))
        assert explainer.confirmed(silent, elsewhere, 0) is said
    # Where it has a gap on this drive it can speak; what it says of the other one is no matter.
    loud = made((2.0, 0.0), check=(0.26, 0.0))
    assert not explainer.confirmed(loud, made((0.0, 0.0), check=(0.26, 0.0)), 0)
    assert explainer.confirmed(loud, made((0.0, 0.0), check=(0.26, 0.0)), 1)


def test_what_a_chain_closes_is_counted_from_its_beginning(explainer):
    base, first = made((4.0, 0.0)), made((1.0, 0.0), effects=[STRIBECK])
    after = made((0.0, 0.0), effects=[STRIBECK, DRAG])
    assert explainer.closes([base, first], after) == pytest.approx(0.25)
    assert explainer.closes([made((-1.0, 0.5)), first], after) == 0.0


@pytest.mark.parametrize(
    ('effects', 'said'),
    [
        ([STRIBECK], False),
        ([STRIBECK, FRICTION], True),
        ([STRIBECK, DRAG], False),
        ([STRIBECK, EffectAt('rod_mass', 'all')], True),
        ([EffectAt('rod_mass', 'all'), STRIBECK], True),
        ([DRAG, STRIBECK, FRICTION], True),
    ],
)
def test_an_effect_beside_another_sits_where_that_one_does(effects, said):
    assert Explainer.beside(made((0.0, 0.0), effects=effects)) is said


@pytest.mark.parametrize(
    ('before', 'after', 'gap', 'said'),
    [
        (41.0, 1.5, 1.0, True),  # 0.5 is less than one and than a twentieth of 40
        (41.0, 2.1, 1.0, False),
        (11.0, 1.4, 1.0, True),
        (11.0, 1.6, 1.0, False),  # more than a twentieth of ten
        (2.1, 1.04, 1.0, True),
        (2.0, 1.0, 1.0, False),  # the law was not far off
        (41.0, 1.5, 1.4, True),
        (41.0, 1.5, 1.6, False),  # the outputs are much worse
    ],
)
def test_controllers_vouch_for_what_mends_their_law(explainer, before, after, gap, said):
    explainer.floor = floor_of(1e6)  # noise so slow that the outputs tell nothing
    base = made((1.0, 0.0), law=(1.0, before))
    effect = made((gap, 0.0), law=(1.0, after), effects=[STRIBECK])
    assert explainer.restores_law(base, effect) is said
    assert explainer.material(base, effect) is said
    later = replace(base, effects=(DRAG,))
    assert not explainer.material(later, effect), 'only the first effect is vouched for'


@pytest.mark.parametrize(
    ('mine', 'other', 'said'),
    [
        ((1.2, 1.0), (1.0, 1.0), True),
        ((1.08, 1.0), (1.0, 1.0), False),  # below 0.3 squared
        ((3.0, 1.0), (2.6, 1.0), False),  # a fifth of what it misses anyway
        ((3.0, 1.0), (1.9, 1.0), True),
        ((2.0, 1.0), (1.0, 2.0), False),  # no better on the whole
        ((2.0, 1.0), (1.0, 1.9), True),
    ],
)
def test_controllers_contradict_what_makes_them_disagree(explainer, mine, other, said):
    one, two = made((0.0, 0.0), law=mine), made((0.0, 0.0), law=other)
    assert explainer.contradicted(one, two) is said


@pytest.mark.parametrize(
    ('value', 'said'), [(0.9, False), (0.999, True), (-0.999, True), (0.0, False)]
)
def test_a_size_at_its_bound_is_implausible(explainer, value, said):
    assert explainer.plausible(made((0.0, 0.0), effects=[DRAG], own=value)) is not said


def test_a_bound_that_is_the_neutral_value_is_none():
    (size,) = (p for p in get_effect('stribeck').parameters if p.role == 'size')
    (shape,) = (p for p in get_effect('stribeck').parameters if p.role == 'shape')
    assert at_bound(size, size.high) and not at_bound(size, size.low)
    near = 0.9e-3 * (size.high - size.low)
    assert at_bound(size, size.high - near) and not at_bound(size, size.high - 1.2 * near)
    lower = replace(size, low=-1.0, high=1.0)
    assert at_bound(lower, -1.0) and not at_bound(lower, -0.5)
    assert not at_bound(shape, shape.high)
    assert at_bound(replace(size, neutral=0.1), size.low)


# ---------------------------------------------------------------------- the best of a round


def of_round(base, *fitted):
    return Round(base, {}, {}, fitted)


def test_the_best_fit_pays_for_its_parameters(explainer):
    base = made((2.0, 0.0))
    assert explainer.best(of_round(base)) is None
    assert size_of(STRIBECK) == size_of(DRAG) + 1
    two, one = made((0.2, 0.0), effects=[STRIBECK]), made((0.2015, 0.0), effects=[DRAG])
    assert two.loss < one.loss
    assert explainer.best(of_round(base, two, one)) is one
    better = made((0.16, 0.0), effects=[STRIBECK])
    assert explainer.best(of_round(base, better, one)) is better


@pytest.mark.parametrize(
    ('gap', 'simple', 'taken'),
    [
        (2.0, 0.239, True),  # closes less by 0.0195 of the gap
        (2.0, 0.241, False),
        (10.0, 0.359, True),  # 0.016 of the gap, 0.159 floors squared
        (10.0, 0.361, False),
    ],
)
def test_of_two_laws_that_close_alike_the_simpler_is_taken(explainer, gap, simple, taken):
    base = made((gap, 0.0))
    two, one = made((0.2, 0.0), effects=[SPRING]), made((simple, 0.0), effects=[DRAG])
    assert explainer.best(of_round(base, two, one)) is (one if taken else two)


def test_one_more_number_makes_a_rival_no_likelier(explainer):
    base = made((2.0, 0.0))
    simple, rival = made((0.23, 0.0), effects=[DRAG]), made((0.2, 0.0), effects=[SPRING])
    said = answered(explainer, [base, simple], [simple, rival])
    assert said.effect == DRAG.effect
    weights = {w.at: w.probability for w in said.ranking}
    assert weights[DRAG] == pytest.approx(weights[SPRING])


def test_what_comes_near_makes_unknown_less_sure(explainer):
    base, near = made((2.0, 0.0)), made((1.2, 0.0), effects=[STRIBECK])
    said = judge(explainer, found([base], [of_round(base, near)]))
    odds = 0.88 / (1.0 + math.exp((RULES.closed - 0.4) / 0.1))
    assert said.effect == UNKNOWN
    assert said.probability == pytest.approx(1.0 - 0.12 - odds, abs=1e-6)


# ---------------------------------------------------------------------- limits


def test_an_effort_that_stays_below_what_is_asked_names_its_limit(explainer):
    chain = [made((2.0, 2.0)), made((1.5, 1.5), effects=[DRAG])]
    assert answered(explainer, chain, [chain[-1]], remaining=1.2).effect == UNKNOWN
    explainer.attribution.limits = {'one': 0.4}
    said = answered(explainer, chain, [chain[-1]], remaining=1.2)
    assert said.named == (EffectAt('torque_saturation', 'one'), DRAG)
    assert (said.probability, said.limits) == (0.9, {'one': 0.4})


def test_a_limit_on_a_drive_without_a_gap_is_no_answer(explainer):
    explainer.attribution.limits = {'two': 0.4}
    said = answered(explainer, [made((2.0, 0.0))])
    assert (said.effect, said.where, said.limits) == (UNKNOWN, ('one',), {})


def test_a_size_at_its_bound_gives_way_to_what_comes_near(explainer):
    base = made((2.0, 0.0))
    edge = made((0.0, 0.0), effects=[STRIBECK], own=1.0)
    near, far = (made((left, 0.0), effects=[DRAG]) for left in (0.98, 1.02))
    assert explainer.best(of_round(base, edge, near)) is near
    assert explainer.best(of_round(base, edge, far)) is edge
    assert explainer.best(of_round(base, edge)) is edge


def test_where_little_closes_the_controllers_choose(explainer):
    explainer.floor = floor_of(1e6)
    base = made((2.0, 0.0), law=(41.0, 1.0))
    strong = made((1.0, 0.0), effects=[STRIBECK], law=(41.0, 1.0))
    vouched = made((1.9, 0.0), effects=[DRAG], law=(1.2, 1.0))
    assert explainer.best(of_round(base, strong, vouched)) is vouched
    assert explainer.best(of_round(replace(base, effects=(SPRING,)), strong, vouched)) is strong
    enough = made((0.7, 0.0), effects=[STRIBECK], law=(41.0, 1.0))
    assert explainer.best(of_round(base, enough, vouched)) is enough


@pytest.mark.parametrize(('left', 'taken'), [(0.5, True), (0.7, False)])
def test_what_controllers_contradict_gives_way_to_what_closes_nearly_as_much(
    explainer, left, taken
):
    base = made((2.0, 0.0))
    strong = made((0.0, 0.0), effects=[STRIBECK], law=(1.5, 1.0))
    other = made((left, 0.0), effects=[DRAG])
    assert explainer.best(of_round(base, strong, other)) is (other if taken else strong)
    edge = made((left, 0.0), effects=[DRAG], own=1.0)
    assert explainer.best(of_round(base, strong, edge)) is strong


# ---------------------------------------------------------------------- rounds


def rounds_of(attribution, *rounds):
    attribution.rounds = [list(r) for r in rounds]


def test_where_nothing_is_missing_nothing_is_tried(explainer, attribution):
    base = made((0.24, 0.0))
    got = explainer.explain(base, [], print)
    assert (got.chain, got.rounds, got.complete) == ((base,), (), True)
    assert (got.rests, got.rivals) == ((), ())
    assert got.remaining == pytest.approx(math.sqrt(0.24))
    assert not attribution.asked


def test_effects_are_added_while_they_count(explainer, attribution):
    base = made((4.0, 2.0))
    one = made((0.1, 2.0), effects=[STRIBECK])
    both = made((0.1, 0.1), effects=[STRIBECK, DRAG])
    alone = made((4.0, 0.1), effects=[DRAG])
    rounds_of(attribution, [one, made((4.0, 1.0), effects=[DRAG])], [both])
    attribution.refits = {(): base, (DRAG,): alone}
    heard = []
    got = explainer.explain(base, [], heard.append)
    assert got.chain == (base, one, both)
    assert heard == [one, both]
    assert [(at is b, fits) for (at, fits), b in zip(attribution.asked, (base, one), strict=True)]
    assert [fits for _, fits in attribution.asked] == [12, 8]
    assert got.rests == (alone, one)
    assert got.remaining == pytest.approx(math.sqrt(0.1))


def test_a_step_that_does_not_count_ends_it(explainer, attribution):
    base = made((4.0, 0.0))
    rounds_of(attribution, [made((3.9, 0.0), effects=[STRIBECK])])
    got = explainer.explain(base, [], print)
    assert got.chain == (base,) and len(got.rounds) == 1
    rounds_of(attribution, [])
    attribution.rounds = [[]]
    assert explainer.explain(base, [], print).chain == (base,)


def test_a_small_mend_of_an_effect_that_is_there_is_no_effect(explainer, attribution):
    base = made((40.0, 0.0))
    one = made((2.0, 0.0), effects=[STRIBECK])
    attribution.refits = {(): base, (FRICTION,): base}
    for left, chain in ((0.2, 2), (-0.2, 3)):  # 4.5 and 5.5 per cent of the first gap
        mended = made((left, 0.0), effects=[STRIBECK, FRICTION])
        rounds_of(attribution, [one], [mended], [])
        assert len(explainer.explain(base, [], lambda e: None).chain) == chain
    elsewhere = made((0.2, 0.0), effects=[STRIBECK, DRAG])
    rounds_of(attribution, [one], [elsewhere])
    attribution.refits |= {(DRAG,): base}
    assert len(explainer.explain(base, [], lambda e: None).chain) == 3


def test_there_are_never_more_effects_than_the_rules_allow(explainer, attribution):
    base = made((40.0, 40.0))
    several = (STRIBECK, DRAG, EffectAt('backlash', 'all'), SPRING)
    fits = [
        made((40.0 - 10 * k, 40.0 - 10 * k), effects=several[:k]) for k in range(1, 5)
    ]
    rounds_of(attribution, *([e] for e in fits))
    attribution.refits = {(): base}
    for k in range(len(several)):
        for rest in (several[1 : k + 1], (several[0], *several[2 : k + 1])):
            attribution.refits[rest] = base
    attribution.refits[several[:2]] = fits[1]
    got = explainer.explain(base, [], lambda e: None)
    assert len(got.chain) == RULES.most + 1


def test_an_effect_that_a_later_one_makes_superfluous_is_dropped(explainer, attribution):
    base, one = made((4.0, 0.0)), made((2.0, 0.0), effects=[STRIBECK])
    both = made((0.0, 0.0), effects=[STRIBECK, DRAG])
    attribution.refits = {(DRAG,): made((0.1, 0.0), effects=[DRAG])}
    assert [e.effects for e in explainer.prune([base, one, both])] == [(), (DRAG,)]
    attribution.refits = {(DRAG,): made((1.0, 0.0), effects=[DRAG])}
    assert explainer.prune([base, one, both]) == [base, one, both]


def test_a_chain_is_fitted_anew_where_a_middle_one_goes(explainer, attribution):
    three = [STRIBECK, FRICTION, DRAG]
    chain = [made((8.0, 0.0)), made((6.0, 0.0), effects=three[:1])]
    chain += [made((5.0, 0.0), effects=three[:2]), made((0.0, 0.0), effects=three)]
    first = made((3.0, 0.0), effects=[STRIBECK])
    attribution.refits = {
        (STRIBECK, DRAG): made((0.1, 0.0), effects=[STRIBECK, DRAG]),
        (DRAG,): made((5.0, 0.0), effects=[DRAG]),
        (STRIBECK,): first,
    }
    got = explainer.prune(chain)
    assert [e.effects for e in got] == [(), (STRIBECK,), (STRIBECK, DRAG)]
    assert got[1] is first


def test_the_first_of_three_goes_too(explainer, attribution):
    three = [STRIBECK, FRICTION, DRAG]
    chain = [made((8.0, 0.0)), made((6.0, 0.0), effects=three[:1])]
    chain += [made((5.0, 0.0), effects=three[:2]), made((0.0, 0.0), effects=three)]
    attribution.refits = {
        (STRIBECK, DRAG): made((5.0, 0.0), effects=[STRIBECK, DRAG]),
        (FRICTION, DRAG): made((0.1, 0.0), effects=[FRICTION, DRAG]),
        (FRICTION,): made((3.0, 0.0), effects=[FRICTION]),
    }
    got = explainer.prune(chain)
    assert [e.effects for e in got] == [(), (FRICTION,), (FRICTION, DRAG)]


def test_what_a_later_effect_makes_superfluous_is_dropped_on_the_way(explainer, attribution):
    base, one = made((4.0, 4.0)), made((1.0, 4.0), effects=[STRIBECK])
    both = made((0.0, 0.0), effects=[STRIBECK, DRAG])
    alone = made((0.1, 0.1), effects=[DRAG])
    attribution.refits = {(): base, (DRAG,): alone}
    rounds_of(attribution, [one], [both])
    assert explainer.explain(base, [], lambda e: None).chain == (base, alone)


def test_what_was_freed_takes_the_place_of_the_nominal_fit(explainer, attribution):
    base, plain = made((4.0, 0.0)), made((0.1, 0.0))
    attribution.refits = {(): plain}
    rounds_of(attribution, [made((0.0, 0.0), effects=[STRIBECK])])
    got = explainer.explain(base, [], print)
    assert [e.loss for e in got.chain] == [plain.loss]


def test_the_noise_is_looked_at_again_once_an_effect_is_known(attribution):
    explainer = Explainer(attribution, None, RULES)
    chain, rounds = [made((4.0, 0.0)), made((0.1, 0.0), effects=[STRIBECK])], []
    again = made((0.05, 0.0), effects=[STRIBECK])
    attribution.refits = {(STRIBECK,): again}
    renewed = []
    attribution.renew = lambda floor, c, r: renewed.append(floor) or (list(c), list(r))
    for share, said in ((0.98, False), (0.96, True)):
        seen = SimpleNamespace(floor=SimpleNamespace(per_drive=np.array([1.0, share])))
        explainer.noise_of = lambda e, seen=seen: seen
        got, _ = explainer.with_new_floor(chain, rounds)
        assert (got[-1] is again) is said
        assert (explainer.floor is seen.floor) is said
        assert len(renewed) == said
    assert chain[1] is not again


def test_an_effect_that_only_freed_a_stuck_fit_is_forgotten(explainer, attribution):
    base = made((4.0, 0.0))
    with_effect = made((0.0, 0.0), effects=[STRIBECK])
    plain = made((0.1, 0.0), law=(0.9, 1.2))
    attribution.refits = {(): plain}
    freed = explainer.better_nominal(base, with_effect)
    assert freed.loss == plain.loss and freed.law.tolist() == [0.9, 1.0]
    attribution.refits = {(): made((3.9, 0.0))}  # 2.5 per cent: not worth it
    assert explainer.better_nominal(base, with_effect) is base
    attribution.refits = {(): made((4.03, 0.0), check=(0.0, 0.0))}  # worse where it is fitted
    assert explainer.better_nominal(base, with_effect) is base
    attribution.refits = {(): made((4.01, 0.0), check=(0.0, 0.0))}
    assert explainer.better_nominal(base, with_effect) is not base


def test_a_stopped_search_says_that_it_is_not_complete(explainer, attribution):
    attribution.stop = True
    got = explainer.explain(made((4.0, 0.0)), [], print)
    assert not got.complete and not attribution.asked


def test_rivals_take_the_place_of_each_effect(explainer, attribution):
    base = made((4.0, 2.0))
    one = made((0.0, 2.0), effects=[STRIBECK])
    near, weak = made((1.8, 2.0), effects=[FRICTION]), made((2.2, 2.0), effects=[SPRING])
    both = made((0.0, 0.0), effects=[STRIBECK, DRAG])
    rounds = [of_round(base, one, near, weak), of_round(one, both)]
    instead = made((0.5, 0.0), effects=[DRAG, FRICTION])
    seen = []

    def refitted(theta):
        seen.append(theta)
        return instead

    attribution.refits = {(DRAG, FRICTION): refitted}
    assert explainer.rivals([base, one, both], rounds) == ((both, instead), (both,))
    assert len(seen[0]) == 2 + size_of(DRAG) + size_of(FRICTION)
    assert explainer.rivals([base, one], rounds[:1]) == ((one, near, weak),)
    assert explainer.rivals([base, one], []) == ((one,),)


# ---------------------------------------------------------------------- the answer


SHARP = Temperatures(size=1e-3, closed=1e-3)


def answered(explainer, chain, fitted=(), rivals=None, rests=None, **more):
    rounds = [of_round(chain[0], *fitted)] if fitted else []
    rivals = [tuple(fitted)] if rivals is None else rivals
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


def test_probabilities_follow_what_is_left_and_what_controllers_say(explainer):
    base = made((2.0, 0.0))
    one, two = made((0.2, 0.0), effects=[STRIBECK]), made((0.4, 0.0), effects=[DRAG])
    said = answered(explainer, [base, one], [one, two])
    weights = {w.at: w.probability for w in said.ranking}
    assert weights[STRIBECK] / weights[DRAG] == pytest.approx((0.22 / 0.12) ** 5)
    assert sum(weights.values()) == pytest.approx(1.0)
    assert [w.at for w in said.ranking] == [STRIBECK, DRAG]
    refuted = replace(two, law=np.array([2.0, 1.0]))
    again = answered(explainer, [base, one], [one, refuted])
    less = {w.at: w.probability for w in again.ranking}
    assert less[STRIBECK] / less[DRAG] == pytest.approx(50.0 * (0.22 / 0.12) ** 5)


def test_what_closes_nearly_as_much_cannot_be_told_apart(explainer):
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[STRIBECK])
    near, far = made((0.19, 0.0), effects=[DRAG]), made((0.21, 0.0), effects=[SPRING])
    said = answered(explainer, [base, one], [one, near, far])
    assert [w.at for w in said.confusable] == [STRIBECK, DRAG]
    assert all(any(w is x for x in said.ranking) for w in said.confusable)
    refuted = replace(near, law=np.array([2.0, 1.0]))
    said = answered(explainer, [base, one], [one, refuted, far])
    assert [w.at for w in said.confusable] == [STRIBECK]


def test_twins_are_one_answer_under_two_names(explainer):
    force, bias = EffectAt('constant_force', 'one'), EffectAt('effort_bias', 'one')
    base, one = made((2.0, 0.0)), made((0.0, 0.0), effects=[force])
    said = answered(explainer, [base, one], [one, made((0.3, 0.0), effects=[bias])])
    assert (said.effect, [w.at for w in said.confusable]) == ('constant_force', [force, bias])
    each = [w.probability for w in said.ranking]
    assert each[0] == each[1]
    assert said.probability == sum(each) > 0.85


def test_further_effects_are_told_in_their_order(explainer):
    base, one = made((2.0, 2.0)), made((0.0, 2.0), effects=[STRIBECK])
    both = made((0.0, 0.0), effects=[STRIBECK, DRAG])
    said = answered(
        explainer, [base, one, both], [one], [(both,), (both,)], [made((2.0, 0.0)), one]
    )
    assert (said.effect, said.also) == ('stribeck', (DRAG,))
    # The first one is weighed by the fit that has both.
    assert [(w.at, w.model) for w in said.ranking] == [(STRIBECK, both)]


def test_advice_says_how_to_tell_apart_and_what_was_not_to_be_seen():
    rows = tuple(Weighed(at, 0.4, made((0.0, 0.0))) for at in (STRIBECK, DRAG))
    verdict = Verdict('stribeck', ('one',), 0.4, (), rows, rows, 0.9)
    (one,) = advice(verdict, [])
    assert 'cannot be told apart' in one and get_effect('quadratic_drag').title in one
    assert advice(replace(verdict, confusable=rows[:1]), []) == ()
    (seen,) = advice(replace(verdict, confusable=()), [SPRING, EffectAt('rod_mass', 'all')])
    assert seen.startswith('This motion cannot show:') and 'the machine' in seen
    unknown = Verdict(UNKNOWN, ('one',), 0.5, (), (), (), 0.0)
    assert 'isolate the drive' in advice(unknown, [])[0]
    assert advice(replace(unknown, probability=0.0), []) == ()


@pytest.mark.parametrize(('misfit', 'decides'), [(0.012, True), (0.010002, False)])
def test_of_two_gains_of_a_drive_the_logged_law_tells_which(
    explainer, attribution, misfit, decides
):
    gains = tuple(
        Gain(name, 1.0, 0.01, 1.0, left, 4000.0)
        for name, left in (('position_gain', 0.010), ('integral_gain', misfit))
    )
    attribution.laws = lambda drive: [SimpleNamespace(gains=gains)]
    right = made((0.0, 0.0), effects=[EffectAt('position_gain_error', 'one')])
    wrong = made((0.0, 0.0), effects=[EffectAt('integral_gain_error', 'one')])
    assert explainer.contradicted(wrong, right) == decides
    assert not explainer.contradicted(right, wrong)
    elsewhere = made((0.0, 0.0), effects=[EffectAt('integral_gain_error', 'two')])
    assert explainer.odds_by_law(elsewhere, right) == 0.0


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


def test_an_effect_that_closes_more_than_the_steps_leave_comes_first(explainer):
    base = made((0.0, 4.0))
    one = made((1.0, 0.0), effects=[DRAG])
    said = read_coarsely(explainer, [base, one], 'one')
    assert (said.effect, said.where, said.also) == ('quadratic_drag', ('two',), (STEPS,))
    assert [r.drive for r in said.readings] == ['one']
    # It closes two, and the steps leave three.
    less = read_coarsely(explainer, [made((3.0, 2.0)), made((3.0, 0.0), effects=[DRAG])], 'one')
    assert (less.effect, less.where, less.also) == (STEPS.effect, ('one',), (DRAG,))


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


def test_how_sure_an_answer_is_follows_how_far_it_is_from_the_other(explainer):
    base = made((0.46**2, 0.0))
    said = judge(explainer, found([base]))
    assert said.effect == NONE
    assert said.probability == pytest.approx(1.0 / (1.0 + math.exp(-1.0)))
    small = judge(explainer, found([made((0.76**2, 0.0))]))
    assert small.effect == NONE
    assert small.probability == pytest.approx(1.0 / (1.0 + math.exp(-1.0)))


def test_the_one_effect_left_is_weighed_by_its_last_fit(explainer):
    base, first = made((2.0, 0.0)), made((0.6, 0.0), effects=[STRIBECK])
    other = made((0.4, 0.0), effects=[DRAG])
    last = made((0.2, 0.0), effects=[STRIBECK])
    said = answered(explainer, [base, last], [first, other])
    assert said.ranking[0].at == STRIBECK and said.ranking[0].model is last
    weights = {w.at: w.probability for w in said.ranking}
    assert weights[STRIBECK] / weights[DRAG] == pytest.approx((0.22 / 0.12) ** 5)


def test_what_controllers_contradict_gives_way_by_its_share_of_what_the_best_closes(explainer):
    base = made((2.0, 0.0))
    strong = made((0.4, 0.0), effects=[STRIBECK], law=(1.5, 1.0))  # closes 0.8
    for left, taken in ((0.86, True), (0.9, False)):  # 0.7 of that is 0.56, or 0.88 left
        other = made((left, 0.0), effects=[DRAG])
        assert explainer.best(of_round(base, strong, other)) is (other if taken else strong)


def test_what_is_needed_most_comes_first(explainer, attribution):
    effects = (STRIBECK, DRAG)
    base, one = made((9.0, 9.0)), made((4.0, 9.0), effects=effects[:1])
    theta = np.arange(2.0 + size_of(STRIBECK) + size_of(DRAG))
    both = replace(made((0.0, 0.0), effects=effects), theta=theta)
    alone, turned = made((9.0, 0.0), effects=[DRAG]), made((0.0, 0.0), effects=effects[::-1])
    seen = []
    attribution.refits = {
        (DRAG,): lambda theta: seen.append(theta) or alone,
        (DRAG, STRIBECK): lambda theta: seen.append(theta) or turned,
    }
    rests = (made((1.0, 0.0)), made((3.0, 0.0)))
    chain, left = explainer.ordered([base, one, both], rests)
    assert chain == [base, alone, turned] and left == rests[::-1]
    size = size_of(DRAG)
    assert seen[0].tolist() == [0.0, 1.0, *theta[-size:]]
    assert seen[1].tolist() == [0.0, 1.0, *theta[-size:], *theta[2:-size]]
    nearly = (made((1.6, 0.0)), made((3.0, 0.0)))  # less than twice as much
    assert explainer.ordered([base, one, both], nearly) == ([base, one, both], nearly)


def test_an_effect_counts_by_the_noise_that_is_left_with_it(attribution):
    explainer = Explainer(attribution, old := floor_of(1.0), RULES)
    base, one = made((4.0, 4.0)), made((0.0, 4.0), effects=[STRIBECK])
    best = made((0.0, 3.9), effects=[STRIBECK, DRAG])
    attribution.fits = 'old'

    def renew(floor, chain, rounds):
        attribution.fits = 'new'
        return list(chain), list(rounds)

    attribution.renew = renew
    for left, counts in ((0.0, True), (3.9, False)):
        again = made((0.0, left), effects=[STRIBECK, DRAG])
        attribution.refits = {(STRIBECK, DRAG): again}
        floor = SimpleNamespace(per_drive=np.array([1.0, 0.5]), noise=old.noise)
        explainer.noise_of = lambda e, floor=floor: SimpleNamespace(floor=floor)
        got = explainer.less_noise([base, one], ['round'], best)
        assert got == (([base, one], ['round'], again) if counts else None)
        assert explainer.floor is (floor if counts else old)
        assert attribution.fits == ('new' if counts else 'old')
        explainer.floor, attribution.fits = old, 'old'
    explainer.noise_of = lambda e: SimpleNamespace(floor=floor_of(1.0))
    assert explainer.less_noise([base, one], [], best) is None
    assert attribution.fits == 'old'
    # Lower by less than three per cent is the same.
    attribution.floor = np.full(2, 2.0)
    for share, lower in ((0.98, False), (0.96, True)):
        floor = SimpleNamespace(per_drive=np.array([2.0, 2.0 * share]), noise=old.noise)
        explainer.noise_of = lambda e, floor=floor: SimpleNamespace(floor=floor)
        attribution.refits = {(STRIBECK, DRAG): made((0.0, 0.0), effects=[STRIBECK, DRAG])}
        assert (explainer.less_noise([base, one], [], best) is not None) is lower
        explainer.floor = old


@pytest.mark.parametrize(('errors', 'counts'), [(np.inf, True), (5.0, True), (3.0, False)])
def test_a_step_that_slow_noise_may_make_does_not_count(explainer, attribution, errors, counts):
    # It takes away 0.8 of the noise, 0.28 at the lower end of an interval of 3 standard errors.
    base, one = made((0.64, 0.0)), made((0.0, 0.0), effects=[STRIBECK])
    attribution.errors = errors
    assert explainer.material(base, one)
    assert explainer.counts(base, one) == counts


@pytest.mark.parametrize(('high', 'said'), [(1.05, 'unknown'), (1.2, 'none')])
def test_what_noise_may_be_is_nothing_unknown(attribution, high, said):
    # 0.9 of the noise are left, and what is called noise may be larger.
    floor = floor_of(1.0)
    floor.high = np.full(2, high)
    verdict = answered(Explainer(attribution, floor, RULES), [made((0.81, 0.0))])
    assert verdict.effect == said


@pytest.mark.parametrize(('effect', 'told'), [(NONE, 1), (UNKNOWN, 0)])
def test_nothing_is_missing_says_what_slow_noise_may_hide(effect, told):
    floor = SimpleNamespace(per_drive=np.array([0.5, 0.5]), low=np.array([0.3, 0.45]))
    verdict = Verdict(effect, (), 0.9, (), (), (), 0.0)
    said = list(_hidden_by_noise(verdict, floor, DRIVES, 'N m'))
    assert len(said) == told and all('What is left on one is so slow' in x for x in said)
    assert all('up to 0.4 N m' in x for x in said)


def test_what_takes_away_more_than_the_noise_holds_is_none(explainer, attribution):
    base, one = made((9.0, 0.0)), made((7.9, 0.0), effects=[STRIBECK])
    attribution.errors = 0.0
    assert explainer.counts(base, one)
    assert not explainer.counts(base, made((8.1, 0.0), effects=[STRIBECK]))


def test_what_mends_the_controllers_law_counts_in_any_noise(explainer, attribution):
    base = made((0.64, 0.0), law=(9.0, 1.0))
    mended = made((0.0, 0.0), effects=[STRIBECK])
    attribution.errors = 0.0
    assert explainer.counts(base, mended)


def test_at_most_four_others_are_tried_in_the_place_of_an_effect(explainer, attribution):
    base, both = made((4.0, 2.0)), made((0.0, 0.0), effects=[STRIBECK, DRAG])
    one = made((0.0, 2.0), effects=[STRIBECK])
    names = ('asymmetric_friction', 'cable_spring', 'backlash', 'cogging', 'viscous_error')
    known = [x for x in names if x in CATALOGUE] + sorted(set(CATALOGUE) - set(names))
    others = [EffectAt(x, 'two') for x in known if x not in ('stribeck', 'quadratic_drag')][:6]
    fitted = [made((1.0, 2.0), effects=[at]) for at in others]
    attribution.refits = {(DRAG, at): made((0.5, 0.0), effects=[DRAG, at]) for at in others}
    rounds = [of_round(base, one, *fitted), of_round(one, both)]
    first, _ = explainer.rivals([base, one, both], rounds)
    assert [e.effects for e in first[1:]] == [(DRAG, at) for at in others[:4]]


@pytest.mark.parametrize(
    ('gap', 'slow', 'said'),
    [
        (4.0, 399.0, False),
        (4.0, 401.0, True),
        (8.9, 1.0, False),
        (9.1, 1.0, True),
    ],
)
def test_controllers_vouch_where_outputs_are_too_violent_or_their_noise_too_slow(
    explainer, gap, slow, said
):
    explainer.floor = floor_of(slow)
    base = made((gap, 0.0), law=(41.0, 1.0))
    worse = made((1.05 * gap, 0.0), law=(1.2, 1.0), effects=[STRIBECK])
    assert explainer.restores_law(base, worse) is said
