# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from checks.blind import faults, rough
from checks.blind.machines import draw_machine, file_text, machine_of, read_plain
from checks.reference.plant import Log
from ros2_ident.simulate.motions import Motion

PLAIN = read_plain('config/tripod.yaml')
NAMES = ('drive_1', 'drive_2', 'drive_3')


def a_log(cycles: int = 16000, cycle: float = 5e-4) -> tuple[Log, Motion]:
    time = np.arange(cycles) * cycle
    wave = np.sin(2.0 * np.pi * np.array([[0.7], [1.1], [0.4]]) * time)
    log = Log(NAMES, cycle, wave, 0.4 + 0.1 * wave, 0.1 * wave, wave)
    return log, Motion('mixed', cycle, 0.4 + 0.1 * wave, 0.1 * wave)


def recorded(case: rough.Rough, seed: int = 3):
    log, motion = a_log()
    streams, _, noise = rough.record(log, motion, case, np.random.default_rng(seed))
    return streams, noise


@pytest.mark.parametrize('colour', [(), (0.5,), (0.99,), (1.7, -0.9)])
def test_noise_has_its_size_and_colour(colour) -> None:
    case = rough.Rough(0.02, colour=colour)
    noise = rough.coloured(case, (3, 60000), np.random.default_rng(1))
    assert np.sqrt(np.mean(noise**2, axis=1)) == pytest.approx([0.02] * 3)
    found = np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2)
    assert found == pytest.approx(case.memory, abs=0.02)


def test_the_label_knows_the_noise_that_the_log_holds() -> None:
    case = rough.Rough(0.02, colour=(0.9,), smoothing=3, step=1.2, drop=0.0, jitter=0.0)
    streams, noise = recorded(case)
    log, _ = a_log()
    effort = streams['/effort'].effort
    every = 2
    held = effort - log.effort[:, ::every].T[: len(effort)]
    assert np.std(held, axis=0) == pytest.approx(noise, rel=0.02)
    steps = effort / (1.2 * 0.02)
    assert np.abs(steps - np.round(steps)).max() < 1e-6


def test_a_resampled_log_lies_between_the_loggers_samples() -> None:
    case = rough.Rough(1e-9, clock=2e-4, step=0.0, jitter=0.0, drop=0.0)
    streams, _ = recorded(case)
    stamp = (streams['/effort'].stamp - streams['/effort'].stamp[0]) * 1e-9
    assert np.median(np.diff(stamp)) == pytest.approx(1.0002e-3, rel=1e-6)
    phase = (streams['/effort'].stamp - rough.START) * 1e-9 / 5e-4 % 1.0
    assert phase.std() > 0.05  # on no grid of the controller


def test_messages_get_lost_in_each_stream_by_itself() -> None:
    streams, _ = recorded(rough.Rough(0.01, drop=0.05, burst=4.0))
    counts = {topic: len(stream.stamp) for topic, stream in streams.items()}
    assert all(7300 < count < 7900 for count in counts.values())
    assert len({tuple(stream.stamp[:200]) for stream in streams.values()}) == 3
    assert streams['/joint_command'].velocity is None


def test_drawn_noise_covers_what_is_asked_for() -> None:
    rng = np.random.default_rng(5)
    drawn = [rough.draw_rough(6.0, rng, hard=n < 40) for n in range(400)]
    hard, other = drawn[:40], drawn[40:]
    assert {d.colour for d in hard} == {(0.9,), (0.99,)}
    assert {round(d.stated, 3) for d in hard} == {0.4, 2.5}
    memory = np.array([d.memory for d in other])
    assert memory.min() <= 0.0 + 1e-9 and memory.max() > 0.97 and (np.abs(memory) < 1.0).all()
    stated = np.array([d.stated for d in other])
    assert 0.08 < np.mean(stated == 0.0) < 0.25
    assert stated[stated > 0.0].min() < 0.5 and stated.max() > 2.0 and stated.max() <= 2.5
    sigma = np.array([d.sigma for d in drawn])
    assert sigma.min() < 0.006 and sigma.max() > 0.02
    assert len({d.period for d in drawn}) == 3


def test_drawn_machines_differ_in_all_but_gravity() -> None:
    rng = np.random.default_rng(4)
    machines = [draw_machine(PLAIN, rng, pi_only=False) for _ in range(60)]
    for section, name in (
        ('geometry', 'rod_length'),
        ('geometry', 'rail_radius'),
        ('drive', 'gear_factor'),
        ('drive', 'rail_mass'),
        ('drive', 'coulomb_regularisation'),
        ('controller', 'position_gain'),
        ('controller', 'velocity_gain'),
        ('controller', 'torque_limit'),
    ):
        values = np.array([m[section][name] for m in machines])
        assert values.max() > 1.4 * values.min(), name
    laws = [m['controller'].get('law') for m in machines]
    assert 3 < laws.count('cascade_p') < 30
    assert len({m['controller']['cycle'] for m in machines}) == 3
    for plain in machines:
        machine_of(plain)
        assert file_text(plain).startswith('# SPDX')
    only = [draw_machine(PLAIN, rng, pi_only=True)['controller'] for _ in range(30)]
    assert not any('law' in m for m in only)


def drawn_fault(kind: str, name: str, value: float, drive: int = -1) -> faults.Fault:
    return faults.Fault(kind, drive, value, name)


def test_faults_change_what_they_say_and_nothing_else() -> None:
    streams, _ = recorded(rough.Rough(0.01))
    effort = streams['/effort'].effort
    flipped = faults.in_log(drawn_fault('sign', 'effort', -1.0, 1), streams)
    np.testing.assert_array_equal(flipped['/effort'].effort, effort * [1.0, -1.0, 1.0])
    swapped = faults.in_log(drawn_fault('order', 'effort', 0.0, 2), streams)
    np.testing.assert_array_equal(swapped['/effort'].effort, effort[:, [2, 1, 0]])
    assert swapped['/effort'].names == streams['/effort'].names
    long = faults.in_log(drawn_fault('unit', 'position', 1000.0), streams)
    for topic in ('/joint_states', '/joint_command'):
        np.testing.assert_allclose(long[topic].position, 1000.0 * streams[topic].position)
    np.testing.assert_allclose(
        long['/joint_states'].velocity, 1000.0 * streams['/joint_states'].velocity
    )
    late = faults.in_log(drawn_fault('lag', 'command', 0.03), streams)
    assert np.all(late['/joint_command'].stamp - streams['/joint_command'].stamp == 30_000_000)
    assert late['/effort'] is streams['/effort']


def test_a_wrong_constant_stands_in_the_file() -> None:
    fault = drawn_fault('constant', 'velocity_gain', 2.0)
    wrong = faults.in_file(fault, PLAIN)
    assert wrong['controller']['velocity_gain'] == 2.0 * PLAIN['controller']['velocity_gain']
    assert 'velocity gain' in faults.named_by(fault)
    streams, _ = recorded(rough.Rough(0.01))
    assert faults.in_log(fault, streams) is streams
    assert faults.in_file(replace(fault, kind='sign'), PLAIN) is PLAIN


def test_every_kind_of_fault_is_drawn_and_does_something() -> None:
    streams, _ = recorded(rough.Rough(0.01))
    rng = np.random.default_rng(3)
    for kind in faults.KINDS:
        for _ in range(20):
            fault = faults.draw_fault(kind, rng, 3, PLAIN)
            assert fault.kind == kind and faults.named_by(fault)
            log, file = faults.in_log(fault, streams), faults.in_file(fault, PLAIN)
            assert file != PLAIN or any(log[t] is not streams[t] for t in streams)
