# SPDX-License-Identifier: Apache-2.0
"""A servo's log without effort is identified and diagnosed by its positions."""

from dataclasses import replace

import numpy as np
import pytest

from checks.reference.effects import Effect
from checks.reference.servo import servo_plant
from checks.reference.simulate import simulate
from ros2_ident.commissioning import check_both
from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gates.tracking import tracking_of
from ros2_ident.identify.run import identify
from ros2_ident.machine.file import MachineFile
from ros2_ident.models import machine_from_mapping
from ros2_ident.recording import Dataset, Recording, Stream
from ros2_ident.recording.align import align
from ros2_ident.words.verdict import sentence

CYCLE = 2e-3
# An encoder of 4096 counts a turn, read every 5 to 6 ms, as by a bus that is asked in a loop.
COUNT = 2.0 * np.pi / 4096
CONSTANTS = {
    'supply_voltage': 7.4,
    'armature': 1.8e-3,
    'load_mass': 0.49,
    'load_length': 0.1,
    'coulomb_regularisation': 0.02,
}
TRUTH = {
    'torque_constant': 0.37,
    'resistance': 3.6,
    'load_angle': 0.03,
    'coulomb_torque': 0.03,
    'viscous_torque': 0.004,
}
MACHINE = machine_from_mapping(
    {
        'machine': 'servo',
        'drives': ['joint'],
        'geometry': {'gravity': 9.81},
        'drive': CONSTANTS,
        'controller': {'cycle': CYCLE, 'position_gain': 0.7},
        'parameters': {
            'torque_constant': [0.1, 1.0, 'N m/A'],
            'resistance': [1.0, 10.0, 'Ohm'],
            'load_angle': [-0.1, 0.1, 'rad'],
            'coulomb_torque': [0.0, 0.2, 'N m'],
            'viscous_torque': [0.0, 0.05, 'N m s/rad'],
        },
    }
)


def recorded(seed: int, effects=(), seconds: float = 8.0, off: float = 6.0) -> Recording:
    """Return a log of positions only; the motor is switched off after a while."""
    time = np.arange(round(seconds / CYCLE)) * CYCLE
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3)
    sizes, rates = (0.9, 0.5, 0.25), (1.3, 3.1, 7.7)
    terms = list(zip(sizes, rates, phases, strict=True))
    goal = sum(a * np.sin(w * time + p) for a, w, p in terms)
    rate = sum(a * w * np.cos(w * time + p) for a, w, p in terms)
    asked = np.round(np.arange(0.0, seconds - 0.01, 0.00534) / CYCLE).astype(int)
    on = asked * CYCLE < off
    start = np.array([goal[0]]), np.array([0.0])
    # The loop that asks leaves the motor off where it would have sent the next goal.
    release = CYCLE * asked[~on][0]
    plant = servo_plant(MACHINE, TRUTH, release)
    log = simulate(plant, goal[None], rate[None], effects, 1e-9, 1e-10, start)
    stamps = 1_700_000_000_000_000_000 + np.round(asked * CYCLE * 1e9).astype(np.int64)
    seen = np.round(log.carriage[0, asked] / COUNT) * COUNT
    state = Stream(MACHINE.drives, stamps, seen[:, None], None, None)
    command = Stream(MACHINE.drives, stamps[on], goal[asked][on][:, None], None, None)
    return Recording(state=state, effort=None, command=command, source=f'run_{seed}')


def dataset(*args, **kwargs):
    return align(recorded(*args, **kwargs), MACHINE.drives, CYCLE, need=(), released=True)


def test_a_servo_is_identified_by_its_positions() -> None:
    found = identify(MACHINE, [recorded(1)], seed=2)
    values = {p.name.removeprefix('joint.'): p for p in found.parameters}
    # The motion with the motor off tells back-EMF from viscous friction.
    for name, true in TRUTH.items():
        assert values[name].value == pytest.approx(true, rel=0.06, abs=1.5e-3), name
    (left,) = found.residuals
    assert (left.drive, left.unit) == ('joint.position', 'rad')
    assert left.rms < 1.5 * COUNT


def test_without_effort_the_friction_of_a_loaded_gear_is_found_and_its_gap_closed() -> None:
    planted = (Effect('directional_load_friction', ('joint',), {'motor': 0.3, 'load': 0.1}),)
    fit, check = (dataset(seed, planted) for seed in (3, 4))
    near = {'directional_load_friction', 'coulomb_friction', 'stribeck', 'gear_flexibility'}
    found = diagnose(MACHINE, [fit], [check], without=sorted(set(CATALOGUE) - near), seed=1)
    assert found.effect == 'directional_load_friction', sentence(found)
    assert found.unit == 'rad'
    assert found.share_closed.value > 0.85
    motor = found.parameters['joint.directional_load_friction.motor']
    assert motor.value == pytest.approx(0.3, rel=0.1)
    assert not [gate for gate in found.gates if gate.gate in ('sign', 'limit', 'law')]


def test_a_servo_sent_beyond_its_stop_stands_at_it() -> None:
    stop = {'stiffness': 40.0, 'lower': -0.7, 'upper': 9.0}
    fit, check = (dataset(seed, (Effect('end_stop', ('joint',), stop),)) for seed in (3, 4))
    near = {'end_stop', 'cable_spring', 'torque_ripple', 'torque_saturation'}
    found = diagnose(MACHINE, [fit], [check], without=sorted(set(CATALOGUE) - near), seed=1)
    assert found.effect == 'end_stop', sentence(found)
    assert found.parameters['joint.end_stop.lower'].value == pytest.approx(-0.7, abs=5e-3)


def test_where_nothing_is_missing_a_servo_is_left_alone() -> None:
    found = diagnose(MACHINE, [dataset(5)], [dataset(6)], seed=1)
    assert found.effect == 'none', sentence(found)


def test_checking_asks_for_no_effort_and_says_nothing_of_a_bad_one() -> None:
    file = MachineFile('servo.yaml', {}, (), MACHINE)
    report = check_both([recorded(1)], file)
    assert not [f.sentence for f in report.findings if f.level == 'error']
    whole = recorded(1)
    size = np.abs(np.sin(np.arange(whole.state.stamp.size) / 50.0))[:, None]
    unsigned = replace(whole, state=replace(whole.state, effort=size))
    assert not [f for f in check_both([unsigned], file).findings if 'effort' in f.code]


def test_a_set_point_of_the_other_sign_is_named() -> None:
    sound = recorded(1)
    command = replace(sound.command, position=-sound.command.position)
    (finding,) = check_both(
        [replace(sound, command=command)], MachineFile('servo.yaml', {}, (), MACHINE)
    ).of('set_point')
    assert finding.level == 'error'
    assert 'joint: the position moves against its set-point' in finding.sentence
    # A swing that is half a period late is no reverse.
    time = np.arange(0.0, 8.0, CYCLE)
    swings = (np.sin(9.0 * (time - lag))[None] for lag in (0.0, 0.36))
    data = Dataset(('joint',), CYCLE, 0, next(swings), None, next(swings), None, None)
    tracking = tracking_of(data, ('joint',))
    assert tracking.slope == pytest.approx(1.0, rel=0.01)
