# SPDX-License-Identifier: Apache-2.0
"""The check: what it finds in recordings that are fine, and in those that are not."""

from dataclasses import replace
from pathlib import Path
import re

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from ros2_ident.commissioning import check_both
from ros2_ident.gates.examine import check_streams, examine
from ros2_ident.identify.data import gather
from ros2_ident.models.registry import read_machine_file
from ros2_ident.recording import align, check, read_bag, Recording, render, Stream
from ros2_ident.recording.grid import cycle_of, missing_samples
from ros2_ident.recording.motion import Motion, motion_of, smooth_motion
from ros2_ident.recording.sign import sign_of

REPO = Path(__file__).parents[2]

MS = 1_000_000
TIME = np.arange(8000) * 1e-3
RNG = np.random.default_rng(0)


def motion():
    """Return position, velocity and acceleration: to and fro with pauses."""
    turn = np.sin(2.0 * np.pi * 0.6 * TIME)
    run = np.sign(turn) * (2.0 * np.abs(turn) - 1.0).clip(0.0) ** 2
    velocity = 0.4 * run
    position = np.cumsum(velocity) * 1e-3
    return position, velocity, np.gradient(velocity, 1e-3)


POSITION, VELOCITY, ACCELERATION = motion()
EFFORT = (
    0.2 + 0.5 * ACCELERATION + 0.1 * VELOCITY + 0.08 * np.tanh(VELOCITY / 5e-3)
    + RNG.normal(0.0, 0.005, TIME.size)
)  # fmt: skip


def recording(keep=slice(None), names=('a',), **changes):
    fields = {'position': POSITION, 'velocity': VELOCITY, 'effort': EFFORT} | changes
    stamp = (np.arange(TIME.size) * MS)[keep]
    columns = {k: None if v is None else v[keep, None] for k, v in fields.items()}
    command = Stream(names, stamp, columns['position'])
    return Recording(Stream(names, stamp, **columns), command=command, source='log')


def codes(report, *levels):
    return {x.code for x in report.findings if x.level in levels}


def test_a_good_recording_is_ok():
    report = check([recording()], ('a',), gravity=9.81)
    assert report.level == 'ok'
    assert codes(report, 'ok') == {
        'missing',
        'excitation',
        'velocity',
        'effort',
        'effort_sign',
        'effort_gravity',
    }
    (drive,) = report.drives
    assert drive.stroke == pytest.approx(np.ptp(POSITION), rel=0.01)
    assert drive.effort_rest == pytest.approx(0.2, abs=0.02)
    (said,) = report.of('excitation')
    assert re.search(r'top speed 0\.(39|4).*, 9 reversals, [1-7]\d % of the time', said.sentence)
    assert re.search('explain (9[5-9]|100) % of its effort$', report.of('effort')[0].sentence)


@pytest.mark.parametrize(
    ('effort', 'code', 'level', 'text'),
    [
        (-EFFORT, 'effort_sign', 'error', 'negate the effort or the position in the driver'),
        (np.abs(EFFORT - 0.2), 'effort_sign', 'error', '"sign: velocity" in the column map'),
        (np.zeros(TIME.size), 'effort_constant', 'error', 'what swings freely has none'),
        (np.round(100.0 * EFFORT), 'effort_unit', None, 'looks like percent of the rated torque'),
        (np.round(2000.0 * EFFORT), 'effort_unit', None, 'looks like milliamperes or counts'),
        (EFFORT - 0.2, 'effort_gravity', 'warn', 'gravity acts along this drive and the effort'),
        (RNG.normal(size=TIME.size), 'effort_unexplained', 'warn', ''),
        (np.interp(TIME - 0.03, TIME, EFFORT), 'effort', None, 'about (2[89]|3[0-2]) ms late'),
        (
            np.where(np.arange(TIME.size) % 10, 0.0, EFFORT),
            'effort_idle',
            'warn',
            'exactly 0 in (89|90|91) % of the samples .*where it is driven; what swings',
        ),
    ],
)
def test_an_effort_that_is_no_torque_is_said_with_the_remedy(effort, code, level, text):
    finding, *_ = check([recording(effort=effort)], ('a',), gravity=9.81).of(code)
    assert level in (None, finding.level) and re.search(text, finding.sentence)


