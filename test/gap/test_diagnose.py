# SPDX-License-Identifier: Apache-2.0
"""The whole diagnosis on an axis whose logs the slow reference makes."""

from dataclasses import replace
from pathlib import Path
import threading

import numpy as np
import pytest
from scipy.signal import lfilter

from checks.blind.forms import FORMS
from checks.blind.forms.form import Hidden
from checks.reference.axis import simulate_axis
from checks.reference.plant import Unmodelled
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.bootstrap import BlockBootstrap
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.recordings import recordings_of
from ros2_ident.models import load_machine, machine_from_mapping
from ros2_ident.recording import Dataset
from ros2_ident.search.jacobian import diverged
from ros2_ident.words.verdict import sentence

CYCLE = 1e-3
NOISE = 0.01
DESCRIPTION = {
    'machine': 'linear_axis',
    'drives': ['lift'],
    'geometry': {'gravity': 9.81},
    'drive': {'gear_factor': 78.54, 'rail_mass': 1.5, 'coulomb_regularisation': 5e-3},
    'controller': {
        'cycle': CYCLE,
        'position_gain': 60.0,
        'velocity_gain': 4.5,
        'integral_gain': 250.0,
        'velocity_feedforward': 1.0,
        'torque_limit': 6.0,
    },
    'effort_noise': NOISE,
    'parameters': {
        'gear_stiffness': [1e4, 3e5, 'N/m'],
        'gear_damping_ratio': [0.0, 2.0, '1'],
        'drive_inertia': [5e-5, 15e-5, 'kg m^2'],
        'coulomb_torque': [0.0, 0.2, 'N m'],
        'viscous_torque': [0.0, 0.2, 'N m s/m'],
    },
}
MACHINE = machine_from_mapping(DESCRIPTION)
TRUTH = {
    'gear_stiffness': 1.5e5,
    'gear_damping_ratio': 0.4,
    'drive_inertia': 9e-5,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.05,
}


def recording(
    seed: int, effects: tuple[Unmodelled, ...] = (), scale: float = 1.0, noise: float = NOISE
) -> Dataset:
    rng = np.random.default_rng(seed)
    time = np.arange(5000) * CYCLE
    position = np.full_like(time, 0.4)
    for _ in range(4):
        rate, phase, size = rng.uniform(1.0, 9.0), rng.uniform(0, 6.28), rng.uniform(0.01, 0.04)
        position += size * (np.sin(rate * time + phase) - np.sin(phase))
    ramp = np.clip(time / 0.5, 0.0, 1.0)
    position = 0.4 + scale * (position - 0.4) * ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    velocity = np.gradient(position, CYCLE)
    log = simulate_axis(MACHINE, TRUTH, position[None], velocity[None], effects)
    effort = log.effort + noise * rng.standard_normal(log.effort.shape)
    return Dataset(
        MACHINE.drives,
        CYCLE,
        0,
        position[None],
        velocity[None],
        log.position,
        log.velocity,
        np.round(effort / 0.002) * 0.002,
    )


def coloured(data: Dataset, size: float, rho: float) -> Dataset:
    """Return a log with other noise: `size` times what is stated, neighbours correlated."""
    rng = np.random.default_rng(int(1e6 * data.effort[0, -1]) % 1000)
    drawn = rng.standard_normal(data.effort.size + 500)
    noise = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], drawn)[500:]
    return replace(data, effort=data.effort + size * NOISE * noise)


def stribeck() -> Hidden:
    """Return friction that falls off otherwise than the catalogue's."""
    values = {'torque': 0.08, 'speed': 0.03, 'exponent': 1.25}
    return Hidden(FORMS['stribeck.exponential'], 'lift', values, 0.5, 0)


@pytest.fixture(scope='module')
def found():
    effects = (stribeck(),)
    return diagnose(MACHINE, [recording(1, effects)], [recording(2, effects)], seed=3)


def test_an_effect_is_named_with_its_place(found) -> None:
    assert (found.effect, found.where) == ('stribeck', ('lift',))
    assert found.probability > 0.5
    assert found.complete
    assert found.held_out == 'check bag'
    assert found.confusable[0].at.effect == 'stribeck'


