# SPDX-License-Identifier: Apache-2.0
"""Arms as they are built: couplings, counterbalances, a band, commands; bags of simulated arms."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from checks.reference.bag_making import simulate_bag  # noqa: E402
from checks.reference.twin import twin_of  # noqa: E402
from models.test_serial import BOXES, described, URDF  # noqa: E402
from ros2_ident.cli.main import main  # noqa: E402
from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.identify.run import identify  # noqa: E402
from ros2_ident.identify.settings import IdentifySettings  # noqa: E402
from ros2_ident.machine.machine import Machine  # noqa: E402
from ros2_ident.models import make_model  # noqa: E402
from ros2_ident.recording import Dataset  # noqa: E402
from ros2_ident.simulate.bag import CLEAN, simulate  # noqa: E402
from ros2_ident.simulate.motions import draw_motion  # noqa: E402

ALGEBRAIC = IdentifySettings(method='algebraic')
BUILT = {
    'gear_factor': [80.0, 1.0, 1.0, 60.0],
    'coulomb_regularisation': 0.05,
    'coupled_to': ['none', 'none', 'none', 'elbow'],
    'coupling': -0.7,
    'balance_base': [0.0, 0.0, 0.7, 0.0],
    'balance_arm': [0.0, 0.0, 0.15, 0.0],
    'balance_angle': 0.4,
    'balance_stroke': 0.5,
}


def arm(folder: Path, drive=None, controller=None, urdf: str = URDF, **boxes: list) -> Machine:
    return described(folder, urdf, 0.05, drive, controller, **(boxes or BOXES))


def logged(machine: Machine, truth: dict, seconds: float = 12.0, seed: int = 1) -> Dataset:
    """A simulated log without noise, as the model takes it."""
    motion = draw_motion('multisine', machine, seconds, seed)
    log = simulate_bag(machine, truth, motion, 0, CLEAN).log
    return Dataset(machine.drives, log.cycle, 0, None, None, log.position, None, log.effort)


def noisy(data: Dataset, size: float, seed: int = 0) -> Dataset:
    assert data.effort is not None
    rng = np.random.default_rng(seed)
    return replace(data, effort=data.effort + rng.normal(0.0, size, data.effort.shape))


def values(model, truth: dict) -> np.ndarray:
    """Return a candidate: the description's links, and what the truth says of the rest."""
    out = []
    for p in model.parameters:
        shared = p.name.rpartition('.')[2]
        middle = 0.5 * (p.low + p.high)
        out.append(truth.get(p.name, truth.get(shared, middle)))
    return np.array(out)


# ---------------------------------------------------------------------- model and reference


def test_gears_couplings_and_counterbalances_are_those_of_the_reference(tmp_path: Path) -> None:
    boxes = {
        **BOXES,
        'drive_inertia': [0.0, 0.1, 'kg m^2'],
        'constant_force': [-2.0, 2.0, 'N m'],
        'balance_force': [0.0, 4000.0, 'N'],
        'balance_rate': [0.0, 9000.0, 'N/m'],
        'payload_mass': [0.0, 4.0, 'kg'],
        'payload_x': [-0.5, 0.5, 'm'],
        'payload_z': [-0.5, 0.5, 'm'],
    }
    machine = arm(tmp_path, BUILT, **boxes)
    truth = {
        'drive_inertia': 0.002, 'wrist.drive_inertia': 0.004, 'coulomb_torque': 0.5,
        'viscous_torque': 0.2, 'elbow.constant_force': 0.3, 'constant_force': -0.1,
        'elbow.balance_force': 3000.0, 'elbow.balance_rate': 7000.0,
        'payload_mass': 1.2, 'payload_x': 0.1, 'payload_z': -0.2,
    }  # fmt: skip
    data = logged(machine, truth)
    model = make_model(machine, data)
    # Rotors take what the same rotation of links shows: their names stand for both.
    theta = values(model, truth)
    inside = slice(100, -100)
    told = model.simulated_effort(theta)[:, inside]
    assert data.effort is not None
    plain = data.effort[:, inside]
    # Splines through samples, here through positions and there through set-points' speeds.
    size = np.abs(plain).max(axis=1)
    assert (np.abs(told - plain).max(axis=1) < 1e-3 * size).all()
    for name in ('elbow.balance_force', 'elbow.balance_rate', 'wrist.drive_inertia'):
        other = theta.copy()
        other[[p.name for p in model.parameters].index(name)] *= 1.2
        changed = np.abs(model.simulated_effort(other)[:, inside] - plain).max(axis=1)
        assert (changed > 5e-3 * size)[2 if 'balance' in name else 3]
    # The elbow's motor bears the wrist's: without the coupling its effort is another one.
    free = make_model(arm(tmp_path, {**BUILT, 'coupling': 0.0}, **boxes), data)
    missed = np.abs(free.simulated_effort(theta)[:, inside] - plain).max(axis=1)
    assert (missed[2:] > 2e-3 * size[2:]).all()


