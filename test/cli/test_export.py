# SPDX-License-Identifier: Apache-2.0
"""`ident identify` and `ident export` one after the other, on an arm's bag."""

from pathlib import Path
import re

import numpy as np
import pytest

pinocchio = pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from models.test_serial import BOXES, described, moving  # noqa: E402

from ros2_ident.cli.main import main  # noqa: E402
from ros2_ident.models import load_machine, make_model  # noqa: E402
from ros2_ident.recording import Stream, write_bag  # noqa: E402


@pytest.fixture(scope='module')
def identified(tmp_path_factory) -> Path:
    """A folder with machine file, bag and results."""
    folder = tmp_path_factory.mktemp('arm')
    machine = described(folder, **BOXES)
    model = make_model(machine, moving(machine))
    # Every link heavier by a quarter.
    told, _ = model.inertials.changes
    change = 0.25 * told @ np.concatenate([body.inertials for body in model.arm.bodies])
    more = dict(zip(model.inertials.names, change, strict=True))
    theta = np.array([0.5 * (p.low + p.high) + more.get(p.name, 1.0) for p in model.parameters])
    effort = model.simulate(theta)[0]
    effort = effort + np.random.default_rng(0).normal(0.0, 2.0, effort.shape)
    data = model.data
    stamp = (1e9 * (100.0 + data.time)).astype(np.int64)
    streams = {'/joint_states': Stream(data.names, stamp, data.position.T, None, effort.T)}
    write_bag(folder / 'log', streams)
    urdf = folder / 'arm.urdf'
    shape = '<visual><geometry><mesh filename="arm.stl"/></geometry></visual>'
    urdf.write_text(re.sub(r'(<link name="hand">)', rf'\1{shape}', urdf.read_text()))
    words = ['identify', str(folder / 'log'), '--machine', str(folder / 'arm.yaml')]
    words += ['--out', str(folder / 'out'), '--method', 'algebraic', '--quiet', '--no-report']
    assert main(words) in (0, 1)
    return folder


def test_the_results_know_their_machine_file_and_their_log(identified, capsys) -> None:
    out = identified / 'simulator'
    assert main(['export', str(identified / 'out'), '--out', str(out)]) == 0
    said = capsys.readouterr().out
    assert f'urdf: {out / "robot.urdf"}' in said
    assert 'masses of the description ± 30 %' in said
    names = {path.name for path in out.iterdir()}
    loaders = {f'load_{x}.py' for x in ('genesis', 'newton', 'pinocchio', 'pybullet', 'sapien')}
    assert names - {'robot.usda', 'robot.xml'} == loaders | {
        'drake.urdf', 'export.json', 'gazebo.urdf', 'isaac.yaml', 'robot.urdf',
    }  # fmt: skip
    assert 'Drake has no place for Coulomb friction (' in said
    assert '"../arm.stl"' in (out / 'robot.urdf').read_text()
    model = pinocchio.buildModelFromUrdf(str(out / 'robot.urdf'))
    assert model.damping[model.joints[model.getJointId('elbow')].idx_v] == pytest.approx(
        11.0, rel=0.05
    )


@pytest.mark.parametrize(
    ('words', 'remedy'),
    [
        (['--to', 'sdf'], 'sdf is no target; choose from urdf, mjcf, mjcf_effects, drake'),
        (['--to', 'ros2_control'], 'add position_gain'),
        (['--machine', 'nowhere.yaml'], 'the machine file nowhere.yaml is not there'),
        (['--into', 'nowhere.urdf'], 'nowhere.urdf: cannot be read'),
    ],
)
def test_mistakes_are_told_with_the_remedy(identified, tmp_path, capsys, words, remedy) -> None:
    out = ['export', str(identified / 'out'), '--out', str(tmp_path / 'none')]
    assert main([*out, *words]) == 2
    assert remedy in capsys.readouterr().err
    assert not (tmp_path / 'none').exists()
    assert main(['export', str(tmp_path), '--out', str(tmp_path / 'none')]) == 2


def test_a_machine_file_from_description_and_bag(identified, tmp_path, capsys) -> None:
    out = tmp_path / 'files' / 'mine.yaml'
    out.parent.mkdir()
    words = ['new-machine', '--kind', 'serial', '--description', str(identified / 'arm.urdf')]
    assert main([*words, '--bag', str(identified / 'log'), '--out', str(out)]) == 0
    machine = load_machine(out)
    assert machine.drives == ('base', 'slide', 'elbow', 'wrist')
    assert machine.number('cycle') == 0.004
    assert machine.text('description') == (identified / 'arm.urdf').read_text()
    model = make_model(machine, moving(machine))
    assert len(model.parameters) == 1 + 18 + 3 * 4
    # What acts linearly by itself.
    capsys.readouterr()
    words = ['identify', str(identified / 'log'), '--machine', str(out), '--quiet']
    words += ['--method', 'algebraic', '--no-report', '--no-overlay']
    assert main([*words, '--out', str(tmp_path / 'out')]) in (0, 1)
    assert 'elbow.viscous_torque' in capsys.readouterr().out