def test_the_gap_closes_on_data_not_used_for_fitting(found) -> None:
    gaps = [step.gap.value for step in found.steps]
    assert gaps[-1] < 0.6 * gaps[0]
    assert found.share_closed.value > 0.9
    assert found.floor.per_drive[0] == pytest.approx(NOISE, rel=0.05)


def test_what_may_close_nothing_of_the_data_held_out_is_not_named(monkeypatch) -> None:
    told = BlockBootstrap.share_closed

    def wide(*args, **more):
        return replace(told(*args, **more), low=-0.1)

    monkeypatch.setattr(BlockBootstrap, 'share_closed', wide)
    logs = [recording(seed, (stribeck(),)) for seed in (1, 2)]
    other = diagnose(MACHINE, logs[:1], logs[1:], seed=3)
    assert (other.effect, other.also, other.ranking[0].at.effect) == ('unknown', (), 'stribeck')
    # Where it stands still nothing can be closed, and nothing speaks against the name.
    still = recording(2, (stribeck(),), scale=1e-3)
    assert diagnose(MACHINE, logs[:1], [still], seed=3).effect == 'stribeck'


def test_the_effect_gives_the_nominal_parameters_back(found) -> None:
    # Friction had carried the effect as far as it could.
    for name in ('lift.coulomb_torque', 'lift.viscous_torque'):
        truth = TRUTH[name.split('.')[1]]
        after = abs(found.parameters[name].value - truth)
        assert after < 0.5 * abs(found.nominal[name] - truth), name
    assert found.moved.keys() <= found.nominal.keys()


def test_the_gap_is_found_where_the_axis_reverses(found) -> None:
    assert found.localisation
    assert all(finding.drive == 'lift' for finding in found.localisation)


def test_a_load_that_stays_the_same_is_no_measure_of_a_gap(found) -> None:
    # the lift holds its weight all along
    (drive,) = found.per_drive.values()
    assert drive.share_of_change > 1.2 * drive.share_of_output > 0.0


def test_nothing_is_missing_where_nothing_is() -> None:
    found = diagnose(MACHINE, [recording(4)], [recording(5)], seed=3)
    assert found.effect == 'none'
    assert found.where == ()
    assert 'Nothing that this motion shows is missing' in sentence(found)
    assert found.not_testable and '; this motion cannot show: ' in sentence(found)


def test_nothing_is_missing_where_the_recording_fitted_on_shows_little() -> None:
    # Hardly any motion: friction and inertia are what the search happened upon, and wrong.
    found = diagnose(MACHINE, [recording(1, scale=2e-3)], [recording(2)], seed=3)
    assert found.effect == 'none', sentence(found)
    assert found.held_out == 'blocks'


def test_a_fit_that_runs_away_on_the_recording_held_out_is_one_to_both() -> None:
    # At a rate below the regularisation's friction damps the loop at any inertia. Beyond it, held
    # for a cycle, the velocity gain makes rotors lighter than 2.7e-5 kg m^2 run away.
    controller = {k: v for k, v in DESCRIPTION['controller'].items() if k != 'torque_limit'}
    bounds = DESCRIPTION['parameters'] | {'drive_inertia': [1e-6, 15e-5, 'kg m^2']}
    machine = machine_from_mapping(DESCRIPTION | {'controller': controller, 'parameters': bounds})
    slow, fast = recording(3, scale=2e-3), recording(5)
    alone = diagnose(machine, [slow], seed=3)
    light = [alone.nominal[f'lift.{name}'] for name in TRUTH]
    (model,) = recordings_of(machine, [fast]).models
    assert diverged(model.simulate(np.array([light]))[0]).all()
    found = diagnose(machine, [slow], [fast], seed=3)
    assert (found.effect, found.held_out) == ('none', 'blocks'), sentence(found)
    assert found.nominal['lift.drive_inertia'] == pytest.approx(TRUTH['drive_inertia'], rel=0.05)