def test_gravity_that_goes_round_explains_an_effort():
    place = 2.6 * np.sin(1.1 * TIME) + 0.4 * TIME
    swung = recording(position=place, velocity=None, effort=3.0 * np.sin(place + 0.3))
    assert 'explain 100 % of its effort' in check([swung]).of('effort')[0].sentence


@pytest.mark.parametrize(
    ('velocity', 'text'),
    [
        (np.interp(TIME - 0.02, TIME, VELOCITY), r'reported velocity is (19|20)(\.\d)? ms late; '),
        (np.interp(TIME - 0.14, TIME, VELOCITY), 'reported velocity is 120 ms late or more; '),
        (60.0 * VELOCITY, 'the reported velocity is 60 times the derivative'),
        (-VELOCITY, 'the reported velocity is -1 times the derivative'),
        (RNG.normal(size=TIME.size), 'and explains [0-9]+ % of it'),
    ],
)
def test_wrong_velocities_are_seen(velocity, text):
    report = check([recording(velocity=velocity)])
    found = [*report.of('velocity'), *report.of('velocity_lag')]
    assert found[0].level == 'warn'
    assert re.search(text, found[0].sentence)


def test_a_lag_of_a_slow_log_is_no_latest_one():
    # of 50 Hz, at which the earliest lag is one sample before none
    late = np.interp(TIME - 0.018, TIME, VELOCITY)
    report = check([recording(slice(None, None, 20), velocity=late)])
    (said,) = report.of('velocity_lag')
    assert re.search(r'reported velocity is 1[789](\.\d)? ms late; ', said.sentence)


def test_values_too_small_to_square_are_judged():
    # 1e-309 is subnormal; it stands in a damaged table of a number in single precision
    report = check([recording(position=1e-309 * POSITION, velocity=None)])
    assert report.of('effort_sign')


def test_positions_in_counts_are_seen():
    counts = np.round(1e4 * POSITION)
    (said,) = check([recording(position=counts, velocity=None)]).of('position_unit')
    assert said.level == 'warn' and 'all positions are whole numbers from ' in said.sentence
    assert not check([recording(position=1e-4 * counts, velocity=None)]).of('position_unit')


def _joints(factor, joints=2):
    """Return a recording of joints whose reported velocities are off by a factor each."""
    state = recording(velocity=VELOCITY).state
    names = tuple('abc'[:joints])
    position = np.stack([(n + 1.0) * state.position[:, 0] for n in range(joints)], axis=1)
    velocity = np.stack(
        [factor[n % len(factor)] * (n + 1.0) * state.velocity[:, 0] for n in range(joints)], axis=1
    )
    return Recording(Stream(names, state.stamp, position, velocity))


@pytest.mark.parametrize(
    ('factor', 'said'),
    [
        ((1000.0,), 'the time is in ms and was read as s; state `unit: ms` of it in the'),
        ((125.0,), 'time in s (with 1.25e+05 rows a second, in a column map'),
        ((0.1827,), '`time: {rate: 182.7}`, they agree), or all velocities are those of'),
        ((180.0 / np.pi,), ''),
        ((1000.0, 1.0), ''),
    ],
)
def test_a_factor_of_all_velocities_is_one_of_the_time(factor, said):
    report = check([_joints(factor)])
    sentences = [x.sentence for x in report.of('time')]
    assert len(sentences) == bool(said) and all(said in x for x in sentences)
    assert (not report.of('velocity')) == bool(said)


def test_a_factor_of_one_velocity_may_be_one_of_the_time():
    (said,) = check([recording(velocity=0.1827 * VELOCITY)]).of('velocity')
    assert said.sentence.endswith(
        'or leave it out, unless the time is no time in s (with 182.7 rows a second, in a column '
        'map `time: {rate: 182.7}`, they agree)'
    )
    for unlike in (180.0 / np.pi * VELOCITY, -0.1827 * VELOCITY):
        (said,) = check([recording(velocity=unlike)]).of('velocity')
        assert said.sentence.endswith('leave it out')


def test_what_friction_holds_at_rest_need_not_be_explained():
    # a controller's integral part lets the effort wander while friction holds the joint
    wander = np.interp(TIME, np.arange(9), np.random.default_rng(4).normal(0.2, 3.0, 9))
    resting = np.abs(VELOCITY) < 1e-3
    held = check([recording(effort=np.where(resting, wander, EFFORT))])
    assert resting.mean() > 0.3 and not held.of('effort_unexplained')
    other = check([recording(effort=np.where(resting, EFFORT, RNG.normal(size=TIME.size)))])
    assert other.of('effort_unexplained')


