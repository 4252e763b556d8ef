# SPDX-License-Identifier: Apache-2.0
"""A kind of machine from another package, in one file: two masses and a spring, in plain NumPy."""

import importlib
import math
from pathlib import Path
import sys
import textwrap

import numpy as np
import pytest
from values import parameter

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.data import gather
from ros2_ident.identify.run import identify, IdentifySettings
from ros2_ident.models import load_machine, make_model
from ros2_ident.models.registry import KINDS, read_machine_file
from ros2_ident.recording import Dataset, read_bag, Recording, Stream, write_bag
from ros2_ident.search import GeneticSettings

SOURCE = '''
"""Motor mass, spring with damper, load mass; a P cascade; semi-implicit Euler."""

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.kernel import rows
from ros2_ident.machine.kind import Remark
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind
from ros2_ident.models.drives.model import DriveModel
from ros2_ident.models.protocol import FullModel

STEPS = 4


class TwoMass(DriveModel):
    """Two masses and a spring for each drive."""

    rigid = False

    _kernel = None
    costs, residuals, simulate_at = FullModel.costs, FullModel.residuals, FullModel.simulate_at
    extensions, work = FullModel.extensions, FullModel.work

    def simulate(self, theta):
        return self.moved(theta)[0]

    def moved(self, theta):
        """Return force, position and speed (S, D, K) of the motors."""
        theta = np.atleast_2d(theta)
        named = {name: np.full(len(theta), value) for name, value in self.fixed.items()}
        named |= {p.name: column for p, column in zip(self.parameters, theta.T)}
        out = np.empty((3, len(theta), len(self.drives), self.data.cycles))
        for number, drive in enumerate(self.drives):
            d = self.data.names.index(drive)
            motor, load = self.machine.number('motor_mass', drive), named[drive + '.moving_mass']
            spring = named[drive + '.gear_stiffness']
            gains = [self.machine.number(k, drive) for k in ('position_gain', 'velocity_gain')]
            target = self.data.command_position[d]
            z = s = np.full(len(theta), target[0])
            v = w = np.zeros(len(theta))
            h = self.cycle / STEPS
            for k, aim in enumerate(target):
                force = gains[1] * (gains[0] * (aim - z) - v)
                out[:, :, number, k] = force, z, v
                for _ in range(STEPS):
                    pull = spring * (z - s) + 40.0 * (v - w)
                    v = v + h * (force - pull) / motor
                    w = w + h * pull / load
                    z = z + h * v
                    s = s + h * w
        return out


def judge(draft):
    for (mass,) in draft.each(('drive', 'motor_mass')):
        if mass > 50.0:
            yield Remark(('drive', 'motor_mass'), f'a motor of {mass:g} kg; weigh it')


KIND = Kind(
    name='two_mass',
    title='two masses and a spring',
    keys=keys_of(
        'two_mass',
        [
            'head',
            {
                'drives': {'example': ['slide']},
                'drive.motor_mass': {
                    'unit': 'kg', 'meaning': 'of the motor', 'example': 2.0, 'range': [0.1, 1e3],
                },
            },
            'controller',
            {
                'controller.cycle': {'example': 2.0e-3},
                'parameters.gear_stiffness': {'example': [500.0, 5000.0]},
                'parameters.moving_mass': {
                    'unit': 'kg', 'meaning': 'of the load', 'example': [1.0, 10.0],
                    'range': [0.0, 1e3], 'each': False,
                },
            },
        ],
    ),
    model=TwoMass,
    judge=judge,
)
'''
FILE = """
machine: two_mass
drives: [slide]
effort_unit: N
effort_noise: 0.05
drive: {motor_mass: 2.0}
controller: {law: cascade_pi, cycle: 2.0e-3, position_gain: 12.0, velocity_gain: 120.0}
parameters:
  moving_mass: [1.0, 10.0, kg]
  gear_stiffness: [500.0, 5000.0, N/m]
"""
TRUTH = {'slide.moving_mass': 4.0, 'slide.gear_stiffness': 1800.0}


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a package of one module that registers the kind by an entry point."""
    (tmp_path / 'two_mass_axis.py').write_text(textwrap.dedent(SOURCE))
    info = tmp_path / 'two_mass_axis-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: two-mass-axis\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text(
        '[ros2_ident.machines]\ntwo_mass = two_mass_axis:KIND\nlost = two_mass_axis:NOTHING\n'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    path = tmp_path / 'slide.yaml'
    path.write_text(FILE)
    yield path
    sys.modules.pop('two_mass_axis', None)


def recording(machine, count=1500, seed=1, ripple=0.0) -> Recording:
    """Return a log of the machine with noise, and a force the model knows nothing of."""
    cycle = machine.number('cycle')
    time = np.arange(count) * cycle
    ramp = np.clip(time / 0.3, 0.0, 1.0) ** 3
    command = (0.1 * ramp * np.sin(7.0 * time) + 0.05 * ramp * np.sin(17.0 * time))[None]
    rate = np.gradient(command, cycle, axis=1)
    data = Dataset(machine.drives, cycle, 0, command, rate, None, None, np.zeros_like(command))
    model = make_model(machine, data)
    truth = np.array([TRUTH[p.name] for p in model.parameters])
    force, place, speed = model.moved(truth)[:, 0]
    force = force + ripple * np.sin(900.0 * place)
    force += 0.05 * np.random.default_rng(seed).standard_normal(force.shape)
    stamp = np.round(time * 1e9).astype(np.int64)
    return Recording(
        Stream(machine.drives, stamp, place.T, speed.T),
        effort=Stream(machine.drives, stamp, effort=force.T),
        command=Stream(machine.drives, stamp, command.T, rate.T),
    )


def test_another_packages_kind_is_known_until_it_is_gone(installed, capsys):
    assert 'two_mass' in KINDS and KINDS['two_mass'].title == 'two masses and a spring'
    assert main(['new-machine', '--kind', 'two_mass']) == 0
    assert 'motor_mass: 2.0' in capsys.readouterr().out
    file = read_machine_file(installed)
    assert file.remarks == () and file.machine is not None
    assert file.machine.number('motor_mass', 'slide') == 2.0
    assert file.machine.number('torque_limit') == math.inf
    assert main(['check', '--machine', str(installed)]) == 0


def test_its_own_judgement_names_the_line(installed):
    installed.write_text(FILE.replace('motor_mass: 2.0', 'motor_mass: 200.0'))
    with pytest.raises(IdentError, match=r'slide.yaml:6: a motor of 200 kg; weigh it'):
        load_machine(installed)


def test_it_is_identified_from_a_bag_like_any_other(installed, tmp_path):
    machine = load_machine(installed)
    write_bag(tmp_path / 'bag', recording(machine))
    data = gather(read_bag(tmp_path / 'bag'), machine)
    few = GeneticSettings(initial_population=24, survivors=3, children=4, generations=3)
    result = identify(machine, data, settings=IdentifySettings(genetic=few))
    for name, value in TRUTH.items():
        assert parameter(result, name).value == pytest.approx(value, rel=0.02)
    assert result.model == 'two_mass'
    assert result.cost.refined == pytest.approx(0.05, rel=0.1)


def test_it_is_diagnosed_like_any_other(installed):
    machine = load_machine(installed)
    data = gather([recording(machine, 900, ripple=0.2)], machine)
    gap = diagnose(machine, data.datasets, seed=1)
    assert gap.effect == 'unknown' and gap.where == ('slide',)
    assert gap.per_drive['slide'].before > 2.0 * gap.per_drive['slide'].noise_floor


def test_a_kind_that_its_package_does_not_hold_spoils_no_other(installed):
    assert 'lost' in KINDS and len(list(KINDS)) == len(KINDS)
    assert KINDS['tripod'].drives == 3
    with pytest.raises(IdentError, match='kind lost of two_mass_axis:NOTHING') as error:
        KINDS['lost']
    assert error.value.code is ErrorCode.UNKNOWN_MODEL
