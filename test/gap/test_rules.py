# SPDX-License-Identifier: Apache-2.0
"""The rules of the diagnosis, one by one, on fits made of numbers: nothing is simulated here."""

from dataclasses import replace
import math
from pathlib import Path
import re
from types import SimpleNamespace

from gap_fits import (
    Attribution,
    DRAG,
    explainer_of,
    floor_of,
    FRICTION,
    made,
    of_round,
    RULES,
    SAMPLES,
    size_of,
    SPRING,
    STRIBECK,
)
import numpy as np
import pytest

from ros2_ident.effects import CATALOGUE, get_effect
from ros2_ident.gap import explain
from ros2_ident.gap.criteria import at_bound, Rules
from ros2_ident.gap.explain import Explainer
from ros2_ident.gap.verdict import Temperatures
from ros2_ident.gates.law import Gain
from ros2_ident.models import EffectAt

ROOT = Path(__file__).parents[2]


@pytest.fixture
def attribution():
    return Attribution()


@pytest.fixture
def explainer(attribution):
    return explainer_of(attribution)


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


def test_data_held_out_are_asked_of_the_drive_that_is_helped_most(explainer):
    # The other one has the larger gap, on which they could speak.
    before = made((1.0, 2.0), check=(0.2, 2.0))
    assert explainer.material(before, made((0.0, 2.0), check=(0.2, 2.0)))
    assert not explainer.material(before, made((1.0, 1.0), check=(0.2, 2.0)))


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
        ((3.0, 1.0), (2.1, 1.0), False),  # less than half of that
        ((3.0, 1.0), (1.9, 1.0), True),
        ((0.5, 1.0), (0.2, 1.0), True),  # nothing is missed anyway
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


@pytest.mark.parametrize(
    ('gap', 'slow', 'effects', 'said'),
    [
        (0.26, 1.0, [], True),
        (0.24, 1.0, [], False),
        (0.24, 3.9, [], False),
        (0.24, 4.1, [], True),  # what is called noise may be what is missing
        (0.24, 4.1, [STRIBECK], False),
        (0.26, 1.0, [STRIBECK], True),
    ],
)
def test_more_may_be_missing_by_its_size_or_by_how_slow_the_noise_is(
    explainer, gap, slow, effects, said
):
    explainer.floor = floor_of(slow)
    assert explainer.open(made((gap, 0.0), effects=effects)) is said


# ---------------------------------------------------------------------- the best of a round


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


# ---------------------------------------------------------------------- limits


def test_a_size_at_its_bound_gives_way_to_what_comes_near(explainer):
    base = made((2.0, 0.0))
    edge = made((0.0, 0.0), effects=[STRIBECK], own=1.0)
    near, far = (made((left, 0.0), effects=[DRAG]) for left in (0.98, 1.02))
    assert explainer.best(of_round(base, edge, near)) is near
    assert explainer.best(of_round(base, edge, far)) is edge
    assert explainer.best(of_round(base, edge)) is edge
    # Half of what the one at its bound closes, however little that is.
    edge = made((1.0, 0.0), effects=[STRIBECK], own=1.0)
    near, far = (made((left, 0.0), effects=[DRAG]) for left in (1.48, 1.52))
    assert explainer.best(of_round(base, edge, near)) is near
    assert explainer.best(of_round(base, edge, far)) is edge


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
        got = explainer.explain(base, [], lambda e: None)
        assert (len(got.chain), len(got.rounds)) == (chain, 2)
    elsewhere = made((0.2, 0.0), effects=[STRIBECK, DRAG])
    rounds_of(attribution, [one], [elsewhere])
    attribution.refits |= {(DRAG,): base}
    assert len(explainer.explain(base, [], lambda e: None).chain) == 3