def test_excitation():
    still = check([recording(position=np.zeros(TIME.size), velocity=None)], ('a',))
    assert 'no_motion' in codes(still, 'error')
    one_way = check([recording(position=0.1 * TIME**2, velocity=None)])
    assert 'one_way' in codes(one_way, 'warn')
    once = check([recording(position=np.sin(0.4 * TIME), velocity=None)])
    assert ', 1 reversals' in once.of('few_reversals')[0].sentence


@pytest.mark.parametrize('cells', [1e-6 * RNG.normal(size=TIME.size), 1e-3 * (TIME > 4.0)])
def test_what_the_readings_of_a_joint_at_rest_make_is_no_motion(cells):
    # the noise of an arm's encoders, or a count to and fro
    report = check([recording(position=0.7 + cells)])
    assert len(report.of('no_motion')) == 1
    assert not {'excitation', 'velocity', 'effort', 'effort_unexplained'} & codes(
        report, 'ok', 'warn', 'error'
    )


def test_of_several_recordings_that_counts_which_excites_a_drive_best():
    once, well = recording(position=np.sin(0.4 * TIME), velocity=None), recording()
    still = recording(position=np.zeros(TIME.size), velocity=None)
    alone = check([well]).of('excitation')
    assert len(alone) == 1
    for order in (once, still, well), (well, still, once), (well, well, well):
        report = check([*order])
        assert report.of('excitation') == alone
        assert not report.of('no_motion') and not report.of('few_reversals')
    assert len(check([still] * 3).of('no_motion')) == 1


def test_a_log_that_is_sampled_unevenly_has_lost_nothing():
    whole = recording().state
    steps = np.random.default_rng(0).uniform(2e6, 10e6, whole.stamp.size).astype(np.int64)
    report = check([Recording(replace(whole, stamp=np.cumsum(steps)), source='uneven')])
    assert 'missing' in codes(report, 'warn')
    assert re.search('unevenly, 2 to 10 ms apart: log at', report.of('missing')[0].sentence)
    data = align(Recording(replace(whole, stamp=np.cumsum(steps))), ['a'], 1e-3)
    assert data.streams['state'].missing is None


def test_missing_samples():
    rng = np.random.default_rng(1)
    report = check([recording(rng.random(TIME.size) > 0.05)])
    assert 'missing' in codes(report, 'warn')
    assert re.search('; [45](.[0-9]+)? % are missing', report.of('missing')[0].sentence)
    report = check([recording(rng.random(TIME.size) > 0.4)])
    assert 'missing' in codes(report, 'error')


def test_nan_is_counted():
    effort = EFFORT.copy()
    effort[::10] = np.nan
    report = check([recording(effort=effort)])
    found, *_ = report.of('nan')
    assert '10 % of the values of the effort of a are missing or NaN' in found.sentence
    report = check([recording(effort=EFFORT * np.nan)])
    assert 'every value of the effort of a is NaN; name the topic' in report.of('nan')[0].sentence


@pytest.mark.parametrize(
    ('factor', 'code', 'text'),
    [
        (9.0, 'effort_weight', r'the effort is 8\.\d+ times a torque; state effort_unit'),
        (np.nan, 'bad_values', 'every effort of the drives is NaN; switch the measurement on'),
    ],
)
def test_an_effort_is_held_against_the_machine(factor, code, text):
    read = read_bag(REPO / 'bags' / 'tripod_mixed')
    wrong = [replace(x, effort=replace(x.effort, effort=factor * x.effort.effort)) for x in read]
    report = check_both(wrong, read_machine_file(REPO / 'config' / 'tripod.yaml'))
    finding, *_ = report.of(code)
    assert finding.level == report.level == 'error'
    assert re.search(text, finding.sentence)


def test_a_carriage_in_millimetres_is_held_against_the_machine():
    (read,) = read_bag(REPO / 'bags' / 'axis_reversals')
    state = replace(read.state, position=1e3 * read.state.position, velocity=None)
    log = Recording(state, effort=read.effort)
    report = check_both([log], read_machine_file(REPO / 'config' / 'emps.yaml'))
    (finding,) = report.of('units')
    assert 'record positions of the carriage in m, not mm' in finding.sentence


