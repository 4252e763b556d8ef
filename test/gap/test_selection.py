# SPDX-License-Identifier: Apache-2.0
"""The forward selection over fits made of numbers: nothing is simulated here."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gap.test_rules import DRAG, DRIVES, made, RULES, SAMPLES, STRIBECK
from ros2_ident.gap import selection
from ros2_ident.gap.hypothesis import Round
from ros2_ident.gap.imitation import noise_does
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.selection import Selector
from ros2_ident.gates.law import Gain, Law
from ros2_ident.models import EffectAt
from ros2_ident.recording.motion import low_pass
from ros2_ident.search.noise import NoiseModel


def floor_of(*innovations):
    """Return a floor of one, of noise whose own past leaves these shares of its variance open."""
    one = np.ones(2)
    noise = [NoiseModel(np.empty(0), 1.0, x, SAMPLES) for x in innovations]
    return Floor(one, one, one, 'prediction', tuple(noise))


@pytest.fixture
def selector():
    """Return a selection whose fits are numbers."""
    model = SimpleNamespace(machine=None, noise=0.1, thinned=False)
    part = SimpleNamespace(drive=np.repeat([0, 1], SAMPLES), models=[model])
    case = SimpleNamespace(fit=part, check=part, drives=DRIVES)
    found = Selector(case, floor_of(1.0, 1.0), RULES)
    found.ends = lambda e, evidence: (e.theta - 0.1, e.theta + 0.1)
    found.tie = lambda base, e, at, hidden: None
    # Noise that is white: what counts stands out of it.
    found.standing = lambda before, after: 100.0
    return found


def test_what_the_fit_before_closes_on_its_way_is_no_merit_of_an_effect(selector):
    base, best = made((2.0, 0.0)), made((0.2, 0.0), effects=[STRIBECK])
    selector.round = lambda before, candidates: Round(before, {}, (best,))
    selector.with_new_floor = lambda chain, rounds: (chain, rounds)
    for left, names in ((0.3, ()), (1.9, (STRIBECK,))):
        selector.refit = lambda effects, theta, left=left: made((left, 0.0), effects)
        said = selector.select(base, [STRIBECK], lambda base, e: None)
        assert (said.chain[-1].effects, float(said.chain[0].fit[0])) == (
            names, SAMPLES * (1.0 + left),
        )  # fmt: skip


def test_what_a_fit_closes_by_chance_leaves_the_one_before(selector):
    base, best = made((2.0, 0.0)), made((0.2, 0.0), effects=[STRIBECK])
    selector.round = lambda before, candidates: Round(before, {}, (best,))
    selector.with_new_floor = lambda chain, rounds: (chain, rounds)
    runs_away = replace(made((0.3, 0.0)), check=SAMPLES * np.array([400.0, 1.0]))
    selector.refit = lambda effects, theta: best if effects else runs_away
    said = selector.select(base, [STRIBECK], lambda base, e: None)
    assert said.chain[0] is base and said.chain[1].effects == (STRIBECK,)


def test_what_is_closed_is_told_in_units_of_the_floor_that_the_fits_have(selector):
    old = [made((4.0, 0.0)), made((2.0, 0.0), [STRIBECK])]
    new = [made((16.0, 0.0)), made((8.0, 0.0), [STRIBECK]), made((4.0, 0.0), [STRIBECK, DRAG])]
    selector.round = lambda before, candidates: Round(
        before, {}, (old[1] if not before.effects else new[2],)
    )
    selector.with_new_floor = lambda chain, rounds: (new[: len(chain)], rounds)
    selector.refit = lambda effects, theta: next(
        (x for x in new[:0:-1] if x.effects == tuple(effects)), new[0]
    )
    shares = []
    selector.select(old[0], [STRIBECK, DRAG], lambda base, e: shares.append(e.closes(base)))
    assert shares == [0.5, 0.75]


def test_a_law_whose_numbers_another_cause_took_up_is_put_in_plainer_words(selector):
    force, spring = EffectAt('constant_force', 'one'), EffectAt('cable_spring', 'one')
    base, both = made((4.0, 2.0)), [DRAG, spring]
    first = Round(base, {}, (made((0.5, 2.0), [spring]), made((1.0, 2.0), [force])))
    left = {(DRAG,): 4.0, (force,): 1.0}
    selector.refit = lambda effects, theta: made((left[tuple(effects)], 0.0), effects)
    chain = [base, made((4.0, 0.0), [DRAG]), made((0.0, 0.0), both)]
    for gap, named in ((0.03, force), (0.2, spring)):
        left[DRAG, force] = gap
        ended, rests = selector.with_plainer_laws(chain, (base, chain[1]), [first])
        assert ended[-1].effects == (DRAG, named)
        assert len(rests) == 2


def test_a_stop_that_ended_in_the_middle_of_the_way_has_to_do_more_than_what_is_smooth(selector):
    stop = EffectAt('end_stop', 'one')
    base, rest, final = made((4.0, 2.0)), made((1.0, 0.0), [DRAG]), made((0.0, 0.0), [DRAG, stop])
    ended = replace(final, unit=np.array([0.5, 0.5, 0.5, 0.5, 1.0, 1.0]))
    selector.refit = lambda effects, theta: base if not effects else rest
    for last, tie, left in ((final, True, 2), (ended, False, 2), (ended, True, 1)):
        selector.tie = lambda base, e, at, hidden, tie=tie: tie
        chain = [base, rest, last]
        chain, rests = selector.with_plainer_laws(chain, (made((3.0, 0.0), [stop]), rest), [])
        assert chain[-1].effects == (DRAG, stop)[:left]
        assert len(rests) == left


def test_effects_that_something_else_imitates_are_ties_and_no_names(selector, monkeypatch):
    base, fitted = made((2.0, 0.0)), (made((0.1, 0.0), [DRAG]), made((0.3, 0.0), [STRIBECK]))
    del selector.tie
    for own, alone, place, like in (
        (0.01, 2.0, 0.3, ('parameters',)),
        (0.6, 0.2, 0.3, ('parameters',)),
        (0.6, 2.0, 0.13, ('position',)),
    ):
        others = {
            DRAG: {'parameters': alone, 'position': place, 'time': 0.2},
            STRIBECK: {'parameters': 2.0, 'position': 0.2},
        }

        def instead(fits, e, at, others=others, own=own):
            both = made((0.1, 0.0))
            gaps = {name: (made((left, 0.0)), both) for name, left in others[at].items()}
            return own if at == DRAG else 0.6, gaps

        monkeypatch.setattr(selection, 'in_place_of', instead)
        left, ties = selector.untied(Round(base, {}, fitted))
        assert [e.effects for e in left.fitted] == [(STRIBECK,)]
        assert [(tie.effect, tie.like, tie.beside) for tie in ties] == [(DRAG.effect, like, 0)]
        step = Round(base, {}, (made((0.1, 0.0), [STRIBECK, DRAG]),))
        assert [(x.effect, x.beside) for x in selector.untied(step)[1]] == [(DRAG.effect, 1)]


def test_a_gain_that_the_law_of_the_log_refutes_is_no_effect(selector):
    """A log slower than its controllers named a gain, which its own law knew to be right."""
    # Of the second drive the velocity gain is another one, and its fit is near it.
    one = Gain('position_gain', 50.1, 50.0, 0.0101, 0.02)
    two = Gain('velocity_gain', 6.0, 5.0, 0.01, 0.1)
    selector.laws = {
        'one': Law('one', (one,), 0.0, 0.0, 0.01, 0.0102, 0.99, 0.0),
        'two': Law('two', (two,), 0.0, 0.0, 0.01, 0.1, 0.99, 0.0),
    }
    for effect, where, size, refuted in (
        ('position_gain_error', 'one', 2.5, True),
        ('position_gain_error', 'one', 1.0, False),
        ('position_gain_error', 'two', 2.5, False),
        ('velocity_gain_error', 'two', 1.1, False),
        ('velocity_gain_error', 'two', 0.9, True),
        ('stribeck', 'one', 2.5, False),
    ):
        e = made((0.2, 0.0), effects=[EffectAt(effect, where)])
        e = replace(e, theta=np.concatenate([e.theta[:2], np.full(len(e.theta) - 2, size)]))
        assert selector.refuted(e) is refuted, effect
        left, _ = selector.untied(Round(made((2.0, 0.0)), {}, (e,)))
        assert left.fitted == (() if refuted else (e,))
    # Where no gain explains the effort, it follows another law.
    selector.laws = {'one': replace(selector.laws['one'], misfit=0.001)}
    e = made((0.2, 0.0), effects=[EffectAt('position_gain_error', 'one')])
    assert not selector.refuted(replace(e, theta=np.array([1.0, 2.0, 2.5])))


@pytest.mark.parametrize(('second', 'where', 'beats'), [
    (41.7, 'one', True), (45.2, 'one', False), (41.7, 'two', False),
])  # fmt: skip
def test_two_orders_that_the_stroke_does_not_part_are_no_two_ripples(
    selector, second, where, beats
):
    """Two of 41.7 and 42.2 a turn, over a third of one, had large sizes of opposite sign."""
    stroke = 0.35 * 2.0 * np.pi * np.linspace(0.0, 1.0, 100)
    selector.split.fit.models[0] = SimpleNamespace(
        data=SimpleNamespace(names=DRIVES, position=np.stack([stroke] * 2), command_position=None),
        motor_turn=lambda place: 0.0,
        travel=('rad', 1.0),
    )
    effects = [EffectAt('torque_ripple', 'one')]
    effects.append(EffectAt('torque_ripple_2' if where == 'one' else 'torque_ripple', where))
    e = made((0.2, 0.0), effects)
    sizes = [[0.23, -0.28, 42.2], [0.02, 0.35, second]]
    e = replace(e, theta=np.concatenate([e.theta[: e.columns(0)[0]], *sizes]))
    left, _ = selector.untied(Round(made((2.0, 0.0)), {}, (e,)))
    assert left.fitted == (() if beats else (e,))


def test_a_floor_too_large_and_slow_for_noise_is_told(selector):
    selector.floor, model = floor_of(1.0, 0.1), selector.split.fit.models[0]
    for stated, drives in ((0.1, ['two']), (0.3, [])):
        model.noise = stated
        assert list(selector.restless()) == drives
    # A noise that the machine file does not state says nothing.
    model.machine = SimpleNamespace(stated=lambda name: False)
    assert not selector.restless()
    selector.floor = floor_of(1.0, 1e-3)
    assert selector.restless() == {'two': 1.0}
    # Below a frequency all noise is slow.
    model.thinned = True
    assert not selector.restless()


def test_a_log_that_has_noise_above_the_cut_off_was_not_smoothed():
    rng, cycle, period = np.random.default_rng(3), 0.002, 0.1
    smoothing = EffectAt('effort_smoothing', 'all')
    slow = low_pass(rng.normal(0.0, 1.0, (1, 4000)), cycle, 1.0 / period, 2)[0]

    def noisy(logged):
        data = SimpleNamespace(names=['one'], effort=logged[None])
        model = SimpleNamespace(data=data, places=['one'], cycle=cycle)
        whole = SimpleNamespace(each=lambda theta: [(model, theta)])
        split = SimpleNamespace(whole=SimpleNamespace(with_effects=lambda effects: whole))
        e = SimpleNamespace(
            effects=[smoothing], theta=np.array([period]), columns=lambda place: [0]
        )
        return noise_does(SimpleNamespace(split=split), e, smoothing)

    for smoothed in (slow, np.round(slow, 2)):
        assert not noisy(smoothed)
    noise = rng.normal(0.0, 0.02, slow.shape)
    for rough in (slow + noise, np.round(slow + noise, 2)):
        assert noisy(rough)
