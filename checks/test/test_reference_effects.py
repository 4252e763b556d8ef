# SPDX-License-Identifier: Apache-2.0
"""Every effect of the reference does something, vanishes with its size, and is drawn by seed."""

import ast
from pathlib import Path

import numpy as np
import pytest

from checks.reference.axis import simulate_axis
from checks.reference.effects import draw_effect, Effect, kinds, suits, TWINS
from checks.reference.tripod import simulate_tripod
from ros2_ident import effects
from ros2_ident.errors import IdentError
from ros2_ident.models import load_machine
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).parents[2]
MACHINE = load_machine(ROOT / 'config' / 'tripod.yaml')
TRUTH = {
    'measurement_delay': 0.005,
    'gear_stiffness': 2.0e5,
    'gear_damping_ratio': 0.4,
    'tool_mass': 1.5,
    'drive_inertia': 9.0e-5,
    'coulomb_torque': 0.06,
    'viscous_torque': 0.03,
}
# An arm's is held against the arms' reference in test/models/test_serial.py.
OF_ARMS = {'hand_load', 'joint_zero_error'}
CATALOGUE = {TWINS.get(name, name) for name in effects.CATALOGUE} - OF_ARMS
AXIS = load_machine(ROOT / 'config' / 'emps.yaml')
AXIS_TRUTH = {'moving_mass': 95.0, 'viscous_friction': 200.0, 'coulomb_friction': 20.0}
ON_A_TRIPOD = [kind.name for kind in kinds().values() if suits(kind, MACHINE, TRUTH)]


@pytest.fixture(scope='module')
def motion():
    return draw_motion('multi_point', MACHINE, 2.5, 3)


@pytest.fixture(scope='module')
def plain(motion):
    return simulate_tripod(MACHINE, TRUTH, motion.position, motion.velocity)


def rms(log, plain):
    return np.sqrt(np.mean((log.effort - plain.effort) ** 2, axis=1))


def test_the_whole_catalogue_is_here():
    assert set(kinds()) == CATALOGUE


# Each is repeated by the kernels, test/models/test_effects.py.
@pytest.mark.parametrize('name', ON_A_TRIPOD)
def test_effect_shows_where_it_sits(name, motion, plain):
    kind = kinds()[name]
    effect = draw_effect(name, np.random.default_rng(1), 0.9, ('drive_2',), MACHINE)
    if name == 'payload_change':  # drawn later than this log ends
        effect.values['time'] = 1.0
    log = simulate_tripod(MACHINE, TRUTH, motion.position, motion.velocity, [effect])
    change = rms(log, plain)
    assert np.all(np.isfinite(log.effort))
    assert log.rod_error < 1e-12
    # It hides behind a gear this stiff.
    floor = 5e-6 if name == 'position_dependent_stiffness' else 1e-3
    assert change[1] > floor
    if kind.place == 'drive':
        assert change[1] == np.max(change)


# A limit, a frame's mass and a bristle's length switch off at infinity or by another law.
NO_ZERO = {'torque_saturation', 'frame_resonance', 'presliding', 'current_loop_lag'}


@pytest.mark.parametrize('name', sorted((CATALOGUE - NO_ZERO) & set(ON_A_TRIPOD)))
def test_effect_vanishes_with_its_size(name, motion, plain):
    kind = kinds()[name]
    values = {quantity.name: quantity.high or quantity.choices[0] for quantity in kind.others}
    values[kind.size.name] = 1e-9 if kind.size.name in ('time', 'length', 'width') else 0.0
    where = ('all',) if kind.place == 'all' else ('drive_2',)
    effect = Effect(name, where, values)
    log = simulate_tripod(MACHINE, TRUTH, motion.position, motion.velocity, [effect])
    assert np.max(rms(log, plain)) < 1e-6