def test_a_log_that_a_fit_refuses_is_refused(tmp_path):
    # 1.3 turns a second at 18 Hz: between two turns nothing is left
    text = (REPO / 'config' / 'emps.yaml').read_text()
    (tmp_path / 'm.yaml').write_text(text.replace('cycle: 1.0e-3', 'cycle: 0.056'))
    stamp, noise = 56 * MS * np.arange(1200), RNG.normal(size=(2, 1200))
    place = 0.3 * np.sin(2.6e-9 * np.pi * stamp) + 2e-3 * noise[0]
    state = Stream(('emps_axis',), stamp, position=place[:, None])
    effort = Stream(('emps_axis',), stamp, effort=np.gradient(place)[:, None] + noise[1:].T)
    report = check_both([Recording(state, effort=effort)], read_machine_file(tmp_path / 'm.yaml'))
    (finding,) = report.of('no_data')
    assert 'samples beside rest and turns cannot determine' in finding.sentence


def test_gains_are_asked_for_where_there_is_a_set_point(tmp_path):
    text = (REPO / 'config' / 'emps.yaml').read_text()
    (tmp_path / 'm.yaml').write_text(re.sub(r'  (position|velocity)_gain: .*\n', '', text))
    file = read_machine_file(tmp_path / 'm.yaml')
    (read,) = read_bag(REPO / 'bags' / 'axis_reversals')
    for log, count in ((read, 1), (replace(read, command=None), 0)):
        report = check_both([log], file)
        assert len(report.of('gains')) == count and not report.of('command')
        # an identification shows the gates alone
        gates = examine(file.machine, gather([log], file.machine).datasets)
        assert len(gates.of('gains')) == count and len(gates.of('command')) == 1 - count


@pytest.mark.parametrize(
    ('late', 'code', 'text'),
    [(0.02, 'offset', '20[.0-9]* ms late, as'), (0.05, 'align', 'the stated gains make 6.2 ms')],
)
def test_a_set_point_that_is_taken_late_leaves_the_log_of_use(late, code, text):
    (read,) = read_bag(REPO / 'bags' / 'axis_reversals')
    command = replace(read.command, stamp=read.command.stamp - round(1e9 * late))
    file = read_machine_file(REPO / 'config' / 'emps.yaml')
    report = check_both([replace(read, command=command)], file)
    (finding,) = report.of(code)
    assert finding.level == report.level == 'warn'
    assert re.search(text, finding.sentence)


def test_joints_of_the_bag_are_held_against_the_machine():
    file = read_machine_file(REPO / 'config' / 'tripod.yaml')
    (finding,) = check_both([recording()], file).of('missing_stream')
    assert re.search('state has no joint .*drive_1.*, it holds a; name', finding.sentence)


def test_segments_short_ones_and_no_command():
    short = recording(slice(0, 500))
    report = check([short, Recording(short.state, warnings=('cut off',), source='log')])
    assert {'segments', 'short', 'no_command', 'reading'} <= codes(report, 'warn')
    assert check([]).level == 'error'


# ---------------------------------------------------------------------- the sign of an effort


def constant_speeds(seed, both=True, weight=2.0):
    """Return a log of constant speeds: friction, weight and spring, ripple, coloured noise."""
    rng = np.random.default_rng(seed)
    period = 1.0 / rng.choice([25.0, 100.0, 250.0])
    levels = rng.uniform(0.3, 1.0, size=8) * 10.0 ** rng.uniform(-1.0, 1.0)
    speed = np.repeat(levels, int(3.0 / period))
    if both:
        speed *= np.repeat([1.0, -1.0] * 4, int(3.0 / period))
    speed = uniform_filter1d(speed, max(3, int(0.1 / period)))
    position = np.cumsum(speed) * period
    stroke = np.ptp(position)
    step = stroke * 10.0 ** rng.uniform(-5.0, -3.0)
    place, velocity, acceleration = smooth_motion(
        np.round(position / step)[None] * step, period, min(15.0, 0.2 / period)
    )
    top = np.abs(speed).max()
    sides = 1.0 + weight * rng.uniform(-0.2, 0.2) * np.sign(speed)
    effort = np.tanh(speed / (0.01 * top)) * sides
    effort += rng.uniform(0.0, 1.0) * speed / top + 0.02 * np.gradient(speed, period) / top
    effort += weight * (rng.normal() + 0.5 * rng.normal() * position / stroke)
    effort += rng.uniform(0.0, 0.5) * np.sin(60.0 * position / stroke)
    memory = rng.choice([0.0, 0.9, 0.98])
    noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.normal(size=effort.size))
    effort += 10.0 ** rng.uniform(-1.5, 0.0) * noise
    alone = np.empty((0, effort.size))
    return Motion(period, place[0], velocity[0], acceleration[0], None, effort, alone)


