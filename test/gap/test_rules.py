# SPDX-License-Identifier: Apache-2.0
"""The rules of the diagnosis, one by one, on fits made of numbers: nothing is simulated here."""

import math
from pathlib import Path
import re

from gap_fits import (
    Attribution,
    DRAG,
    explainer_of,
    FRICTION,
    made,
    of_round,
    RULES,
    size_of,
    SPRING,
    STRIBECK,
)
import numpy as np
import pytest

from ros2_ident.gap.criteria import Rules
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


# ---------------------------------------------------------------------- what counts


@pytest.mark.parametrize(
    ('fall', 'first', 'counts'),
    [
        (0.45**2, True, True),
        (0.3**2, True, False),
        (0.45**2, False, False),
        (0.6**2, False, True),
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
    assert all(at is b for at, b in zip(attribution.asked, (base, one), strict=True))
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
    assert [e.effects for e in explainer.pruned([base, one], both)] == [(), (DRAG,)]
    attribution.refits = {(DRAG,): made((1.0, 0.0), effects=[DRAG])}
    assert explainer.pruned([base, one], both) == [base, one, both]


def test_an_effect_on_every_drive_comes_in_at_once_where_it_counts(explainer, attribution):
    other = EffectAt(DRAG.effect, 'one')
    base, single = made((4.0, 4.0)), made((4.0, 0.1), effects=[DRAG])
    first, both = made((0.1, 4.0), effects=[other]), made((0.1, 0.1), effects=[other, DRAG])
    rounds_of(attribution, [single, both])
    attribution.refits = {(): base, (DRAG,): single, (other,): first}
    got = explainer.explain(base, [], print)
    assert [e.effects for e in got.chain] == [(), (other,), (other, DRAG)]
    assert got.rounds[0].alone == {DRAG: single}
    # One that does not count on a drive is not named there.
    attribution.refits = {(): base, (DRAG,): made((0.1, 0.1), effects=[DRAG]), (other,): first}
    rounds_of(attribution, [single, both])
    assert explainer.explain(base, [], print).chain[-1].effects == (DRAG,)


def test_the_first_effect_is_the_largest(explainer, attribution):
    base, one = made((4.0, 3.0)), made((0.1, 3.0), effects=[STRIBECK])
    both = made((0.1, 0.1), effects=[STRIBECK, DRAG])
    other = made((0.1, 0.1), effects=[DRAG, STRIBECK])
    alone = made((4.0, 0.1), effects=[DRAG])
    attribution.refits = {(DRAG,): alone, (DRAG, STRIBECK): other}
    chain, rests = [base, one, both], (alone, one)
    assert explainer.ordered(chain, rests) == (chain, rests)
    more = (made((1.0, 0.1), effects=[DRAG]), one)
    assert explainer.ordered(chain, more) == ([base, alone, other], (one, more[0]))


def test_a_stopped_search_says_that_it_is_not_complete(explainer, attribution):
    attribution.stop = True
    got = explainer.explain(made((4.0, 0.0)), [], print)
    assert not got.complete and not attribution.asked


# ---------------------------------------------------------------------- what is left to tell


@pytest.mark.parametrize(('errors', 'counts'), [(np.inf, True), (5.0, True), (3.0, False)])
def test_a_step_that_slow_noise_may_make_does_not_count(explainer, attribution, errors, counts):
    # It takes away 0.8 of the noise, 0.28 at the lower end of an interval of 3 standard errors.
    base, one = made((0.64, 0.0)), made((0.0, 0.0), effects=[STRIBECK])
    attribution.errors = errors
    assert explainer.material(base, one)
    assert explainer.counts(base, one) == counts
