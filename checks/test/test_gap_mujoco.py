# SPDX-License-Identifier: Apache-2.0
"""The tripod beside MuJoCo: the same physics from a third code, and a few cases diagnosed blind.

Skipped where MuJoCo is not installed; CONTRIBUTING.md says how to bring it in.
"""

import importlib
from pathlib import Path
import sys

import numpy as np
import pytest

from checks.blind import seal
from checks.blind.machines import read_plain
from checks.blind.planning import Wanted
from checks.blind.run import draw_case
from checks.blind.store import Store
from checks.reference.bag_making import draw_parameters
from ros2_ident.models import load_machine
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / 'build/peers'))  # where tools/bench.sh installs it
pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')
tripod = importlib.import_module('checks.generators.mujoco_tripod')
cases = importlib.import_module('checks.generators.mujoco_cases')

FILE = ROOT / 'config/tripod.yaml'
MACHINE = load_machine(FILE)
PLAIN = read_plain(FILE)
NOISE = MACHINE.effort_noise


def probe_on(kind, seconds, seed):
    """One machine and its motion, without effects."""
    parameters = draw_parameters(MACHINE, np.random.default_rng(seed))
    motion = draw_motion(kind, MACHINE, seconds, seed)
    return cases.MujocoProbe(MACHINE, parameters, [motion, motion], NOISE)


def added(name, drive=1, size=None):
    """One effect of MuJoCo's on a drive."""
    kind = cases.KINDS[name]
    return cases.Added(kind, drive, f'drive_{drive + 1}', size or kind.start, (0.0, 0.4, 0.3))


@pytest.mark.parametrize(('kind', 'seed'), [('multi_point', 1), ('reversals', 2)])
def test_the_fast_model_makes_mujocos_torque(kind, seed) -> None:
    probe = probe_on(kind, 1.5, seed)
    fast = probe.model(0).simulate(probe.theta[None])[0]
    apart = np.sqrt(np.mean((probe.effort(0, ()) - fast) ** 2, axis=1))
    assert fast.std(axis=1).min() > 3.0 * NOISE  # something moves
    assert apart.max() < 1e-3 * NOISE
    course, _ = probe.course(probe.motions[0])
    assert np.abs(course.rods).max() < 1e-6


def test_half_the_step_changes_nothing() -> None:
    probe = probe_on('multi_point', 1.0, 1)
    motion = probe.motions[0]
    at = motion.position, motion.velocity
    usual, fine = (tripod.simulate(MACHINE, probe.true, *at, steps)[0] for steps in (10, 20))
    assert np.abs(fine - usual).max() < 1e-4 * NOISE
    # Cases are drawn with longer steps: a thousandth of the smallest noise.
    least = 7e-4 * MACHINE.number('torque_limit')
    assert np.abs(fine - probe.effort(0, ())).max() < 1e-3 * least


@pytest.fixture(scope='module')
def short():
    return probe_on('multi_point', 1.3, 3)


@pytest.mark.parametrize('name', [name for name, kind in cases.KINDS.items() if kind.start])
def test_every_effect_changes_the_log_and_ends(short, name) -> None:
    kind, probe = cases.KINDS[name], short
    # a short motion stays below most limits
    size = kind.most if name == 'saturation' else kind.start
    effort = probe.effort(0, [added(name, 1, size)])
    assert np.isfinite(effort).all()
    assert np.abs(effort - probe.effort(0, ())).max() > 0.1 * NOISE


def test_a_frame_has_settled_before_the_log_begins(short) -> None:
    change = np.abs(short.effort(0, [added('frame', 0, 0.1)]) - short.effort(0, ()))
    # The motion rests for 0.2 s and more; the controllers take up the gears' stretch meanwhile.
    assert change[:, :400].max() < 0.2 * NOISE
    assert change.max() > NOISE


def test_a_limit_shows_as_a_flat_top(short) -> None:
    limit = 0.9 * float(short.log(0, ()).torque[1].max())
    log = short.log(0, [added('saturation', 1, 1.0 / limit)])
    assert log.torque[1].max() == pytest.approx(limit)


def test_effects_of_a_pair_both_act(short) -> None:
    first, second = added('cogging', 0), added('asymmetric friction', 2)
    both = short.effort(0, [first, second]) - short.effort(0, ())
    alone = [short.effort(0, [e]) - short.effort(0, ()) for e in (first, second)]
    left = np.abs(both - sum(alone)).max()
    assert left < 0.2 * min(np.abs(a).max() for a in alone)


def test_elements_of_one_drive_stand_beside_each_other(short) -> None:
    whole = short.with_effects([added('cogging'), added('LuGre, Stribeck'), added('effort bias')])
    drive = whole[0].drives[1]
    assert len(drive.dcmotor) == 3 and drive.forward == 0.0
    assert whole[0].bias[1] > 0.0
    assert np.isfinite(short.effort(0, [added('cogging'), added('LuGre, Stribeck')])).all()


def test_a_payload_is_taken_up_and_put_down(short) -> None:
    payload = short.with_effects([added('payload')])[0].whole
    assert len(payload.turns) == 4 and sorted(payload.turns) == list(payload.turns)


def wanted(sort, names, sizes):
    return Wanted(1, sort, names, sizes, hard=False)


def test_a_drawn_pair_sits_on_two_drives() -> None:
    drawer = cases.MujocoDrawer(PLAIN, 5, wanted('pair', ('torque_ripple', 'backlash'), ()))
    first = drawer.maker('torque_ripple')(0.5)
    second = drawer.maker('backlash', [first.where])(0.5)
    assert first.where != second.where
    assert drawer.generator == 'mujoco' and 'law' not in drawer.plain['controller']


def test_a_case_from_mujoco_is_drawn_and_sealed(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr('checks.blind.draw.FIT_SECONDS', 2.0)
    monkeypatch.setattr('checks.blind.draw.CHECK_SECONDS', 1.5)
    store = Store(tmp_path / 'run')
    store.begin({'cases': 1, 'seed': 5, 'shares': ''}, FILE)
    case = wanted('single', ('torque_ripple',), (5.0,))
    label = seal.unseal(draw_case(cases.MujocoDrawer, store, case, 5), 5)
    assert label['generator'] == 'mujoco'
    assert [e['effect'] for e in label['effects']] == ['torque_ripple']
    assert label['rho'] > 2.0 and label['rho_small'] < 0.6
    assert list(store.case(1).glob('*/metadata.yaml')), 'its bags'