def test_at_constant_speed_no_sound_log_is_reversed_and_each_reversed_one_is():
    for seed in range(20):
        log = constant_speeds(seed)
        assert sign_of(log) == 'right', seed
        flipped = sign_of(replace(log, effort=-log.effort))
        assert flipped == 'reversed' or (flipped == 'either' and log.effort.max() <= 0.0), seed


@pytest.mark.parametrize('change', [np.positive, np.negative, np.abs])
def test_one_way_an_unknown_load_leaves_the_sign_open(change):
    for seed in range(5):
        log = constant_speeds(seed, both=False)
        assert sign_of(replace(log, effort=change(log.effort))) == 'open', seed


def test_there_and_back_once_the_sign_is_open():
    for seed in range(5):
        log = constant_speeds(seed)
        end = int(5.5 / log.period)
        rows = {n: getattr(log, n)[..., :end] for n in ('position', 'velocity', 'acceleration')}
        once = replace(log, **rows, effort=log.effort[:end], beside=log.beside[:, :end])
        assert sign_of(once) == sign_of(replace(once, effort=-once.effort)) == 'open', seed


def test_the_size_of_a_current_with_an_idle_part_is_told_from_a_reversed_one():
    time = np.arange(0.0, 16.0, 4e-3)
    place = 0.6 * np.sin(1.9 * time) + 0.2 * np.sin(4.4 * time + 1.0)
    moved = smooth_motion(place[None], 4e-3, 15.0)
    place, speed, change = (row[0] for row in moved)
    made = 1.5 * np.tanh(speed / 0.02) + 0.5 * speed + 0.05 * change
    made += np.random.default_rng(0).normal(0.0, 0.02, time.size)
    log = Motion(4e-3, place, speed, change, None, made, np.empty((0, time.size)))
    # Neither changes its sign: the idle part of the one, a weight of the other.
    assert sign_of(replace(log, effort=np.abs(made) + 0.3), alone=True) == 'unsigned'
    assert sign_of(replace(log, effort=6.0 - made), alone=True) == 'reversed'
    assert sign_of(replace(log, effort=6.0 + made), alone=True) == 'right'


def _pushed(seed, push=30.0, gain=40.0):
    """Return a log of a joint under PD, with friction, that others push beside its set-point."""
    rng, period = np.random.default_rng(seed), 5e-3
    time = np.arange(0.0, 20.0, period)
    waves = rng.uniform(0.5, 2.0, 3), rng.uniform(0.0, 6.0, 3)
    goal = 0.3 * np.sin(0.7 * time) + 0.1 * np.sin(1.9 * time + 1.0)
    pushed = push * sum(
        np.sin(2.0 * np.pi * f * time + phase) for f, phase in zip(*waves, strict=True)
    )
    place, speed, rows = goal[0], 0.0, []
    for asked, load in zip(goal, pushed, strict=True):
        effort = gain * (asked - place) - 2.0 * speed
        rows.append((place, speed, effort))
        speed += period * (effort + load - 1.5 * np.tanh(speed / 0.05)) / 0.5
        place += period * speed
    place, speed, effort = np.array(rows).T
    effort = effort + rng.normal(0.0, 0.1, time.size)
    stamp = (time * 1e9).round().astype(np.int64)
    state = Stream(('a',), stamp, place[:, None], speed[:, None], effort[:, None])
    return Recording(state, command=Stream(('a',), stamp, goal[:, None]), source='log')


def test_where_others_do_the_work_the_set_point_tells_the_sign():
    for seed in range(2):
        log = _pushed(seed)
        assert sign_of(motion_of(log, 'a')) == 'held'
        without = replace(log, command=None)
        assert sign_of(motion_of(without, 'a')) == 'reversed'
        # what drives itself is reversed as before, though a stiff law would explain its effort
        for gain in (40.0, 400.0):
            itself = motion_of(_pushed(seed, push=0.0, gain=gain), 'a')
            assert sign_of(itself) == 'right'
            assert sign_of(replace(itself, effort=-itself.effort)) == 'reversed'