def test_there_are_never_more_effects_than_the_rules_allow(explainer, attribution):
    base = made((40.0, 40.0))
    several = (STRIBECK, DRAG, EffectAt('backlash', 'all'), SPRING)
    fits = [made((40.0 - 10 * k, 40.0 - 10 * k), effects=several[:k]) for k in range(1, 5)]
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
    attribution.floor = np.full(2, 2.0)
    for share, said in ((0.98, False), (0.96, True)):
        seen = SimpleNamespace(floor=SimpleNamespace(per_drive=np.array([2.0, 2.0 * share])))
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
    # Worse where it is fitted, by more squares of the noise than chance adds.
    for more, kept in ((20.5, True), (19.5, False)):
        plain = made((4.0 + more / SAMPLES, 0.0), check=(0.0, 0.0))
        attribution.refits = {(): plain}
        assert (explainer.better_nominal(base, with_effect) is base) is kept
    for left, kept in ((3.82, True), (3.78, False)):  # 4.5 and 5.5 per cent
        attribution.refits = {(): made((left, 0.0))}
        assert (explainer.better_nominal(base, with_effect) is base) is kept


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


@pytest.mark.parametrize(
    ('misfit', 'decides'),
    [(0.012, True), (0.01 * math.exp(3.1 / 4000.0), True), (0.01 * math.exp(2.9 / 4000.0), False)],
)
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


# ---------------------------------------------------------------------- what is left to tell


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


def test_what_the_noise_of_a_fit_is_is_worked_out_once(explainer, attribution, monkeypatch):
    seen, said = [], []

    def predicted(joint, theta, stopped):
        seen.append((joint, theta))
        return SimpleNamespace(floor='floor')

    monkeypatch.setattr(explain, 'predictability', predicted)
    attribution.case.whole = SimpleNamespace(with_effects=lambda effects: effects)
    attribution.on_step = lambda share, words: said.append((share, words))
    one, two = made((1.0, 0.0), effects=[STRIBECK]), made((1.0, 0.0), effects=[DRAG])
    assert explainer.noise_of(one) is explainer.noise_of(one)
    explainer.noise_of(two)
    assert [joint for joint, _ in seen] == [(STRIBECK,), (DRAG,)]
    assert seen[0][1] is one.theta and seen[1][1] is two.theta
    assert said == [(1.0, 'telling noise from what the motion predicts')] * 2


def test_what_comes_near_is_taken_where_the_best_does_not_count(explainer):
    base = made((2.0, 0.0))
    # The data held out refute the best.
    best = made((0.0, 0.0), check=(1.9, 0.0), effects=[FRICTION])
    share = explainer.share(base, best)

    def leaves(share, effect, **more):
        left = 2.0 * (1.0 - share)
        return made((left, 0.0), effects=[effect], **more)

    near, better = leaves(0.62 * share, STRIBECK), leaves(0.65 * share, DRAG)
    edge, far = leaves(0.9 * share, SPRING, own=1.0), leaves(0.58 * share, DRAG)

    def chosen(*others):
        got = explainer.confirmed_one([base], [of_round(base, best, *others)], best)
        return got and got[-1]

    assert chosen(near) is near
    assert chosen(near, better) is better
    assert chosen(edge, near) is near, 'one at its bound comes last'
    assert chosen(edge) is edge
    assert chosen(far) is None and chosen() is None


def test_a_best_fit_that_is_refuted_gives_way_on_the_way(explainer, attribution):
    base = made((2.0, 0.0))
    best = made((0.0, 0.0), check=(1.9, 0.0), effects=[STRIBECK])
    near = made((0.98, 0.0), effects=[SPRING])
    assert explainer.best(of_round(base, best, near)) is best
    attribution.refits = {(): base}
    rounds_of(attribution, [best, near], [])
    got = explainer.explain(base, [], lambda e: None)
    assert got.chain == (base, near) and got.complete


@pytest.mark.parametrize(('errors', 'counts'), [(np.inf, True), (5.0, True), (3.0, False)])
def test_a_step_that_slow_noise_may_make_does_not_count(explainer, attribution, errors, counts):
    # It takes away 0.8 of the noise, 0.28 at the lower end of an interval of 3 standard errors.
    base, one = made((0.64, 0.0)), made((0.0, 0.0), effects=[STRIBECK])
    attribution.errors = errors
    assert explainer.material(base, one)
    assert explainer.counts(base, one) == counts


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