def test_one_recording_is_split_into_blocks() -> None:
    found = diagnose(MACHINE, [recording(1, (stribeck(),))], seed=3, without=('presliding',))
    assert found.held_out == 'blocks'
    assert found.effect == 'stribeck'
    assert all(r.at.effect != 'presliding' for r in found.ranking)


def test_a_cancel_keeps_the_best_so_far() -> None:
    effects = (stribeck(),)
    event = threading.Event()

    def stop(progress) -> None:
        if progress.fraction > 0.3:
            event.set()

    found = diagnose(
        MACHINE, [recording(1, effects)], seed=3, cancelled=event.is_set, on_progress=stop
    )
    assert not found.complete
    assert found.steps[0].gap.value > NOISE


def test_bad_input_is_one_sentence() -> None:
    with pytest.raises(IdentError, match='there is no recording to fit on') as info:
        diagnose(MACHINE, [])
    assert info.value.code is ErrorCode.NO_DATA
    with pytest.raises(IdentError, match="no effect is called 'gremlins'"):
        diagnose(MACHINE, [recording(4)], without=('gremlins',))


def test_noise_that_nobody_stated_is_no_gap() -> None:
    size, rho = 2.5, 0.9
    rough = [coloured(recording(seed, noise=0.0), size, rho) for seed in (1, 2)]
    quiet = diagnose(MACHINE, rough[:1], rough[1:], seed=3)
    assert quiet.effect == 'none'
    assert quiet.floor.per_drive[0] == pytest.approx(size * NOISE, rel=0.1)
    assert quiet.floor.noise[0].coefficients.sum() == pytest.approx(rho, abs=0.1)


def swinging(data: Dataset, size: float) -> Dataset:
    """Return a log in which something swings at 4 Hz, now more, now less, as nothing predicts."""
    seed = int(1e6 * data.effort[0, -1]) % 1000
    drawn = np.random.default_rng(seed).standard_normal(data.effort.size + 4000)
    turn = 2.0 * 0.99 * np.cos(2.0 * np.pi * 4.0 * CYCLE)
    swing = lfilter([1.0], [1.0, -turn, 0.99**2], drawn)[4000:]
    return replace(data, effort=data.effort + size * NOISE * swing / swing.std())


def test_what_swings_by_itself_is_no_noise_that_somebody_stated() -> None:
    logs = [swinging(recording(seed), 8.0) for seed in (1, 2)]
    given = replace(MACHINE, given=MACHINE.given | {'effort_noise'})
    found = diagnose(given, logs[:1], logs[1:], seed=3)
    assert (found.effect, found.where) == ('unknown', ('lift',))
    assert 'a load that swings' in sentence(found)


def test_of_a_kind_that_compares_two_quantities_the_effort_is_diagnosed() -> None:
    belt = load_machine(Path(__file__).parents[2] / 'config/belt_drive.yaml')
    row = np.sin(np.linspace(0.0, 6.0, 400))[None]
    data = Dataset(belt.drives, belt.number('cycle'), 0, row, 0.0 * row, row, 0.0 * row, row)
    for output, unit in ((None, 'N m'), ('position', 'rad')):
        (model,) = recordings_of(belt, [data], output=output).models
        assert [(o.quantity, o.unit) for o in model.outputs] == [(output or 'effort', unit)]


def test_the_gap_of_a_position_is_diagnosed_with_an_effort_beside_it() -> None:
    rng = np.random.default_rng(8)
    logs = []
    for seed in (1, 2):
        data = recording(seed, (stribeck(),))
        noisy = data.position + 1e-6 * rng.standard_normal(data.position.shape)
        logs.append(replace(data, position=noisy))
    near = {'stribeck', 'asymmetric_friction', 'presliding', 'backlash', 'cable_spring'}
    others = sorted(set(CATALOGUE) - near)
    found = diagnose(MACHINE, logs[:1], logs[1:], output='position', without=others, seed=3)
    assert (found.effect, found.where, found.unit) == ('stribeck', ('lift',), 'm')
    assert found.per_drive['lift'].noise_floor == pytest.approx(1e-6, rel=0.1)
    # Gates go by the effort, whatever is compared: none takes metres for newton metres.
    assert not [gate for gate in found.gates if gate.gate == 'law_noise']