def _single(seed, others=()):
    """Return a log of a joint that turns fast with little friction, once each way."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 8.0, 5e-3)
    speed = np.sin(np.pi * time / 4.0) * (1.0 + rng.uniform(0.2, 0.4) * np.sin(7.0 * time))
    place, change = np.cumsum(speed) * 5e-3, np.gradient(speed, 5e-3)
    effort = 0.4 * change + 0.05 * speed + 1.5 * np.sin(place) + rng.normal(0.0, 0.02, time.size)
    names = ('a', *others)
    rows = [np.stack([x, *([x] * len(others))], axis=1) for x in (place, speed, effort)]
    return Recording(Stream(names, (time * 1e9).round().astype(np.int64), *rows), source='log')


@pytest.mark.parametrize('seed', range(3))
def test_a_joint_that_moves_alone_has_no_negative_inertia(seed):
    right = _single(seed)
    turned = replace(right, state=replace(right.state, effort=-right.state.effort))
    assert 'effort_backward' not in codes(check([right]), 'warn')
    (found,) = check([turned]).of('effort_backward')
    assert 'a negative inertia, friction and gravity explain' in found.sentence
    # what another joint loads may show one
    two = _single(seed, others=('b',))
    turned = replace(two, state=replace(two.state, effort=-two.state.effort))
    assert 'effort_backward' not in codes(check([turned]), 'warn')


def test_a_sign_that_the_set_point_tells_is_no_error():
    report = check([_pushed(0)])
    assert 'effort_sign' in codes(report, 'ok')
    assert 'draws it to its set-point' in report.of('effort_sign')[0].sentence


def _loop(seconds=20.0):
    """Return stamps, ns, of a program's loop: it takes 4 ms, and often longer."""
    rng = np.random.default_rng(3)
    steps = 4e6 + rng.exponential(2e5, round(seconds / 4e-3))
    longer = rng.random(steps.size) < 0.15
    return np.cumsum(steps + longer * rng.uniform(2e6, 8e6, steps.size)).astype(np.int64)


def test_a_loop_that_takes_longer_now_and_then_has_lost_nothing():
    stamp = _loop()
    assert missing_samples(stamp) is None
    assert missing_samples(np.array([0, 1, 1 << 60])) is None
    # Samples that did not come leave whole periods.
    there = np.random.default_rng(4).random(5000) > 0.2
    there[[0, -1]] = True
    assert missing_samples(np.arange(5000)[there] * 4_000_000) == 5000 - there.sum()


@pytest.mark.parametrize(
    ('stamp', 'cycle'),
    [
        (np.arange(3000) * 2_000_000, '0.002'),
        (np.round(np.arange(3000) * 1e9 / 1500).astype(np.int64), '0.00066667'),
        (np.round(np.arange(3000) * 4.0003e6).astype(np.int64), '0.0040003'),
    ],
)
def test_a_cycle_is_written_with_the_digits_it_needs(stamp, cycle):
    assert cycle_of(stamp) == cycle


def _turns():
    """Return stamps of a loop at 2 ms that logs at every fifth turn or every sixth."""
    steps = np.random.default_rng(5).choice([10, 12], 4000)
    return np.cumsum(steps) * 1_000_000


@pytest.mark.parametrize(
    'stamp', [_loop(), _turns(), np.round(np.arange(3000) * 1e9 / 1500).astype(int)]
)
def test_the_cycle_of_a_log_is_none_to_complain_of(stamp):
    state = Stream(('a',), stamp, np.sin(stamp[:, None] * 2e-9))
    data = align(Recording(state), ['a'], float(cycle_of(stamp)), need=('position',))
    assert not data.warnings
    assert all('cycle' not in gate.sentence for gate in check_streams(data))


def test_what_holds_of_several_joints_is_printed_once():
    late = [np.interp(TIME - 0.14, TIME, VELOCITY)] * 3
    state = recording().state
    names, position = ('a', 'b', 'c'), np.repeat(state.position, 3, axis=1)
    log = Recording(Stream(names, state.stamp, position, np.stack(late, axis=1)))
    lines = [x for x in render(check([log])) if 'the reported velocity' in x]
    assert [x.split('; ')[0] for x in lines] == [
        'warn  a: the reported velocity is 120 ms late or more'
    ]
    assert lines[0].endswith(' (likewise b, c)')
