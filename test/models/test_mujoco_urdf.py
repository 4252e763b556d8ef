# SPDX-License-Identifier: Apache-2.0
"""An arm under P and D on position in MuJoCo: what a search of its log begins with and finds."""

from dataclasses import replace
from pathlib import Path
import sys

import numpy as np
import pytest
import yaml

from ros2_ident.cli.main import main
from ros2_ident.models import load_machine, make_model
from ros2_ident.recording import Dataset, Recording, Stream
from ros2_ident.recording.write import write_bag

sys.path.append(str(Path(__file__).parents[2] / 'build/peers'))
mujoco = pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')

INERTIAL = (
    '<inertial><origin xyz="0 0 -0.15"/><mass value="{}"/><inertia ixx="0.01" ixy="0" ixz="0" '
    'iyy="0.01" iyz="0" izz="0.002"/></inertial><visual><geometry><mesh filename='
    '"package://nowhere/link.stl"/></geometry></visual>'
)
JOINT = (
    '<joint name="{}" type="revolute"><origin xyz="0 0 {}"/><parent link="{}"/><child link="{}"/>'
    '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="{}" velocity="3"/></joint>'
)
URDF = (
    '<robot name="two"><link name="base"/>'
    f'<link name="upper">{INERTIAL.format(2.0)}</link>'
    f'<link name="lower">{INERTIAL.format(1.0)}</link>'
    f'<link name="finger">{INERTIAL.format(0.1)}</link>'
    + JOINT.format('one', 0, 'base', 'upper', 30)
    + JOINT.format('two', -0.3, 'upper', 'lower', 12)
    + JOINT.format('grip', -0.3, 'lower', 'finger', 1)
    + '</robot>'
)
DRIVES, CYCLE = ('one', 'two'), 0.004
# An actuator's position is that of the joint times its gear.
GEARS = 1.0, -2.0
TRUE = {
    'kp': (120.0, 60.0), 'kv': (4.0, 1.5), 'armature': (0.1, 0.04), 'frictionloss': (0.8, 0.4),
    'damping': (0.6, 0.3),
}  # fmt: skip
UNITS = {'kp': 'N m/rad', 'kv': 'N m s/rad', 'armature': 'kg m^2', 'frictionloss': 'N m',
         'damping': 'N m s/rad'}  # fmt: skip

# Keys of a machine file that this package simulates, and MuJoCo's words for them.
COMPILED = {
    'position_gain': 'kp', 'velocity_gain': 'kv', 'drive_inertia': 'armature',
    'coulomb_torque': 'frictionloss', 'viscous_torque': 'damping',
}  # fmt: skip


def spec_of():
    text = URDF.replace(INERTIAL[INERTIAL.index('<visual') :], '')  # the mesh is missing
    return mujoco.MjSpec.from_string(text.replace('name="grip" type="revolute"',
                                                  'name="grip" type="fixed"'))  # fmt: skip


def moved(count=1500, step=2e-4, delay=0, firm=False):
    """Return set-points, positions, velocities and torques (D, K) by finer steps, own law."""
    spec = spec_of()
    spec.option.timestep = step
    for d, name in enumerate(DRIVES):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = TRUE['armature'][d], TRUE['frictionloss'][d]
    model = spec.compile()
    model.dof_damping[:] = TRUE['damping']
    if firm:  # by default dry friction of MuJoCo gives way as a damper does, up to its size
        model.dof_solref[:], model.dof_solimp[:] = (4.0 * step, 1.0), (0.999, 0.9999, 1e-3, 0.5, 2)
    data = mujoco.MjData(model)
    time = CYCLE * np.arange(count)
    points = np.clip(2.0 * time, 0.0, 1.0) * [0.7 * np.sin(5.0 * time), 0.5 * np.sin(8.0 * time)]
    seen = np.empty((3, 2, count))
    kp, kv = np.array(TRUE['kp']), np.array(TRUE['kv'])
    for k in range(count):
        at = max(k - delay, 0)
        for inner in range(round(CYCLE / step)):
            data.qfrc_applied[:] = kp * (points[:, at] - data.qpos) - kv * data.qvel
            if inner == 0:
                seen[:, :, k] = data.qpos, data.qvel, data.qfrc_applied
            mujoco.mj_step(model, data)
    return points, *seen


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp('urdf')
    (made / 'arm.urdf').write_text(URDF)
    spec = spec_of()
    for name, gear in zip(DRIVES, GEARS, strict=True):
        added = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        added.biastype, added.gear[0] = mujoco.mjtBias.mjBIAS_AFFINE, gear
    spec.compile()
    (made / 'arm.xml').write_text(spec.to_xml())
    return made


def machine_of(folder, controller=None, found=('armature',)):
    path = folder / 'machine.yaml'
    path.write_text(yaml.safe_dump({
        'machine': 'mujoco', 'drives': list(DRIVES), 'geometry': {'description': 'arm.xml'},
        'controller': {'cycle': CYCLE, **(controller or {})},
        'parameters': {name: [0.0, 500.0, UNITS[name]] for name in found},
    }))  # fmt: skip
    return load_machine(path)


