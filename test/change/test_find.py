# SPDX-License-Identifier: Apache-2.0
"""Two sides of an axis whose change is known."""

from dataclasses import replace
import json
import math
from pathlib import Path
from types import SimpleNamespace

from arm_cases import described
import numpy as np
import pytest

from ros2_ident import jobs
from ros2_ident.change import find
from ros2_ident.change.columns import Column, columns_of, Homed, shifted
from ros2_ident.change.noise import noise_apart
from ros2_ident.change.result import Apart, Change, Comparison, Size, Suspect, Visible
from ros2_ident.change.sides import Move, Sides
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.rules import Rules
from ros2_ident.identify import hidden
from ros2_ident.models import EffectAt, load_machine, Output
from ros2_ident.recording import read_bags, write_bag
from ros2_ident.search.changes import Changes, evidence_of, Logs
from ros2_ident.search.jacobian import Box
from ros2_ident.search.noise import NoiseModel, Run
from ros2_ident.words.change import differing, sentences

ROOT = Path(__file__).parents[2]
AXIS = ROOT / 'config/emps.yaml'


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return logs of an axis: two as it was, one with another mass, one with an effect more."""
    folder = tmp_path_factory.mktemp('logs')
    for number, (name, more) in enumerate({
        'one': [],
        'two': [],
        'heavy': ['--set', 'moving_mass=77'],
        'worn': ['--effect', 'stribeck@emps_axis:torque=4,velocity=0.004'],
        'loaded': ['--set', 'moving_mass=170'],
        'limited': ['--effect', 'torque_saturation@emps_axis:share=0.15'],
        'tuned': ['--effect', 'velocity_gain_error@emps_axis:factor=1.5'],
        'rough': ['--noise', '6'],
        'coarse': ['--effect', 'encoder_quantisation@emps_axis:step=2e-5'],
    }.items()):  # fmt: skip
        words = ['simulate', f'{folder}/{name}', '--machine', str(AXIS), '--motion', 'reversals']
        assert main([*words, '--seconds', '6', '--seed', str(number), *more]) == 0
    return folder


def compared(made: Path, before: list[str], after: list[str]) -> jobs.Compared:
    request = jobs.Request(load_machine(AXIS), bags=tuple(str(made / x) for x in before))
    return jobs.compare(request, [str(made / x) for x in after])


def test_an_unchanged_machine_is_unchanged(made):
    found = compared(made, ['one'], ['two']).result
    assert not found.changes and found.complete and not found.believed
    mass = next(x for x in found.smallest if x.suspect.name == 'emps_axis.moving_mass')
    assert 0.01 < mass.size < 1.0 and mass.unit == 'kg'
    said = list(sentences(found))
    assert 'No change shows.' in said and 'Give several logs of each side' in said[-1]


def test_what_comes_and_goes_within_a_side_is_no_change(made, tmp_path):
    # Heavier in the first and third quarter of the log after, as before in the others.
    logs, mixed = [read_bags([made / x])[0] for x in ('heavy', 'two')], {}
    for role, first in logs[0].streams.items():
        both = first, logs[1].streams[role]
        there = [(x.stamp - x.stamp[0]) // 1_500_000_000 % 2 == i for i, x in enumerate(both)]
        stamps = np.concatenate(
            [(x.stamp - x.stamp[0])[t] for x, t in zip(both, there, strict=True)]
        )
        each = {
            key: np.concatenate([getattr(x, key)[t] for x, t in zip(both, there, strict=True)])[
                np.argsort(stamps)
            ]
            for key in ('position', 'velocity', 'effort')
            if getattr(first, key) is not None
        }
        mixed[role] = replace(first, stamp=np.sort(stamps), **each)
    write_bag(tmp_path / 'mixed', replace(logs[0], **mixed))
    found = compared(made, ['one'], [str(tmp_path / 'mixed')]).result
    assert not any(x.suspect.name == 'emps_axis.moving_mass' for x in found.changes)
    assert not found.changes or not found.believed
    assert any('parts of one side differ by as much' in x for x in sentences(found))


def test_parts_of_long_logs_have_both_sides(made, monkeypatch):
    monkeypatch.setattr(hidden, 'MOST', 300_000)  # an eighth of the samples
    found = compared(made, ['one'], ['heavy']).result
    assert [x.suspect.name for x in found.changes] == ['emps_axis.moving_mass']
    assert found.explained > 0.9 and found.believed


def test_a_change_is_named_with_its_size_and_written(made, tmp_path, capsys):
    words = ['diff', f'{made}/one', '--after', f'{made}/heavy', '--machine', str(AXIS)]
    assert main([*words, '--out', str(tmp_path), '--quiet']) == 0
    said = capsys.readouterr().out
    assert 'Changed: emps_axis.moving_mass by' in said, said
    told = json.loads((tmp_path / 'change.json').read_text(encoding='utf-8'))
    (change,) = told['changes']
    (size,) = change['sizes']
    assert size['low'] < 2.0 < size['high'] and size['high'] - size['low'] < 0.5
    assert told['explained'] > 0.8
    assert 'explains most of it' not in said
    page = (tmp_path / 'report.html').read_text(encoding='utf-8').replace('\xa0', ' ')
    assert 'Changed: emps_axis.moving_mass by' in page and f'after: {made}/heavy' in page
    assert '<th scope="row">emps_axis.viscous_friction</th>' in page
    (tmp_path / 'change.json').write_text('{"settings": {}}')
    assert main(['report', str(tmp_path)]) == 2
    assert told['settings']['after_bags'] == [f'{made}/heavy']


def test_an_effect_is_there_on_one_side(made):
    for before, after, side in (('one', 'worn', 'after'), ('worn', 'two', 'before')):
        found = compared(made, [before], [after]).result
        assert 'stribeck' in {x.name for c in found.changes for x in (c.suspect, *c.ties)}
        assert found.changes[0].suspect.side == side


def test_encoder_steps_are_a_change_though_no_simulation_repeats_their_course(made):
    for before, after, side in (('one', 'coarse', 'after'), ('coarse', 'one', 'before')):
        found = compared(made, [before], [after]).result
        (change,) = found.changes
        assert (change.suspect.name, change.suspect.side) == ('encoder_quantisation', side)
        (step,) = change.sizes
        assert step.low < 2e-5 < step.high < 1.01 * 2e-5
        assert found.believed
        assert change.suspect.name not in {x.suspect.name for x in found.smallest}
    assert not compared(made, ['coarse'], ['coarse']).result.changes


def test_noise_that_one_side_has_more_of_is_told(made):
    usual = load_machine(AXIS).effort_noise
    for before, after, sizes in (('one', 'rough', (usual, 6.0)), ('rough', 'one', (6.0, usual))):
        found = compared(made, [before], [after]).result
        assert not found.changes
        (noise,) = (x for x in found.apart if x.kind == 'noise')
        assert (noise.before, noise.after) == pytest.approx(sizes, rel=0.1)
        assert any(x.startswith('The noise differs: of emps_axis ') for x in sentences(found))
    plain = compared(made, ['one'], ['two']).result
    assert not [x for x in plain.apart if x.kind == 'noise']


@pytest.mark.parametrize('logged', [True, False])
def test_noise_is_compared_where_both_sides_have_an_output(logged):
    """Two outputs, of which the second may be on one side only; the first is predicted wholly."""
    runs = [Run(0, 400, 0), Run(400, 800, 1), Run(800, 1200, 0)]
    runs += [Run(1200, 1600, 1)] if logged else []
    count = runs[-1].stop
    rows = hidden.Rows((), tuple(runs), np.zeros(count, int), 1.0)
    fold = np.arange(count) % 400 // 50
    logs = Logs(
        (slice(0, 800), slice(800, count)), np.array([False, True]), np.zeros(2, int), fold
    )
    white = np.random.default_rng(1).standard_normal(count)
    white[1200:] *= 3.0
    white[:400] = 0.0
    noise = [NoiseModel(np.empty(0), 4.0, 4.0, 800)] * 2
    outputs = [Output('a', 'N'), Output('b', 'N')]
    told = {x.text: x for x in noise_apart(white, rows, logs, noise, outputs, 7.5)}
    assert set(told) == ({'a', 'b'} if logged else {'a'})
    if logged:
        assert (told['b'].before, told['b'].after) == pytest.approx((2.0, 6.0), rel=0.1)


def test_a_limit_that_acts_at_its_value_alone_is_found(made):
    for before, after, side in (('one', 'limited', 'after'), ('limited', 'two', 'before')):
        found = compared(made, [before], [after]).result
        (change,) = found.changes
        assert change.suspect == Suspect('effect', 'torque_saturation', 'emps_axis', side)
        assert change.sizes[0].low < 0.15 < change.sizes[0].high
        assert found.believed


def test_changes_of_friction_that_do_opposite_things_are_told_together(made, tmp_path):
    law = 'degressive_friction@emps_axis:torque=20,velocity=0.03'
    words = ['--set', 'coulomb_friction=10', '--effect', law, '--motion', 'reversals']
    words += ['--machine', str(AXIS), '--seconds', '6', '--seed', '9']
    assert main(['simulate', f'{tmp_path}/rough', *words]) == 0
    found = compared(made, ['one'], [str(tmp_path / 'rough')]).result
    assert len(found.changes) == 2
    (whole,) = found.friction
    states = read_bags([tmp_path / 'rough'])[0].streams['state']
    speed = np.gradient(states.position[:, 0], 1e-9 * states.stamp)
    moving = np.sign(np.where(np.abs(speed) > 1e-3, speed, 0.0))
    expected = 20.0 * (moving @ np.tanh(speed / 0.03)) / (moving @ moving) - 5.0  # of 15 N
    assert whole.low < expected < whole.high
    # Alone one of the two is - 5 N, the other twice as much as both.
    assert whole.high - whole.low < 0.5 * expected
    assert any(x.startswith('All changes of friction') for x in sentences(found))


def test_a_size_beyond_all_that_is_looked_for_would_not_show():
    stribeck = Suspect('effect', 'stribeck', 'x_axis')
    smallest = tuple(
        Visible(s, 'n', size, 'N', math.nan)
        for s, size in ((stribeck, math.inf), (replace(stribeck, name='backlash'), 2.0))
    )
    *_, said = sentences(Comparison((), math.nan, smallest, (), (2, 2), False, 5.0, True))
    assert said.endswith(
        'shown: backlash on x_axis 2 N. However large, these would not: Stribeck friction on '
        'x_axis.'
    )


def test_what_the_file_states_comes_before_effects_the_smallest_share_first():
    each = [
        Visible(Suspect('effect', 'stribeck', 'x_axis'), 'n', 1.0, 'N', math.nan),
        Visible(Suspect('constant', 'load_mass'), 'load_mass', 0.1, 'kg', 0.5),
        Visible(Suspect('effect', 'backlash', 'x_axis'), 'n', 1.0, 'm', math.nan),
        Visible(Suspect('parameter', 'x_axis.mass'), 'x_axis.mass', 1.0, 'kg', 10.0),
        Visible(Suspect('constant', 'gear_factor'), 'gear_factor', 0.1, '1/m', 100.0),
        Visible(Suspect('parameter', 'load_angle'), 'load_angle', 0.5, 'rad', 7e-4, signed=True),
    ]
    for smallest in (each, each[::-1]):
        found = Comparison((), math.nan, tuple(smallest), (), (2, 2), False, 5.0, True)
        *_, said = sentences(found)
        order = ['gear_factor', 'x_axis.mass', 'load_mass', 'load_angle 0.5 rad,']
        assert sorted(order, key=said.index) == order
        assert said.index('load_angle') < min(said.index('Stribeck'), said.index('backlash'))


@pytest.mark.parametrize(
    ('size', 'told'),
    [
        (Size('x', -0.8, -1.0, -0.6, 'N', -3.2, signed=True), 'x by -0.8 N ± 0.2.'),
        (Size('x', -0.8, -1.0, -0.6, 'N', 3.2), 'x by -0.8 N ± 0.2 (-25 %).'),
        (Size('x', -0.8, -math.inf, math.inf, 'N', 3.2),
         'x is smaller, by how much these logs do not tell.'),
    ],
)  # fmt: skip
def test_a_change_is_told_by_its_share_where_that_says_something(size, told):
    change = Change(Suspect('parameter', 'x'), (size,), 30.0, ())
    found = Comparison((change,), 0.9, (), (), (2, 2), False, 5.0, True)
    assert f'Changed: {told}' in sentences(found)


def test_friction_of_another_form_by_one_per_cent_is_no_change(tmp_path):
    law = 'position_dependent_friction@emps_axis:slope=0.1,middle=0'
    for name, more in (('one', ['--seed', '1']), ('two', ['--seed', '2', '--effect', law])):
        words = ['simulate', f'{tmp_path}/{name}', '--machine', str(AXIS), '--motion', 'reversals']
        assert main([*words, '--seconds', '12', '--noise', '0.2', *more]) == 0
    found = compared(tmp_path, ['one'], ['two']).result
    assert not found.changes and math.isnan(found.explained)
    (law,) = (x for x in found.apart if x.kind == 'friction')
    assert law.text.endswith('slope') and law.before == 0.0
    assert law.after == pytest.approx(0.1, abs=0.03)
    smallest = {f'{x.suspect.name} {x.name}': x.size for x in found.smallest}
    # In 95 of 100 logs each friction is within 2 % of its mean, also where it is asymmetric.
    friction = next(x for x in found.smallest if x.name == 'emps_axis.coulomb_friction')
    assert smallest['asymmetric_friction coulomb'] > 0.02 * friction.value
    assert next(sentences(found)).startswith(f'Friction differs by {law.text} ')


def test_a_law_is_told_from_friction_where_it_acts(tmp_path):
    # A sixth of the Coulomb friction, at low speed: little of all friction along a fast motion.
    law = 'stribeck@emps_axis:torque=2.5,velocity=0.005'
    for name, more in (('one', ['--seed', '1']), ('two', ['--seed', '2', '--effect', law])):
        words = ['simulate', f'{tmp_path}/{name}', '--machine', str(AXIS), '--motion', 'multisine']
        assert main([*words, '--seconds', '12', '--noise', '0.2', *more]) == 0
    (change,) = compared(tmp_path, ['one'], ['two']).result.changes
    assert change.suspect.name == 'stribeck'
    (torque,) = (x for x in change.sizes if x.name.endswith('torque'))
    assert torque.low < 2.5 < torque.high and torque.low > 1.0


def test_a_law_is_judged_by_its_sizes_alone(made, monkeypatch):
    # Odds of 19 to 1 among all that may have changed by one number, and not by two.
    monkeypatch.setattr(Changes, 'beyond', lambda *args: 20.0)
    found = compared(made, ['one'], ['worn']).result
    assert evidence_of(20.0, 2) < found.price < evidence_of(20.0, 1)
    assert [x.suspect.name for x in found.changes] == ['stribeck']


def test_a_large_change_is_one_change(made):
    # Beyond the box of what was known before; and a gain, which comes before effects like it.
    gain = 0.5 * load_machine(AXIS).number('velocity_gain')
    for after, name, size in (
        ('loaded', 'emps_axis.moving_mass', 95.0), ('tuned', 'velocity_gain', gain),
    ):  # fmt: skip
        (change,) = compared(made, ['one'], [after]).result.changes
        (told,) = change.sizes
        assert told.name == name and told.low < size < told.high
        assert told.high - told.low < 0.05 * size
    assert 'velocity_gain_error' in {x.name for x in change.ties}


def test_a_stated_number_is_judged_by_the_parts_of_a_log_too(made, monkeypatch):
    monkeypatch.setattr(Changes, 'beyond', lambda *args: 0.0)
    found = compared(made, ['one'], ['tuned']).result
    assert not found.changes
    (one,) = (x for x in found.apart if x.kind == 'scatter')
    assert one.text == 'velocity_gain' and one.after / one.before == pytest.approx(1.5, rel=0.03)


def test_the_derivative_by_a_stated_number_begins_where_each_side_is(made):
    request = jobs.Request(load_machine(AXIS), bags=(f'{made}/one', f'{made}/tuned'))
    problem = request.problem(jobs.read(request).fit)
    gain = load_machine(AXIS).number('velocity_gain')
    sides = Sides(problem.models, np.array([False, True])).stating('velocity_gain', 2.0 * gain)
    assert sides.stated == {'velocity_gain': (gain, 2.0 * gain)}
    assert sides.times('velocity_gain', 1.1).stated == {
        'velocity_gain': pytest.approx((1.1 * gain, 2.2 * gain))
    }
    assert not sides.less(None, 'velocity_gain').stated


def test_the_last_fit_is_made_with_its_own_noise(made, tmp_path, monkeypatch):
    law = '--effect', 'degressive_friction@emps_axis:torque=20,velocity=0.03', '--seed', '7'
    words = 'simulate', f'{tmp_path}/two', '--machine', str(AXIS), '--motion', 'reversals'
    assert main([*words, '--seconds', '6', *law]) == 0
    # A price of 2, for what a log of 6 s makes of it.
    monkeypatch.setattr(find, '_SURE', 2.0)
    monkeypatch.setattr(find, 'price_of', lambda count: 0.0)
    monkeypatch.setattr(Rules, 'most', 1)
    plain, rounds = find._round, list[find._Round]()

    def looked(*given, **more):
        rounds.append(plain(*given, **more))
        return rounds[-1]

    monkeypatch.setattr(find, '_round', looked)
    compared(made, ['one'], [f'{tmp_path}/two'])
    last = rounds[-1]
    better = find._fitted(last, last.sides, last.theta, lambda: False)
    assert better.loss + 2.0 > last.loss


def test_a_change_may_be_larger_than_the_box(made, tmp_path):
    # A box of 10 kg, and a change of 95.
    text = AXIS.read_text(encoding='utf-8').replace('[50.0, 150.0, kg]', '[70.0, 80.0, kg]')
    (tmp_path / 'axis.yaml').write_text(text, encoding='utf-8')
    request = jobs.Request(load_machine(tmp_path / 'axis.yaml'), bags=(f'{made}/one',))
    (change,) = jobs.compare(request, [f'{made}/loaded']).result.changes
    (told,) = change.sizes
    assert told.name == 'emps_axis.moving_mass' and told.low < 95.0 < told.high


def test_a_change_that_ends_at_nothing_has_a_derivative(made):
    request = jobs.Request(load_machine(AXIS), bags=(f'{made}/one', f'{made}/worn'))
    problem = request.problem(jobs.read(request).fit)
    friction = next(
        p for p in problem.models[0].parameters if p.name == 'emps_axis.viscous_friction'
    )
    sides = Sides(problem.models, np.array([False, True]), moved=[Move.single(friction)])
    at = sides.names.index('emps_axis.viscous_friction')
    theta = np.append(sides.low[:4] + 0.3 * (sides.high - sides.low)[:4], -300.0)
    found = sides.inside(theta)
    assert found[-1] == -theta[at] and np.array_equal(found[:-1], theta[:-1])
    assert np.array_equal(sides.own(1, theta), sides.own(1, found))
    assert sides.own(1, found + 1e-3 * (np.arange(5) == 4))[0, at] == pytest.approx(1e-3)


def test_zeros_of_turning_and_sliding_joints_have_their_own_units(tmp_path):
    (tmp_path / 'arm.yaml').write_text(
        'machine: serial\ndrives: [turn, slide]\neffort_unit: N m\neffort_noise: 0.05\n'
        'geometry: {dh_a: [0.0, 0.1], dh_alpha: [1.2, 0.0], dh_d: [0.0, 0.0],\n'
        '  dh_theta: [0.0, 0.0], joint: [revolute, prismatic]}\ncontroller: {cycle: 0.004}\n'
        'parameters: {coulomb_torque: [0.0, 2.0, N m]}\n'
    )
    words = ['simulate', f'{tmp_path}/log', '--machine', f'{tmp_path}/arm.yaml']
    assert main([*words, '--seconds', '2']) == 0
    request = jobs.Request(load_machine(tmp_path / 'arm.yaml'), bags=(f'{tmp_path}/log',))
    none, turn, slide = shifted(request.problem(jobs.read(request).fit))
    assert not none.drive and (turn.unit, slide.unit) == ('rad', 'm')
    # A degree, and what a lever of 50 mm makes of it.
    assert turn.by == pytest.approx(math.radians(1.0))
    assert slide.by == pytest.approx(0.05 * turn.by)


def test_pairs_need_as_many_bags(made):
    request = jobs.Request(load_machine(AXIS), bags=(str(made / 'one'), str(made / 'two')))
    with pytest.raises(IdentError, match='2 bags before and 1 after are no pairs') as error:
        jobs.compare(request, [str(made / 'heavy')], paired=True)
    assert error.value.code is ErrorCode.INVALID_GOAL


def test_encoders_that_are_homed_anew_are_no_change(tmp_path):
    machine, shift = ROOT / 'config/double_pendulum.yaml', np.radians([1.0, -1.0])
    links = {'shoulder.link_moment_x': 0.2, 'elbow.link_moment_x': 0.15,
             'elbow.link_inertia_zz': 0.05, 'drive_inertia': 0.02, 'coulomb_torque': 0.15,
             'viscous_torque': 0.02, 'measurement_delay': 0.002}  # fmt: skip
    for number, name in enumerate(('one', 'two', 'loaded'), 10):
        own = {**links, 'elbow.link_moment_x': 0.155} if name == 'loaded' else links
        words = [x for key, value in own.items() for x in ('--set', f'{key}={value}')]
        words += ['--machine', str(machine), '--seconds', '8', '--seed', str(number)]
        assert main(['simulate', str(tmp_path / name), *words]) == 0
        (log,) = read_bags([tmp_path / name])
        moved = {role: replace(x, position=x.position + shift)
                 for role, x in log.streams.items() if x.position is not None}  # fmt: skip
        write_bag(tmp_path / f'{name}_homed', replace(log, **moved))
    request = jobs.Request(load_machine(machine), bags=(str(tmp_path / 'one'),))
    found = jobs.compare(request, [str(tmp_path / 'two_homed')]).result
    assert not found.changes
    told = {x.text: x.after for x in found.apart if x.kind == 'zero'}
    # A degree of the elbow is 3 mN m at least; in 8 s of 5 Hz noise leaves 0.7 mN m, 0.2 degrees.
    assert told == pytest.approx(
        dict(zip(('shoulder', 'elbow'), shift, strict=True)), abs=np.radians(0.5)
    )
    # a load is heavier by more than another zero makes it
    (change,) = jobs.compare(request, [str(tmp_path / 'loaded_homed')]).result.changes
    (size,) = change.sizes
    assert size.name == 'elbow.link_moment_x' and size.low < 0.005 < size.high


def test_one_late_drive_is_a_change_and_late_stamps_are_none(tmp_path):
    machine = ROOT / 'config/tripod.yaml'
    words = ['--machine', str(machine), '--seconds', '2']
    late = [f'command_delay@drive_{x}:delay=0.008' for x in (2, 1, 3)]
    for number, count in enumerate((0, 1, 3)):
        more = [x for effect in late[:count] for x in ('--effect', effect)]
        log = str(tmp_path / str(count))
        assert main(['simulate', log, *words, '--seed', str(number), *more]) == 0
    request = jobs.Request(load_machine(machine), bags=(f'{tmp_path}/0',))
    (change,) = jobs.compare(request, [f'{tmp_path}/1']).result.changes
    assert (change.suspect.name, change.suspect.where) == ('command_delay', 'drive_2')
    (size,) = change.sizes
    assert size.low < 0.008 < size.high and size.high - size.low < 0.01
    every = jobs.compare(request, [f'{tmp_path}/3']).result
    assert not every.changes
    (delay,) = (x for x in every.apart if x.kind == 'timing')
    assert abs(delay.after) == pytest.approx(0.008, rel=0.3)


def test_what_is_not_smooth_is_weighed_by_what_a_tenth_of_it_does(made):
    request = jobs.Request(load_machine(AXIS), bags=(f'{made}/one',))
    problem = request.problem(jobs.read(request).fit)
    at, after = EffectAt('encoder_quantisation', 'emps_axis'), np.array([False, True])
    sides = Sides(problem.models * 2, after, effects=[(at, True)])
    theta = np.append(0.5 * (sides.low + sides.high)[: sides.nominal], 1e-4)
    seen = hidden.missing_beside(sides, theta, [])
    found = columns_of(sides, theta, seen, [Homed(sides.bare)])
    tenth = np.stack([theta, theta])
    tenth[:, -1] *= 0.9, 1.1
    did = np.subtract(*hidden.residuals_at(sides, seen.rows)(tenth))
    # A far smaller step moves hardly any reading across the edge of one of the encoder's.
    of_columns, of_slopes = (
        abs(did @ x) / np.linalg.norm(did) / np.linalg.norm(x)
        for x in (found.others[:, -1], seen.slopes[:, -1])
    )
    assert of_columns > 0.99 and of_slopes < 0.5


def test_all_that_explains_as_much_is_told(made, tmp_path, monkeypatch):
    words = ['--effect', 'velocity_gain_error@emps_axis:factor=1.05', '--motion', 'reversals']
    words += ['--machine', str(AXIS), '--seconds', '6', '--seed', '6']
    assert main(['simulate', f'{tmp_path}/tuned', *words]) == 0
    told = []
    for most in (1, 4):
        monkeypatch.setattr(find, '_FITS', most)
        (change,) = compared(made, ['one'], [f'{tmp_path}/tuned']).result.changes
        told.append({x.name for x in (change.suspect, *change.ties)})
    assert told[0] == told[1] >= {'velocity_gain', 'velocity_gain_error'}


def test_a_law_that_ended_at_a_bound_is_the_one_that_it_comes_to(made):
    request = jobs.Request(load_machine(AXIS), bags=(f'{made}/one',))
    problem = request.problem(jobs.read(request).fit)
    at, after = EffectAt('end_stop', 'emps_axis'), np.array([False, True])
    sides = Sides(problem.models * 2, after, effects=[(at, True)])
    theta = 0.5 * (sides.low + sides.high)
    column = Column(Suspect('effect', 'end_stop', 'emps_axis'), (), (), np.empty(0), at=at)
    fit = find._Fit(column, 9.0, sides, theta)
    stiffness, lower, upper = sides.places_of(at, '')
    assert fit.limits == set()
    spring = {EffectAt('cable_spring', 'emps_axis')}
    # In the middle of the way there is no way without either; far out a stop is none.
    for place, end in ((lower, sides.high), (upper, sides.low)):
        moved = theta.copy()
        moved[place] = end[place]
        assert replace(fit, theta=moved).limits == spring
    theta[[lower, upper]] = sides.low[lower], sides.high[upper]
    theta[stiffness] = sides.high[stiffness]
    assert replace(fit, theta=theta).limits == set()


def test_a_fit_is_judged_by_the_more_probable_of_what_the_model_may_lack():
    residual = np.array([3.0, 4.0])

    class Marginal:
        """Stand-in whose loss is a sum of squares and a constant."""

        def __init__(self, more: float) -> None:
            self.more = more

        def sized(self, residual: np.ndarray | None = None) -> 'Marginal':
            return Marginal(2.0)

        def loss(self, residual: np.ndarray) -> float:
            return float(residual @ residual) + self.more

        def __call__(self, residual: np.ndarray) -> np.ndarray:
            return residual

    box = Box(np.zeros(1), np.ones(1))
    for more, least in ((0.5, 0.5), (9.0, 2.0)):
        now = SimpleNamespace(marginal=Marginal(more))
        fit = find._best(now, lambda theta: np.tile(residual, (len(theta), 1)), box,
                         np.array([0.5]), lambda: False)  # fmt: skip
        assert fit.loss == pytest.approx(25.0 + least + box.aside(box.inside(fit.theta)))


def test_names_that_explain_little_of_the_logs_left_out_are_not_believed():
    suspect = Suspect('effect', 'stribeck', 'x_axis')
    size = Size('x_axis.stribeck.torque', 2.0, 1.0, 3.0, 'N', math.nan)
    change = Change(suspect, (size,), 9.0, ())
    found = Comparison((change,), 0.9, (), (), (2, 2), False, 5.0, True)
    assert next(sentences(found)).startswith('Changed: Stribeck friction')
    for share, said in ((0.2, '20 %'), (math.nan, 'nothing')):
        first, best, explained, *_ = sentences(replace(found, explained=share))
        assert 'nothing that was looked for explains most of it' in first
        assert best.startswith('Fits best: Stribeck friction') and f': {said} of' in explained
    first, best, *_ = sentences(replace(found, pushed=True))
    assert 'efforts that were not commanded act in them' in first
    assert best.startswith('Fits best: Stribeck friction')


def test_each_way_in_which_the_sides_differ_is_one_sentence():
    apart = (
        *(Apart('check', f'{x} is off', math.nan, 2.0, 'rad') for x in ('a', 'b')),
        *(Apart('motion', f'stroke of {x}', 1.0, 2.0, 'rad') for x in ('a', 'b')),
        Apart('zero', 'a', 0.0, 0.01, 'rad'), Apart('zero', 'b', 0.0, -0.02, 'rad'),
    )  # fmt: skip
    first, second, motions, zeros = differing(
        Comparison((), math.nan, (), apart, (1, 1), False, 5.0, True)
    )
    assert first.endswith('after: a is off') and second == 'Only in the logs after: b is off'
    assert 'differ: stroke of a 1 rad before, 2 rad after, stroke of b 1 rad before' in motions
    assert 'after, a reads 0.01 rad higher, b reads 0.02 rad lower; encoders' in zeros


@pytest.mark.slow
@pytest.mark.parametrize(
    ('more', 'suspect', 'true'),
    [
        (
            ['--effect', 'hand_load@all:mass=1,moment_x=0.05,moment_y=0,moment_z=0.1'],
            ('effect', 'hand_load'),
            {'mass': 1.0, 'moment_x': 0.05, 'moment_y': 0.0, 'moment_z': 0.1},
        ),
        (
            [f'--set=elbow.link_{x}' for x in ('mass=4', 'moment_x=0.7', 'moment_z=0.23')],
            ('load', 'elbow'),
            {'mass': 1.0, 'moment_x': 0.1, 'moment_y': 0.0, 'moment_z': 0.2},
        ),
    ],
)
def test_a_load_is_one_change_of_an_arm(more, suspect, true, tmp_path):
    boxes = {'link_mass': [-9.0, 9.0, 'kg'], 'link_moment': [-9.0, 9.0, 'kg m']}
    machine = described(tmp_path, **boxes, drive_inertia=[0.0, 9.0, 'kg m^2'])
    for name, words in (('empty', ['--seed', '1']), ('loaded', ['--seed', '2', *more])):
        own = ['simulate', f'{tmp_path}/{name}', '--machine', f'{tmp_path}/arm.yaml', *words]
        assert main([*own, '--motion', 'multisine', '--seconds', '3']) == 0
    request = jobs.Request(machine, bags=(str(tmp_path / 'empty'),))
    found = jobs.compare(request, [str(tmp_path / 'loaded')]).result
    (change,) = found.changes
    assert (change.suspect.kind, change.suspect.name) == suspect and change.suspect.side == 'after'
    sizes = {x.name.rpartition('.')[2].removeprefix('load_'): x for x in change.sizes}
    for name, value in true.items():
        size = sizes[name]
        assert size.low <= value <= size.high and size.high - size.low < 0.03
    assert found.explained > 0.95
    units = {a.text.rpartition(' ')[2]: a.unit for a in found.apart if 'stroke' in a.text}
    assert units.pop('slide') == 'm' and {*units.values()} <= {'rad'}


@pytest.mark.parametrize(('again', 'kept'), [(2.0, True), (12.0, False)])
def test_a_fit_that_one_without_a_change_beats_begins_anew_from_there(monkeypatch, again, kept):
    started = []

    def fitted(now, sides, start, stopped):
        started.append(start.tolist())
        return find._Best(start, again)

    monkeypatch.setattr(find, '_fitted', fitted)
    whole = SimpleNamespace(
        places_of=lambda at, name: [1], start=lambda base, theta, new: np.append(theta, new)
    )
    now = SimpleNamespace(sides=whole, theta=np.array([5.0, 0.7]))
    column = SimpleNamespace(at=None, suspect=Suspect('parameter', 'x'))
    less = [(SimpleNamespace(column=column), None, find._Best(np.array([3.0]), 4.0))]

    def found(loss):
        base = find._Best(now.theta, loss)
        return find._escaped(now, less, lambda: base, lambda: False)

    assert found(4.0) is None and not started
    better = found(9.0)
    assert started == [[3.0, 0.7]]
    assert (better is not None) is kept