def test_what_cannot_be_built_is_refused(tmp_path: Path) -> None:
    def refusal(drive: dict, **boxes: list) -> IdentError:
        with pytest.raises(IdentError) as caught:
            machine = arm(tmp_path, drive, **{**BOXES, **boxes})
            make_model(machine, logged(arm(tmp_path), {}, 3.0)).simulate(np.zeros((1, 1)))
        assert caught.value.code is ErrorCode.BAD_MACHINE_FILE
        return caught.value

    strange = {'coupled_to': ['none', 'none', 'none', 'knee']}
    assert "wrist is coupled_to 'knee'" in refusal(strange).message
    both = {'coupled_to': ['none', 'none', 'wrist', 'elbow']}
    assert 'a joint that no motor moves' in refusal(both).message
    alone = refusal({}, balance_force=[0.0, 1.0, 'N']).message
    assert 'nothing says where it pulls; add balance_base' in alone
    short = {**BUILT, 'balance_stroke': 0.01}
    with pytest.raises(IdentError, match='its balance_stroke is 0.01 m; correct balance_stroke'):
        machine = arm(tmp_path, short)
        model = make_model(machine, logged(arm(tmp_path), {}, 3.0))
        model.simulate(values(model, {}))


# ---------------------------------------------------------------------- what is compared


def shaken(data: Dataset) -> Dataset:
    """Return a log whose encoders and torques shake at 25 Hz as no rigid body does."""
    time = data.cycle * np.arange(data.cycles)
    shake = np.sin(2.0 * np.pi * 25.0 * time)
    assert data.position is not None
    assert data.effort is not None
    return replace(data, position=data.position + 1e-4 * shake, effort=data.effort + 6.0 * shake)


def test_below_its_bandwidth_an_arm_is_rigid(tmp_path: Path) -> None:
    truth = {'coulomb_torque': 2.0, 'viscous_torque': 3.0}
    width = {'coulomb_regularisation': 0.02}
    plain = arm(tmp_path, width)
    log = shaken(noisy(logged(plain, truth), 0.05))
    wide, bounded = (arm(tmp_path, width, {'bandwidth': b}) for b in (40.0, 6.0))
    clean = make_model(plain, logged(plain, truth, 8.0, seed=2))
    size = np.nanstd(clean.measured, axis=1)
    ends = np.cumsum(np.isfinite(clean.measured).sum(axis=1))[:-1]
    errors = []
    for machine in (wide, bounded):
        found = identify(machine, log, settings=ALGEBRAIC)
        missed = np.split(clean.residuals(found.theta)[0], ends)
        errors.append(np.array([row.std() for row in missed]) / size)
    assert (errors[1] < 0.05).all()
    assert (errors[1] < 0.3 * errors[0]).all()
    model = make_model(bounded, log)
    there = np.flatnonzero(np.isfinite(model.measured[0]))
    # Four samples in a period of 6 Hz, none within two of the motion's low-pass from the ends.
    assert np.diff(there).min() == int(1.0 / (4.0 * 6.0 * 0.004))
    assert there[0] * 0.004 > 2.0 / 30.0


def test_an_effort_may_stand_before_its_motion(tmp_path: Path) -> None:
    machine = arm(tmp_path, **BOXES, measurement_delay=[-0.03, 0.03, 's'])
    truth = {'coulomb_torque': 2.0, 'viscous_torque': 3.0}
    data = noisy(logged(machine, truth, 8.0), 0.05)
    assert data.effort is not None
    early = replace(data, effort=np.roll(data.effort, -3, axis=1))
    found = identify(machine, early, settings=IdentifySettings(starts=1))
    delay = {p.name: p for p in found.parameters}['measurement_delay']
    assert delay.low < -0.012 < delay.high
    assert delay.high - delay.low < 1e-3
    model = make_model(machine, early)
    np.testing.assert_allclose(model.effort_delay(found.theta), delay.value)
    # The motion that belongs to a cycle is told as it was then, whatever drives the model.
    assert early.position is not None
    inside = slice(50, -50)
    np.testing.assert_allclose(
        model.motion[0][:, inside], early.position[:, inside], rtol=0, atol=2e-4
    )


# ---------------------------------------------------------------------- simulated bags


def found_in(path: Path) -> dict:
    found: dict = json.loads((path / 'result.json').read_text())['parameters']
    return found


