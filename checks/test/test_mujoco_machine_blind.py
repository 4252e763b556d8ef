# SPDX-License-Identifier: Apache-2.0
"""The blind cases of MJCFs: drawn by MuJoCo itself, sealed, judged."""

import importlib
import json
from pathlib import Path
import sys

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / 'build/peers'))
pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')

from models.test_mujoco import data_with, machine_of, MJCF  # noqa: E402

from checks.blind import mjcf, seal  # noqa: E402
from checks.blind.keep import keep_all, verify  # noqa: E402
from checks.blind.score import exact  # noqa: E402
from checks.blind.store import Store  # noqa: E402
from ros2_ident.errors import IdentError  # noqa: E402
from ros2_ident.models import load_machine, make_model  # noqa: E402
from ros2_ident.models.mujoco.model import Mujoco  # noqa: E402
from ros2_ident.recording import Dataset  # noqa: E402


@pytest.fixture(scope='module')
def blind():
    return importlib.import_module('checks.generators.mjcf_cases')


def test_blind_cases_are_what_the_machine_simulates_and_can_be_asked_for(tmp_path, blind) -> None:
    (tmp_path / 'robot.xml').write_text(MJCF)
    plant = blind.Plant(MJCF)
    command = blind.motion(2, 2.0, np.random.default_rng(2))
    plain, effort = plant.run([0.02, 0.03], None, command)
    machine = machine_of(tmp_path, {'armature': [0.0, 1.0, 'kg m^2']})
    # The model steps as the description says; its set-points come every 4 ms here.
    twice = [np.repeat(x, 2, axis=1) for x in (plain, command)]
    data = data_with(machine, twice[0], twice[0], command=twice[1])
    model = Mujoco(machine, data, quantities=('effort', 'position'))
    model._begin[:] = np.stack([command[:, 0], np.zeros(2)])
    told = model.simulate(np.array([[0.02, 0.03]]))[0][:, ::2]
    assert told[2:] == pytest.approx(plain, abs=1e-9)
    assert told[:2] == pytest.approx(effort, abs=1e-7)
    offered = {at.effect for at in model.extensions()}
    assert set(blind.HIDDEN) <= offered
    for effect, (size, _, _) in blind.HIDDEN.items():
        size = 11.0 if effect == 'torque_saturation' else 0.1 * size  # of 6 N m, 0.5 are left
        other, _ = plant.run([0.02, 0.03], (effect, 'one', size), command)
        assert not np.array_equal(other[0], plain[0]), effect


def test_a_change_is_as_large_as_what_the_hidden_inertias_leave_of_it(blind) -> None:
    owned = blind.arm_of(MJCF, np.random.default_rng(4))
    command = blind.motion(2, 2.0, np.random.default_rng(2))
    seen = blind.Seen(owned, command)
    change, rho = seen.sized('viscous_friction', 'two', 4.0, 1.0)
    assert 3.4 < rho < 4.7 and change[:2] == ('viscous_friction', 'two')
    # What another armature does, an armature can imitate.
    other = owned.inertia * [1.01, 1.0]
    moved = seen._moved(other, None) - seen.plain
    fitted = np.linalg.lstsq(seen.columns, moved.ravel(), rcond=None)[0]
    left = np.abs(moved.ravel() - seen.columns @ fitted).max()
    assert left < 0.05 * np.abs(moved).max()


def test_blind_cases_are_planned_half_and_half(blind) -> None:
    plan = blind.planned(40, 3)
    for tripod in (True, False):
        names = [w.effect for w in plan.values() if w.tripod is tripod]
        assert len(names) == 20 and names.count(None) == 4
        assert {names.count(name) for name in blind.HIDDEN} <= {3, 4}


