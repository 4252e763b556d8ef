# SPDX-License-Identifier: Apache-2.0
"""The check: what it finds in recordings that are fine, and in those that are not."""

from dataclasses import dataclass, field
import math
import re

import numpy as np
import pytest

from ros2_ident.recording import check, Recording, render, Stream
from ros2_ident.recording.findings import DriveSummary, Finding, Report
from ros2_ident.recording.quality import _judge_weight, summarise

MS = 1_000_000
TIME = np.arange(8000) * 1e-3
RNG = np.random.default_rng(0)


@dataclass(frozen=True)
class Machine:
    """The part of a machine file that the check reads."""

    drives: tuple = ('a',)
    effort_scale: float = 1.0
    # 0.2 N m at rest at 10 rad/m: 2 N, the weight of 0.2 kg
    constants: dict = field(
        default_factory=lambda: {
            'gravity': 9.81, 'cycle': 1e-3, 'gear_factor': 10.0,
            'rail_mass': 0.05,
        }
    )  # fmt: skip
    bounds: dict = field(default_factory=lambda: {'tool_mass': (0.12, 0.17, 'kg')})

    def number(self, name, drive=None):
        return self.constants[name]


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
    report = check([recording()], Machine())
    assert report.level == 'ok'
    assert codes(report, 'ok') == {
        'rate', 'excitation', 'velocity', 'effort', 'effort_sign', 'effort_gravity',
    }
    (drive,) = report.drives
    assert drive.stroke == pytest.approx(np.ptp(POSITION), rel=0.01)
    assert drive.top_speed == pytest.approx(0.4, rel=0.05)
    assert drive.reversals >= 4
    assert drive.effort_rest == pytest.approx(0.2, abs=0.02)
    assert drive.explained > 0.95
    assert 0.1 < drive.rest_share < 0.8


def test_a_report_as_text():
    lines = render(check([recording()], Machine()))
    assert lines[0] == 'log'
    assert lines[2].split()[:5] == ['segment', 'stream', 'joints', 'fields', 'samples']
    assert any(re.match(r'ok    a: holds 0\.\d+ at rest against gravity', x) for x in lines)
    assert all(len(line) < 200 and '\n' not in line for line in lines)


def test_a_late_effort_is_seen():
    late = np.interp(TIME - 0.03, TIME, EFFORT)
    (drive,) = check([recording(effort=late)]).drives
    assert drive.effort_lag == pytest.approx(0.03, abs=0.003)


def test_a_reversed_effort_is_an_error():
    report = check([recording(effort=-EFFORT)], Machine())
    assert 'effort_sign' in codes(report, 'error')
    assert 'effort_gravity' in codes(report, 'warn')
    (finding,) = report.of('effort_sign')
    assert finding.subject == 'a'
    assert 'negate the effort or the position in the driver' in finding.sentence


def test_an_unsigned_effort_is_an_error():
    report = check([recording(effort=np.abs(EFFORT - 0.2))])
    (finding,) = report.of('effort_sign')
    assert finding.level == 'error' and '"sign: velocity" in the column map' in finding.sentence


def test_a_weight_is_no_lost_sign():
    assert 'effort_sign' not in codes(check([recording(effort=EFFORT + 3.0)]), 'error')


def test_a_constant_effort_is_an_error():
    report = check([recording(effort=np.full(TIME.size, 0.0))])
    assert codes(report, 'error') == {'effort_constant'}


def test_percent_and_counts_are_recognised():
    report = check([recording(effort=np.round(100.0 * EFFORT))])
    assert 'looks like percent of the rated torque' in report.of('effort_unit')[0].sentence
    report = check([recording(effort=np.round(2000.0 * EFFORT))], Machine())
    assert 'looks like milliamperes or counts' in report.of('effort_unit')[0].sentence


def test_compensated_gravity_is_seen():
    report = check([recording(effort=EFFORT - 0.2)], Machine())
    assert 'gravity acts along this drive but the effort at rest' in (
        report.of('effort_gravity')[0].sentence
    )