def test_what_a_tripod_has_no_place_for_shows_on_an_axis():
    fed = {name for name, kind in kinds().items() if kind.needs == 'supply'}
    assert len(fed) == 3
    assert CATALOGUE - set(ON_A_TRIPOD) == {'gear_flexibility'} | fed
    motion = draw_motion('reversals', AXIS, 2.0, 1)
    drives = AXIS.drives
    plain = simulate_axis(AXIS, AXIS_TRUTH, motion.position, motion.velocity)
    logs = {}
    for size in (0.0, 0.9):
        rng = np.random.default_rng(1)
        effect = draw_effect('gear_flexibility', rng, size, drives, AXIS)
        logs[size] = simulate_axis(AXIS, AXIS_TRUTH, motion.position, motion.velocity, [effect])
    assert rms(logs[0.9], plain)[0] > 3.0 * rms(logs[0.0], plain)[0] > 0.0
    # The load swings behind the motor, at 5 m/s^2 by 5 / (2 pi f)^2 at least.
    away = np.abs(logs[0.9].carriage - logs[0.9].position)
    assert 1e-5 < away.max() < 2e-3
    none = Effect('gear_flexibility', drives, effect.values | {'share': 1e-7})
    log = simulate_axis(AXIS, AXIS_TRUTH, motion.position, motion.velocity, [none])
    assert rms(log, plain)[0] < 1e-4


def test_a_constant_load_stretches_the_spring_at_rest():
    drives = AXIS.drives
    flexible = {'share': 0.5, 'frequency': 20.0, 'damping': 0.5}
    still = np.full((1, 400), 0.1)
    loaded = [
        Effect('gear_flexibility', drives, flexible),
        Effect('constant_force', drives, {'force': 12.0}),
    ]
    parameters = AXIS_TRUTH | {'coulomb_friction': 0.0}
    log = simulate_axis(AXIS, parameters, still, 0.0 * still, loaded)
    stiffness = 95.0 * 0.25 * (2.0 * np.pi * 20.0) ** 2
    stretch = log.position - log.carriage
    assert stretch[0, -1] == pytest.approx(12.0 / stiffness, rel=1e-3)


def test_size_is_geometric_and_seeded():
    one, two = (
        draw_effect('stribeck', np.random.default_rng(4), 0.5, ('drive_1',), MACHINE) for _ in '12'
    )
    assert one == two
    assert one.values['torque'] == pytest.approx(np.sqrt(0.01 * 0.15))


def test_torques_scale_with_the_machine():
    emps = load_machine(ROOT / 'config' / 'emps.yaml')
    effect = draw_effect('stribeck', np.random.default_rng(4), 0.0, emps.drives, emps)
    assert effect.values['torque'] == pytest.approx(0.01 * 351.5065 / 6.0)


def test_effects_of_one_axis():
    emps = load_machine(ROOT / 'config' / 'emps.yaml')
    parameters = {'moving_mass': 95.0, 'viscous_friction': 200.0, 'coulomb_friction': 20.0}
    motion = draw_motion('reversals', emps, 2.0, 1)
    plain = simulate_axis(emps, parameters, motion.position, motion.velocity)
    names = [kind.name for kind in kinds().values() if suits(kind, emps, parameters)]
    assert 'stribeck' in names and 'backlash' not in names and 'rod_mass' not in names
    for name in ('stribeck', 'asymmetric_friction', 'presliding', 'command_delay', 'cable_spring'):
        effect = draw_effect(name, np.random.default_rng(2), 0.9, emps.drives, emps)
        log = simulate_axis(emps, parameters, motion.position, motion.velocity, [effect])
        assert rms(log, plain)[0] > 0.1


@pytest.mark.parametrize(
    ('name', 'values', 'message'),
    [
        ('friction', {}, 'no effect is called friction'),
        ('stribeck', {'torque': 0.1}, 'needs the values speed, torque; found torque'),
        ('rod_mass', {'mass': 0.1}, 'sits on the whole machine'),
    ],
)
def test_effects_that_cannot_be_are_named(name, values, message):
    with pytest.raises(IdentError, match=message):
        Effect(name, ('drive_2',), values)


def test_unknown_drive_is_named(motion):
    effect = Effect('backlash', ('drive_7',), {'width': 1e-4})
    with pytest.raises(IdentError, match='there is no drive drive_7'):
        simulate_tripod(MACHINE, TRUTH, motion.position, motion.velocity, [effect])


def imports(path: Path) -> set[str]:
    """Return the modules that a file imports, wherever it does so."""
    tree = ast.walk(ast.parse(path.read_text(encoding='utf-8')))
    return {node.module or '' for node in tree if isinstance(node, ast.ImportFrom)}


def test_the_tables_of_the_reference_do_not_import_who_reads_them() -> None:
    for table in ('effect_table', 'effect_kind'):
        found = imports(ROOT / f'checks/reference/{table}.py')
        assert 'checks.reference.effects' not in found, table