def test_a_blind_case_is_sealed_and_judged(blind, tmp_path) -> None:
    store = Store(tmp_path / 'run')
    store.begin({'cases': 1, 'seed': 5, 'shares': '', 'twins': 1}, blind.TRIPOD)
    wanted = blind.Wanted(1, False, 'coulomb_friction', 3.0)
    closed = blind.write_case(store, wanted, MJCF, 5)
    store.seal(1, closed)
    store.close_seals(1)
    case = store.case(1)
    assert sorted(p.name for p in case.iterdir()) == ['check', 'fit', 'machine.yaml', 'robot.xml']
    load_machine(case / 'machine.yaml')
    label = seal.unseal(closed, 5)
    verdict = {'effect': label['change'][0], 'where': [label['change'][1]], 'probability': 1.0}
    # As it comes from JSON.
    label = json.loads(json.dumps(label))
    effects = [{'effect': label['change'][0], 'where': [label['change'][1]]}]
    said = {'error': '', 'verdict': verdict, 'also': [], 'confusable': []}
    row = {**label, 'effects': effects, **said, 'twin': None}
    assert mjcf.placed(row) and mjcf.joint_right(row) and mjcf.of_class(row)
    none = {**row, 'verdict': {'effect': 'none', 'where': [], 'probability': 1.0}}
    assert not mjcf.placed(none) and mjcf.placed({**none, 'effects': []})
    elsewhere = {**row, 'verdict': {**verdict, 'where': ['nowhere']}}
    assert not mjcf.placed(elsewhere) and exact(elsewhere)
    assert list(blind.orders(store, 1)) == [1]
    assert mjcf.row(store, 1, label)['error'] == 'no diagnosis'
    assert len(mjcf.told(store, [row])) == 1 + len(mjcf.figures([row]))
    keep_all(store, tmp_path / 'kept', [row])
    assert verify(tmp_path / 'kept')[-1] == 'the figures are those of the table'
    (tmp_path / 'kept/table.jsonl').write_text(json.dumps({**row, 'rho': 9.0}))
    with pytest.raises(IdentError, match='does not say what its label says'):
        verify(tmp_path / 'kept')


def test_a_tripod_of_the_blind_cases_is_the_packages_own_too(blind, tmp_path) -> None:
    owned = blind.tripod_of(np.random.default_rng(11))
    (tmp_path / 'robot.xml').write_text(owned.plant.text)
    blind.write_machine(tmp_path, {**owned.content, 'geometry': {'description': 'robot.xml'}})
    boxes = load_machine(tmp_path / 'machine.yaml').bounds
    assert set(boxes) == {'armature', 'body_mass'}
    command = blind.motion(3, 1.0, np.random.default_rng(1), blind.TRIPOD_LOG)
    position, effort = owned.plant.run(owned.inertia, None, command)
    machine = blind.machine_of(owned.twin)
    cut = slice(round(blind.SETTLED / blind.TRIPOD_LOG.cycle), None)
    rate = np.gradient(command, blind.TRIPOD_LOG.cycle, axis=1)
    data = Dataset(
        machine.drives, blind.TRIPOD_LOG.cycle, 0, command[:, cut], rate[:, cut],
        position[:, cut], None, effort[:, cut],
    )  # fmt: skip
    model = make_model(machine, data)
    known = {'tool_mass': owned.inertia[-1], 'measurement_delay': 0.0, 'gear_stiffness': 4e6,
             'gear_damping_ratio': 0.5}  # fmt: skip
    inertia = dict(zip(machine.drives, owned.inertia[:3], strict=True))
    names = [p.name.rpartition('.') for p in model.parameters]
    theta = [inertia[d] if n == 'drive_inertia' else known[n] for d, _, n in names]
    told = model.simulate(np.array([theta]))[0]
    law = owned.twin['controller']
    noise = blind.TRIPOD_LOG.noise * law['velocity_gain'] * law['position_gain']
    apart = np.sqrt(np.mean((told - effort[:, cut]) ** 2))
    assert apart < 0.2 * noise < 0.02 * np.std(told)