def test_efforts_that_do_not_fit_the_weight():
    (finding,) = check([recording()], Machine(effort_scale=9.0)).of('effort_weight')
    assert finding.level == 'error'
    assert re.search(r'hold [\d.]+ N, .* 2.16 N: the effort is 8.3\d* times', finding.sentence)
    assert 'state effort_unit with torque_constant or rated_torque' in finding.sentence


def test_an_effort_that_has_nothing_to_do_with_the_motion():
    report = check([recording(effort=RNG.normal(size=TIME.size))])
    assert 'effort_unexplained' in codes(report, 'warn')


@pytest.mark.parametrize(
    ('velocity', 'text'),
    [
        (np.interp(TIME - 0.02, TIME, VELOCITY), r'reported velocity is (19|20)(\.\d)? ms late'),
        (60.0 * VELOCITY, 'the reported velocity is 60 times the derivative'),
        (-VELOCITY, 'the reported velocity is -1 times the derivative'),
        (RNG.normal(size=TIME.size), 'the reported velocity explains [0-9]+ % of the derivative'),
    ],
)
def test_wrong_velocities_are_seen(velocity, text):
    report = check([recording(velocity=velocity)])
    found = [*report.of('velocity'), *report.of('velocity_lag')]
    assert found[0].level == 'warn'
    assert re.search(text, found[0].sentence)


def test_excitation():
    still = check([recording(position=np.zeros(TIME.size), velocity=None)], Machine())
    assert 'no_motion' in codes(still, 'error')
    one_way = check([recording(position=0.1 * TIME**2, velocity=None)])
    assert 'one_way' in codes(one_way, 'warn')
    once = check([recording(position=np.sin(0.4 * TIME), velocity=None)])
    assert 'reverses only once' in once.of('few_reversals')[0].sentence


def test_missing_samples():
    rng = np.random.default_rng(1)
    report = check([recording(rng.random(TIME.size) > 0.05)])
    assert 'missing' in codes(report, 'warn')
    assert report.streams[0].missing_share == pytest.approx(0.05, abs=0.01)
    report = check([recording(rng.random(TIME.size) > 0.4)])
    assert 'missing' in codes(report, 'error')


def test_irregular_stamps():
    rng = np.random.default_rng(2)
    report = check([recording(np.unique(np.cumsum(rng.integers(1, 20, 700)).clip(max=7999)))])
    assert codes(report, 'warn', 'error') & {'irregular', 'missing'}


def test_nan_is_counted():
    effort = EFFORT.copy()
    effort[::10] = np.nan
    report = check([recording(effort=effort)])
    found, *_ = report.of('nan')
    assert '10 % of the values of the effort of a are missing or NaN' in found.sentence
    assert report.streams[0].nan == (('effort a', 800),)
    report = check([recording(effort=EFFORT * np.nan)], Machine())
    assert 'every value of the effort of a is NaN; name the topic' in report.of('nan')[0].sentence
    assert 'bad_values' in codes(report, 'error')


def test_what_does_not_fit_the_machine():
    report = check([recording()], Machine(drives=('a', 'b')))
    (finding,) = report.of('missing_stream')
    assert finding.level == report.level == 'error'
    assert 'state has no joint b, it holds a' in finding.sentence


def test_segments_short_ones_and_no_command():
    short = recording(slice(0, 500))
    report = check([short, Recording(short.state, warnings=('cut off',))])
    assert {'segments', 'short', 'no_command', 'reading'} <= codes(report, 'warn')
    assert [x.recording for x in report.streams] == [0, 0, 1]
    assert check([]).level == 'error'


def test_without_positions():
    stamp = np.arange(3000) * MS
    report = check([Recording(effort=Stream(('a',), stamp, effort=EFFORT[:3000, None]))])
    assert 'no_position' in codes(report, 'warn')
    assert report.drives == ()


def test_five_samples_are_no_crash():
    for size in (1, 2, 5, 12):
        assert check([recording(slice(0, size))], Machine()).level in ('warn', 'error')


# ---------------------------------------------------------------------- each rule at its edge


def stream(ms, effort=None):
    stamp = np.array(ms, dtype=np.int64) * MS
    return Stream(('a', 'b'), stamp, np.zeros((stamp.size, 2)), effort=effort)


