# SPDX-License-Identifier: Apache-2.0
"""The verdict in words: what is missing where, how far it closes the gap, and the next steps."""

from dataclasses import replace

import pytest
from report_cases import diagnosed

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.result import Cause, Ranked, Tie
from ros2_ident.models import EffectAt
from ros2_ident.words import verdict as words
from ros2_ident.words.figures import interval

FILTER = EffectAt('effort_smoothing', 'all')
ONE = 'Stribeck friction on drive_1 is missing in the simulation'
MANY = (
    EffectAt('constant_force', 'wrist_2_joint'),
    EffectAt('asymmetric_friction', 'wrist_1_joint'),
    EffectAt('load_dependent_friction', 'shoulder_lift_joint'),
)


@pytest.mark.parametrize(
    ('value', 'low', 'high', 'told'),
    [
        (95.106, 95.072, 95.140, '± 0.034'),
        (95.106, 95.072, 95.160, '[95.072, 95.16]'),
        (-1.0999, -1.9, 0.324, '[-1.9, 0.324]'),
        (0.0018, 0.0, 0.08, '[0, 0.08]'),
        (2.0, 2.0, 2.0, '± 0'),
        (2.0, 1.0, 1.0, '± 0'),
        (1.0, float('-inf'), 2.0, '-'),
        (1.0, float('nan'), 2.0, '-'),
        (5e-324, 0.0, 1e300, '[0, 1e+300]'),
    ],
)
def test_an_interval_is_told_by_its_ends_where_its_halves_differ(value, low, high, told):
    assert interval(value, low, high) == told


def test_of_an_effort_that_is_mostly_unexplained_it_is_not_said_that_nothing_is_missing():
    found = diagnosed()
    drives, facts = found.per_drive, replace(found.facts, cause=Cause.NONE)
    found = replace(found, facts=facts, evidence={**found.evidence, 'size': 0.1})
    assert 'is missing: the residual is noise' in words.sentence(found)
    noisy = {x: replace(g, noise_floor=0.75 * g.torque_rms) for x, g in drives.items()}
    one = words.sentence(replace(found, per_drive={**drives, 'drive_2': noisy['drive_2']}))
    assert 'is missing: the residual is noise' in one
    assert '; nothing can be said of drive_2: neither the model nor what came before' in one
    both = words.sentence(replace(found, per_drive=noisy))
    assert both.startswith('Nothing can be said of drive_1 and drive_2: neither the model nor')
    assert 'missing' not in both.split(';')[0] and 'at most 75 % of the effort' in both


@pytest.mark.parametrize(
    ('effects', 'headline', 'all_of_it'),
    [
        ((EffectAt('stribeck', 'drive_1'),), ONE, ONE),
        (
            (FILTER,), 'The log is off, not the simulation: smoothed effort',
            'The log is off, not the simulation: smoothed effort',
        ),
        (
            (FILTER, EffectAt('stribeck', 'drive_1')),
            f'{ONE}; the log is off, too: smoothed effort',
            f'{ONE}; the log is off, too: smoothed effort',
        ),
        (
            (FILTER, *MANY),
            'Constant force on wrist_2_joint and 2 more effects are missing in the simulation',
            'Constant force on wrist_2_joint, asymmetric friction on wrist_1_joint and '
            'load-dependent friction on shoulder_lift_joint are missing in the simulation; the '
            'log is off, too: smoothed effort',
        ),
    ],
)  # fmt: skip
def test_headline_and_sentence_name_the_effects_and_their_places(effects, headline, all_of_it):
    first, *also = effects
    found = replace(diagnosed(), effect=first.effect, where=(first.where,), also=tuple(also))
    assert words.headline(found) == f'{headline}.'
    closes = 'they close' if also else 'it closes'
    said = words.sentence(found)
    assert said.startswith(f'{all_of_it}; {closes} 97 % of a gap of 2.90 times the noise floor, ')


@pytest.mark.parametrize(
    ('beside', 'said'),
    [
        (0, 'Gear flexibility on drive_1 would close 51 % of it, but functions of the '),
        (3, 'Gear flexibility on drive_1 and 3 more would together close 51 % of it, but in its '
         'place functions of the position do about as well'),
    ],
)  # fmt: skip
def test_a_tie_closes_what_its_step_closes(beside, said):
    found = diagnosed()
    tie = Tie('gear_flexibility', 'drive_1', 0.51, ('position',), beside)
    facts = replace(found.facts, cause=Cause.UNKNOWN, best=0.2, ties=(tie,))
    assert said in words.sentence(replace(found, effect='unknown', facts=facts))


def test_a_small_gap_is_called_small():
    found = diagnosed()
    small = {n: replace(g, share_of_output=0.0048) for n, g in found.per_drive.items()}
    said = words.headline(replace(found, per_drive=small))
    assert said == f'The gap is small, 0.48 % of the effort. {ONE}.'
    # a load that stays the same makes no gap small
    held = {n: replace(g, share_of_change=0.3) for n, g in small.items()}
    assert words.headline(replace(found, per_drive=held)) == f'{ONE}.'


def test_advice_tells_effects_apart_and_lists_those_not_visible():
    found = replace(diagnosed(), not_testable=())
    rival = Ranked(EffectAt('quadratic_drag', 'drive_1'), 0.4, 0.1, 0.9, {})
    (one,) = words.advice(replace(found, confusable=(found.ranking[0], rival)))
    assert 'cannot be told apart' in one and CATALOGUE['quadratic_drag'].title in one
    rivals = (replace(found.ranking[0], probability=0.5), replace(rival, probability=0.2))
    assert words.headline(replace(found, confusable=rivals)) == (
        f'{ONE}, or quadratic drag, which this motion cannot tell from it.'
    )
    rivals = (rivals[0], replace(rival, probability=0.1))
    assert words.headline(replace(found, confusable=rivals)) == f'{ONE}.'
    both = (EffectAt('stribeck', 'drive_1'), EffectAt('stribeck', 'drive_2'))
    (seen,) = words.advice(replace(found, not_testable=both))
    assert seen == f'This motion cannot show: {CATALOGUE["stribeck"].title} (any drive).'
    unknown = replace(found, effect='unknown', facts=replace(found.facts, cause=Cause.UNKNOWN))
    assert 'isolate the drive' in next(words.advice(unknown))
    assert not list(words.advice(replace(unknown, probability=0.0)))


@pytest.mark.parametrize('told', [True, False])
def test_parameters_that_end_at_a_bound_of_the_machine_file_are_told(told):
    found, name = diagnosed(), 'drive_1.coulomb_torque'
    one = replace(found.parameters[name], at_bound=told)
    said = ' '.join(words.at_bounds(replace(found, parameters={**found.parameters, name: one})))
    assert 'the effect is larger' not in said
    assert (f'{name} lies at a bound of the machine file' in said) is told
