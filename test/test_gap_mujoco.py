# SPDX-License-Identifier: Apache-2.0
"""The tripod beside MuJoCo: the same physics from a third code, and a few cases diagnosed blind.

Skipped where MuJoCo is not installed; CONTRIBUTING.md says how to bring it in.
"""

from dataclasses import replace
import importlib
from pathlib import Path
import sys

import numpy as np
import pytest

from ros2_ident.checks.blind.run import ask_all
from ros2_ident.checks.blind.store import read_json, Store
from ros2_ident.models import load_machine
from ros2_ident.reference.bag_making import draw_parameters
from ros2_ident.reference.motions import draw_motion

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / 'build/peers'))  # where tools/bench.sh installs it
pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')
tripod = importlib.import_module('mujoco_tripod')
cases = importlib.import_module('mujoco_cases')

FILE = ROOT / 'config/tripod.yaml'
MACHINE = load_machine(FILE)
NOISE = MACHINE.effort_noise


def probe_on(kind, seconds, seed):
    """One machine and its motion, without effects."""
    parameters = draw_parameters(MACHINE, np.random.default_rng(seed))
    motion = draw_motion(kind, MACHINE, seconds, seed)
    return cases.MujocoProbe(MACHINE, parameters, [motion, motion])


@pytest.mark.parametrize(('kind', 'seed'), [('multi_point', 1), ('reversals', 2)])
def test_the_fast_model_makes_mujocos_torque(kind, seed) -> None:
    probe = probe_on(kind, 1.5, seed)
    fast = probe._model(0).simulate(probe.theta[None])[0]
    apart = np.sqrt(np.mean((probe.effort(0, ()) - fast) ** 2, axis=1))
    assert fast.std(axis=1).min() > 3.0 * NOISE  # something moves
    assert apart.max() < 1e-3 * NOISE
    course = probe.course(0, probe.true)
    assert np.abs(course.rods).max() < 1e-6


def test_half_the_step_changes_nothing() -> None:
    probe = probe_on('multi_point', 1.0, 1)
    motion = probe.motions[0]
    fine, _ = tripod.simulate(MACHINE, probe.true, motion.position, motion.velocity, 20)
    assert np.abs(fine - probe.effort(0, ())).max() < 1e-4 * NOISE


@pytest.fixture(scope='module')
def short():
    return probe_on('multi_point', 1.3, 3)


@pytest.mark.parametrize('name', [name for name, kind in cases.KINDS.items() if kind.start])
def test_every_effect_changes_the_log_and_ends(short, name) -> None:
    kind, probe = cases.KINDS[name], short
    # a short motion stays below most limits
    size = kind.most if name == 'saturation' else kind.start
    true = kind.write(probe.true, 1, size, [0.0, 0.4])
    effort = probe.effort(0, [true])
    assert np.isfinite(effort).all()
    assert np.abs(effort - probe.effort(0, ())).max() > 0.1 * NOISE


def test_a_frame_has_settled_before_the_log_begins(short) -> None:
    frame = replace(short.true, whole=replace(short.true.whole, frame=(10.0, 12.0, 0.03)))
    change = np.abs(short.effort(0, [frame]) - short.effort(0, ()))
    # The motion rests for 0.2 s and more; the controllers take up the gears' stretch meanwhile.
    assert change[:, :400].max() < 0.2 * NOISE
    assert change.max() > NOISE


def test_a_limit_shows_as_a_flat_top(short) -> None:
    limit = 0.9 * float(short.course(0, short.true).torque.max())
    true = replace(short.true, drives=tuple(replace(d, limit=limit) for d in short.true.drives))
    assert short.course(0, true).torque.max() == limit


@pytest.mark.parametrize(
    ('name', 'size', 'seed', 'expected'),
    [('cogging', 4.0, 2, 'torque_ripple'), ('none', 0.0, 1, 'none')],
)
def test_a_case_from_mujoco_is_diagnosed_by_another_process(
    tmp_path, name, size, seed, expected
) -> None:
    store = Store(tmp_path / 'run')
    store.begin({'cases': 1, 'seed': 5, 'shares': ''}, FILE)
    rng = np.random.default_rng([5, seed])
    drawn = cases.draw_case(MACHINE, cases.KINDS[name], size, rng, (4.0, 3.0))
    folder = store.case(1)
    cases.write_bags(drawn, folder, rng)
    order = {
        'fit': str(folder / 'fit'),
        'check': str(folder / 'check'),
        'machine': str(store.machine),
        'out': str(folder / 'diagnosis'),
    }
    assert list(ask_all(store, {1: order}, 1)) == [1]
    assert store.answered(1)['error'] == ''
    verdict = read_json(folder / 'diagnosis/diagnosis.json')['verdict']
    assert verdict['effect'] == expected
    assert verdict['where'] == ([drawn.where] if expected != 'none' else [])