@pytest.mark.parametrize('logged', [True, False])
def test_inverse_dynamics_suggest_where_to_begin(folder, logged) -> None:
    points, position, _, effort = moved(delay=1)
    machine = machine_of(folder, {'set_point_delay': CYCLE}, tuple(TRUE))
    points = np.array(GEARS)[:, None] * points
    data = Dataset(DRIVES, CYCLE, 0, points, None, position, None, effort if logged else None)
    model = make_model(machine, data, quantities=('position',))
    found = dict(zip((p.name for p in model.parameters), model.suggested(), strict=True))
    # Without an effort, what brakes by kv and by damping is one number.
    for name in TRUE if logged else ('kp', 'armature', 'frictionloss'):
        geared = np.square(GEARS) if name in ('kp', 'kv') else np.ones(2)
        values = geared * [found[f'{drive}.{name}'] for drive in DRIVES]
        assert values == pytest.approx(TRUE[name], rel=0.2), name  # a search goes on from here


def test_a_log_at_rest_or_without_positions_suggests_little(folder) -> None:
    machine = machine_of(folder, {}, tuple(TRUE))
    rest = np.zeros((2, 400))
    data = Dataset(DRIVES, CYCLE, 0, rest, None, rest, None, None)
    model = make_model(machine, data, quantities=('position',))
    assert np.isfinite(model.suggested()).all()
    seen = np.full_like(rest, np.nan)
    seen[:, :2] = 0.0
    few = make_model(machine, replace(data, position=seen), quantities=('position',))
    assert few.suggested() is None


def test_a_urdf_is_refused_with_the_remedy(folder, capsys) -> None:
    path = folder / 'arm.urdf'
    out = str(folder / 'none.yaml')
    words = ['new-machine', '--kind', 'mujoco', '--description', str(path), '--out', out]
    assert main(words) == 2
    refused = 'is a URDF, and MuJoCo simulates an MJCF here; let `ident new-machine'
    assert refused in capsys.readouterr().err and not Path(out).exists()
    machine_of(folder)
    text = (folder / 'machine.yaml').read_text().replace('arm.xml', 'arm.urdf')
    (folder / 'old.yaml').write_text(text)
    assert main(['check', '--machine', str(folder / 'old.yaml')]) == 1
    assert refused in capsys.readouterr().out


def test_from_urdf_and_log_to_parameters(folder, capsys) -> None:
    points, position, velocity, effort = moved(count=900, firm=True)
    noise = np.random.default_rng(1).standard_normal((2, 2, position.shape[1]))
    stamp = np.arange(position.shape[1]) * round(CYCLE * 1e9)
    state = Stream(DRIVES, stamp, position=(position + 2e-5 * noise[0]).T, velocity=velocity.T,
                   effort=(effort + 0.05 * noise[1]).T)  # fmt: skip
    log = Recording(state, command=Stream(DRIVES, stamp, position=points.T))
    write_bag(folder / 'log', log)
    out = folder / 'mine.yaml'
    words = ['new-machine', '--description', str(folder / 'arm.urdf'), '--out', str(out)]
    assert main([*words, '--bag', str(folder / 'log')]) == 0
    assert 'lets the arm run freely under its controllers' in capsys.readouterr().out
    machine = load_machine(out)
    assert machine.kind == 'serial'
    assert machine.drives == DRIVES
    assert set(machine.bounds) == set(COMPILED)
    words = ['identify', str(folder / 'log'), '--machine', str(out), '--quiet', '--no-overlay',
             '--no-report', '--out', str(folder / 'out'), '--generations', '4',
             '--population', '128']  # fmt: skip
    assert main(words) == 0
    found = yaml.safe_load((folder / 'out/result.json').read_text())['parameters']
    assert len(found) == 10
    for full, p in found.items():
        drive, name = full.split('.')
        true = TRUE[COMPILED[name]][DRIVES.index(drive)]
        assert p['value'] == pytest.approx(true, rel=0.05), full


def test_friction_that_gives_way_as_a_damper_is_begun_as_described(tmp_path) -> None:
    # Light, it never takes 30 N m to move: inverse dynamics see a damper.
    text = (
        '<mujoco><worldbody><body><inertial pos="0.1 0 0" mass="0.3" '
        'diaginertia="1e-3 1e-3 1e-3"/>'
        '<joint name="wrist" axis="0 1 0" frictionloss="30"/></body></worldbody>'
        '<actuator><position joint="wrist" kp="50"/></actuator></mujoco>'
    )
    (tmp_path / 'arm.xml').write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    data, points, seen = mujoco.MjData(model), [], []
    for k in range(2000):
        points.append(0.8 * np.sin(0.006 * k) + 0.3 * np.sin(0.017 * k))
        seen.append(float(data.qpos[0]))
        data.ctrl[:] = points[-1]
        mujoco.mj_step(model, data, 2)
    (tmp_path / 'machine.yaml').write_text(yaml.safe_dump({
        'machine': 'mujoco', 'drives': ['wrist'], 'geometry': {'description': 'arm.xml'},
        'controller': {'cycle': CYCLE},
        'parameters': {name: [0.0, 200.0, UNITS[name]] for name in TRUE}
        | {'set_point_delay': [0.0, 0.2, 's']},
    }))  # fmt: skip
    log = Dataset(('wrist',), CYCLE, 0, np.array([points]), None, np.array([seen]), None, None)
    begun = make_model(load_machine(tmp_path / 'machine.yaml'), log)
    found = dict(zip((p.name for p in begun.parameters), begun.suggested(), strict=True))
    assert (found['wrist.frictionloss'], found['wrist.kp']) == (30.0, 50.0)
