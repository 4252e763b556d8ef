# SPDX-License-Identifier: Apache-2.0
"""Bookkeeping faults, each made in a simulated bag, are named as such before any physics."""

from collections.abc import Callable
from dataclasses import replace
import re

from identify_cases import axis, axis_bag, recording_of, tripod, tripod_bag
import numpy as np
import pytest
from values import with_bounds

from ros2_ident.gates import examine, GateReport
from ros2_ident.gates.examine import examine_models
from ros2_ident.identify.data import gather
from ros2_ident.models import Machine, machine_from_mapping, make_model
from ros2_ident.recording import Dataset, Recording, Stream

Change = Callable[[Recording], Recording]


def report_of(kind: str, change: Change, machine: Machine | None = None) -> GateReport:
    bag = tripod_bag(6.0) if kind == 'tripod' else axis_bag(6.0)
    machine = machine or (tripod() if kind == 'tripod' else axis())
    data = gather([change(recording_of(bag))], machine)
    return examine(machine, data.datasets)


def times(role: str, factor: float, drive: str = '') -> Change:
    """Return what multiplies a stream's values, of one drive or of all."""

    def change(recording: Recording) -> Recording:
        stream = recording.streams[role]
        columns = [stream.names.index(drive)] if drive else range(len(stream.names))
        fields = {}
        for field in ('effort',) if role == 'effort' else ('position', 'velocity'):
            values = stream.values(field)
            if values is not None:
                fields[field] = np.array(values)
                fields[field][:, columns] *= factor
        return replace(recording, **{role: replace(stream, **fields)})

    return change


def later(role: str, seconds: float) -> Change:
    """Return what moves the stamps of a stream."""

    def change(recording: Recording) -> Recording:
        stream = recording.streams[role]
        moved = replace(stream, stamp=stream.stamp + round(1e9 * seconds))
        return replace(recording, **{role: moved})

    return change


def named(role: str, *names: str) -> Change:
    """Return what gives the joints of a stream other names."""

    def change(recording: Recording) -> Recording:
        stream: Stream = recording.streams[role]
        return replace(recording, **{role: replace(stream, names=names)})

    return change


def both(*changes: Change) -> Change:
    def change(recording: Recording) -> Recording:
        for one in changes:
            recording = one(recording)
        return recording

    return change


def silent(recording: Recording) -> Recording:
    return replace(recording, command=None)


@pytest.mark.parametrize('kind', ['axis', 'tripod'])
def test_a_sound_log_contradicts_nothing(kind):
    report = report_of(kind, lambda recording: recording)
    assert all(gate.level == 'ok' for gate in report.gates)
    assert report.headline == ''


@pytest.mark.parametrize(
    ('kind', 'change', 'gate', 'drive', 'said'),
    [
        (
            'axis',
            times('effort', -1.0),
            'sign',
            'emps_axis',
            'sign is reversed against the motion',
        ),
        ('tripod', times('effort', -1.0, 'drive_2'), 'sign', 'drive_2', 'negate the effort'),
        ('axis', both(silent, times('effort', -1.0)), 'sign', 'emps_axis', 'negate the effort'),
        (
            'tripod',
            times('state', -1.0, 'drive_3'),
            'set_point',
            'drive_3',
            'moves against its set-point',
        ),
        ('tripod', times('state', 1e3), 'set_point', 'drive_1', 'the position is logged in mm'),
        ('tripod', times('command', 1e3), 'set_point', 'drive_1', 'set-point is logged in mm'),
        (
            'axis',
            both(times('state', 1e3), times('command', 1e3)),
            'law',
            'emps_axis',
            'position and set-point look logged in another unit, mm',
        ),
        (
            'axis',
            times('effort', 100.0 / 5.0),
            'limit',
            'emps_axis',
            'state the unit of the log as effort_unit',
        ),
        ('tripod', times('effort', 0.01), 'law', 'drive_1', '0.01 times what the stated law'),
        (
            'tripod',
            named('effort', 'drive_2', 'drive_1', 'drive_3'),
            'names',
            '',
            "drive_1's effort is drive_2's",
        ),
        (
            'tripod',
            named('state', 'drive_2', 'drive_1', 'drive_3'),
            'names',
            '',
            "drive_1 follows drive_2's",
        ),
        ('tripod', later('state', 0.05), 'offset', 'drive_1', r'position are 50[.\d]* ms late'),
        ('tripod', later('command', -0.3), 'offset', 'drive_1', r'set-point 300[.\d]* ms late'),
        ('axis', later('command', 0.01), 'offset', 'emps_axis', r'command are 10[.\d]* ms late'),
        ('axis', later('effort', 0.3), 'offset', 'emps_axis', r'effort are 300[.\d]* ms late'),
    ],
)
def test_a_fault_is_named_first(kind, change, gate, drive, said):
    report = report_of(kind, change)
    first = report.contradictions[0]
    assert (first.gate, first.drive) == (gate, drive)
    assert report.blocked
    assert re.search(said, report.headline)