def test_intervals_of_a_simulated_arm_hold_the_truth(tmp_path: Path, capsys) -> None:
    # The description that is corrected has other masses than the arm.
    boxes = {**BOXES, 'link_mass': [-5.0, 5.0, 'kg']}
    true = arm(tmp_path / 'true', **boxes)
    wrong = URDF.replace('<mass value="3"/>', '<mass value="3.6"/>')
    wrong = wrong.replace('<mass value="1.5"/>', '<mass value="1.2"/>')
    believed = arm(tmp_path / 'believed', urdf=wrong, **boxes)
    bag, out = str(tmp_path / 'bag'), tmp_path / 'out'
    file = str(tmp_path / 'true/arm.yaml')
    simulate = ['simulate', bag, '--machine', file, '--motion', 'multisine', '--seconds', '20']
    assert main([*simulate, '--seed', '3', '--set', 'coulomb_torque=4']) == 0
    assert 'viscous_torque  5  N m s/rad' in capsys.readouterr().out
    file = str(tmp_path / 'believed/arm.yaml')
    words = ['identify', bag, '--machine', file, '--method', 'algebraic', '--out', str(out)]
    main([*words, '--no-report', '--no-overlay', '--quiet'])
    data = logged(true, {}, 2.0)
    model = make_model(true, data)
    truth = dict(
        zip(
            [p.name for p in model.parameters],
            values(model, {'coulomb_torque': 4.0, 'viscous_torque': 5.0}),
            strict=True,
        )
    )
    found = found_in(out)
    assert found.keys() == truth.keys()
    held = [found[n]['low'] <= value <= found[n]['high'] for n, value in truth.items()]
    assert np.mean(held) > 0.85
    before = dict(zip(truth, values(make_model(believed, data), {}), strict=True))
    name = 'elbow.link_moment_x'
    assert abs(before[name] - truth[name]) > 10.0 * abs(found[name]['value'] - truth[name])


def test_a_load_is_found_by_two_bags(tmp_path: Path) -> None:
    boxes = {**BOXES, 'payload_mass': [0.0, 6.0, 'kg']}
    boxes |= {f'payload_{axis}': [-0.3, 0.3, 'm'] for axis in 'xyz'}
    arm(tmp_path, **boxes)
    file = str(tmp_path / 'arm.yaml')
    truth = {'payload_mass': 2.5, 'payload_x': 0.05, 'payload_y': -0.03, 'payload_z': 0.12}
    for name, seed, mass in (('empty', 1, 0.0), ('loaded', 2, 2.5)):
        told = [f'--set={k}={v}' for k, v in (truth | {'payload_mass': mass}).items()]
        words = ['simulate', str(tmp_path / name), '--machine', file, '--seed', str(seed)]
        assert main([*words, '--motion', 'multisine', '--seconds', '8', *told]) == 0
    words = ['identify', str(tmp_path / 'empty'), str(tmp_path / 'loaded'), '--machine', file]
    words += ['--each', 'payload_mass', '--fix', 'payload_mass@empty=0', '--starts', '1']
    out = tmp_path / 'out'
    main([*words, '--out', str(out), '--no-report', '--no-overlay', '--quiet'])
    found = found_in(out)
    assert found['payload_mass@loaded']['value'] == pytest.approx(2.5, rel=0.01)
    for axis in 'xyz':
        name = f'payload_{axis}'
        assert found[name]['value'] == pytest.approx(truth[name], abs=5e-3)


def test_a_simulated_arm_takes_links_as_set_and_no_effects(tmp_path: Path, capsys) -> None:
    machine = described(tmp_path)
    motion = draw_motion('multi_point', machine, 1.5, 1)
    for values in ({}, {'wrist.link_mass': 9.0}):
        slow = twin_of(machine).simulate(machine, values, motion.position, motion.velocity)
        off = np.abs(simulate(machine, values, motion).effort - slow.effort)
        # At its ends a log is smoothed like the motion.
        assert np.quantile(off, 0.95) < 1e-3 * np.abs(slow.effort).max()
    words = ['simulate', str(tmp_path / 'bag'), '--machine', str(tmp_path / 'arm.yaml')]
    words += ['--seconds', '1.5', '--clean']
    effect = ['--effect', 'stribeck@wrist:torque=5,velocity=0.5']
    assert main([*words, '--set', 'wrist.link_mass=9', *effect]) == 0
    assert 'wrist.link_mass 9 kg' in ' '.join(capsys.readouterr().out.split())
    # no name that stands for several, and none that nothing has; those that are offered are taken
    words[1] = str(tmp_path / 'other')
    for name in ('wrist.weight', 'link_moment', 'wrist.link_moment', 'wrist.link_moment_q'):
        capsys.readouterr()
        assert main([*words, '--set', f'{name}=9']) == 2
        said, _, offered = capsys.readouterr().err.partition('; choose from ')
        assert said.endswith(f"'{name}' cannot be set: no such parameter")
        assert name not in offered.split(', ')
    for number, name in enumerate(offered.split(' and ')[0].split(', ')):
        words[1] = str(tmp_path / f'bag_{number}')
        assert main([*words, '--set', f'{name}=0.01']) == 0