def test_how_a_stream_arrived_is_counted():
    ms = [0, 10, 20, 30, 44, 58, 78, 88, 138, 148, 158, 168]
    effort = np.zeros((12, 2))
    effort[:3, 0] = np.nan
    effort[:, 1] = np.nan
    found = summarise(3, 'state', stream(ms, effort))
    assert (found.recording, found.role, found.joints) == (3, 'state', ('a', 'b'))
    assert found.fields == ('position', 'effort')
    assert (found.samples, found.duration) == (12, pytest.approx(0.168))
    # Steps of 14 ms are late, of 20 and 50 ms one and four samples are missing.
    assert (found.gaps, found.missing, found.longest_gap) == (2, 5, pytest.approx(0.05))
    usual = np.array([10, 10, 10, 14, 14, 10, 10, 10, 10])
    assert found.rate == pytest.approx(1e3 / usual.mean())
    assert found.jitter == pytest.approx(1e-3 * usual.std())
    assert found.missing_share == pytest.approx(5 / 17)
    assert found.nan == (('effort a', 3),) and found.silent == ('effort b',)
    single = summarise(0, 'state', stream([5]))
    assert (single.rate, single.jitter, single.gaps, single.missing) == (0.0, 0.0, 0, 0)
    assert (single.longest_gap, single.missing_share) == (0.0, 0.0)


def held(rest, drive='a'):
    return DriveSummary(0, drive, 0.0, 0.0, 0, *([0.0] * 3), rest, 0.0, 0.0)


@pytest.mark.parametrize(
    ('times', 'level'),
    [
        (1.55, None), (1.65, 'warn'), (2.95, 'warn'), (3.05, 'error'),
        (1 / 1.55, None), (1 / 1.65, 'warn'), (1 / 2.95, 'warn'), (1 / 3.05, 'error'),
        (0.06, 'error'), (0.04, None), (-1.0, None),
    ],
)  # fmt: skip
def test_efforts_at_rest_are_held_against_the_weight(times, level):
    # 0.05 kg and 0.12 to 0.17 kg; ten radians are a metre.
    weight = 9.81 * ((0.05 + 0.17) if times > 1.0 else (0.05 + 0.12))
    found = _judge_weight([held(times * weight / 10.0), held(99.0, 'other')], Machine())
    assert [x.level for x in found] == ([] if level is None else [level])
    if found:
        assert f'the effort is {times:.2g} times a torque' in found[0].sentence
        assert 'weighs 1.67 to 2.16 N' in found[0].sentence


def test_a_weight_needs_every_drive_and_gravity():
    assert _judge_weight([held(math.nan)], Machine()) == []
    assert _judge_weight([held(9.0)], Machine(drives=('a', 'b'))) == []
    both = Machine(drives=('a', 'b'))
    assert _judge_weight([held(9.0), held(math.nan, 'b')], both) == []
    two = _judge_weight([held(9.0), held(9.0, 'b')], both)
    assert 'hold 180 N, the machine weighs 2.16 to 2.65 N' in two[0].sentence
    level = Machine(constants=Machine().constants | {'gravity': 0.0})
    assert _judge_weight([held(9.0)], level) == []
    # Where gravity points against the drives' direction, so do the efforts.
    down = Machine(constants=Machine().constants | {'gravity': -9.81})
    assert _judge_weight([held(9.0)], down) == []
    for force, times in ((-9.0, '42'), (-0.05, '0.3')):
        (found,) = _judge_weight([held(force)], down)
        assert found.level == 'error' and f'is {times} times a torque' in found.sentence


def test_findings_stand_worst_first_and_once():
    ok, warn, error = (Finding(x, x, '', x) for x in ('ok', 'warn', 'error'))
    report = Report('log', (), (), (ok, warn, ok, error, warn))
    assert report.findings == (error, warn, ok)
    assert (report.level, report.of('warn')) == ('error', (warn,))
    assert Report('log').level == 'ok'


def test_a_drive_that_stands_still_never_reverses():
    found = check([recording(position=np.full(TIME.size, 0.3), velocity=None)])
    assert 'no_motion' in codes(found, 'warn')
    (drive,) = found.drives
    assert (drive.reversals, drive.rest_share) == (0, 1.0) and drive.stroke < 1e-12