def test_a_joint_that_turns_logged_in_degrees():
    machine = axis()
    turning = with_bounds(machine, {**machine.bounds, 'moving_mass': (50.0, 150.0, 'kg m^2')})
    report = report_of('axis', times('state', 57.29578), turning)
    assert 'the position is logged in degrees; log rad' in report.headline
    report = report_of('axis', both(*(times(x, 57.29578) for x in ('state', 'command'))), turning)
    assert 'position and set-point look logged in another unit, degrees' in report.headline
    assert report.blocked


@pytest.mark.parametrize(
    ('kind', 'key', 'factor', 'said', 'blocked'),
    [
        ('axis', 'velocity_gain', 1.2, r'your velocity_gain is 1\.027e\+04; 855', False),
        ('axis', 'velocity_gain', 1.0 / 35.15065, r'your velocity_gain is 243\.\d; 85[56]', True),
        ('axis', 'position_gain', 5.0, 'your position_gain is 800.9; 160.2 fits the log', True),
        ('tripod', 'integral_gain', 0.2, 'your integral_gain is 50; 250.1 fits the log', True),
    ],
)
def test_a_wrong_constant_is_given_with_the_number_to_write(kind, key, factor, said, blocked):
    machine = tripod() if kind == 'tripod' else axis()
    wrong = machine.with_constants(**{key: factor * machine.number(key)})
    report = report_of(kind, lambda recording: recording, wrong)
    assert re.search(said, report.headline)
    assert report.contradictions[0].key == key
    assert report.blocked == blocked


def test_an_effort_logged_late_without_a_parameter_for_it():
    report = report_of('axis', later('effort', 0.02))
    assert 'the effort is logged 20.1 ms late' in report.headline
    assert not report.blocked
    # The tripod's file has the delay among its parameters.
    assert report_of('tripod', later('effort', 0.02)).headline == ''


def test_without_a_command_that_is_said_once():
    report = report_of('tripod', silent)
    assert [g.gate for g in report.gates if g.level == 'warn'] == ['command']
    assert report.headline == ''


def test_delays_of_less_than_a_cycle_are_looked_for_within_it(recwarn):
    def seldom(recording: Recording) -> Recording:
        streams = {role: x.taken(slice(None, None, 50)) for role, x in recording.streams.items()}
        return replace(recording, **streams)

    machine = replace(axis(), constants={**axis().constants, 'cycle': (0.05,)})
    report_of('axis', both(seldom, times('effort', 3.0)), machine)
    assert [str(x.message) for x in recwarn] == []


@pytest.mark.parametrize(('ripple', 'noise', 'told'), [(2e-3, 0.0, True), (2e-4, 2e-3, False)])
def test_an_effort_that_is_faster_than_the_positions_tell_is_named(ripple, noise, told):
    # cogging of order 72 at 6 rad/s, or noise, beside friction; readings are off by 0.3 mrad
    machine = machine_from_mapping(
        {
            'machine': 'linear_axis',
            'drives': ['motor'],
            'effort_unit': 'N m',
            'controller': {'cycle': 1e-3},
            'parameters': {
                'moving_mass': [0.0, 1e-4, 'kg m^2'],
                'coulomb_friction': [0.0, 0.01, 'N m'],
            },
        }
    )
    rng, time = np.random.default_rng(6), 1e-3 * np.arange(8000)
    speed = 6.0 * np.sign(np.sin(1.6 * time))
    place = 1e-3 * np.cumsum(speed)
    effort = 5e-4 * np.sign(speed) + ripple * np.sin(72.0 * place)
    effort += noise * rng.normal(size=time.size)
    seen = place + 3e-4 * rng.normal(size=time.size)
    log = Dataset(('motor',), 1e-3, 0, None, None, seen[None], None, effort[None])
    gates = examine_models([make_model(machine, log)]).of('too_fast')
    assert bool(gates) == told
    for gate in gates:
        assert gate.level == 'warn' and gate.drive == 'motor' and gate.number > 0.8
        assert 'faster than the recorded positions tell' in gate.sentence
