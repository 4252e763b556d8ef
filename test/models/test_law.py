# SPDX-License-Identifier: Apache-2.0
"""The controllers fed with the recorded motion, against the slow reference's own logs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from checks.reference.effects import Effect
from checks.reference.tripod import simulate_tripod
from checks.reference.tripod import TABLE_5 as TRUTH
from ros2_ident.gap.reading import coarse_reading
from ros2_ident.models import EffectAt, load_machine, make_model
from ros2_ident.models.recorded import recorded_motion
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion

MACHINE = load_machine(Path(__file__).parents[2] / 'config' / 'tripod.yaml')


def recording(*effects: Effect, kind: str = 'multi_point', seconds: float = 3.0) -> Dataset:
    motion = draw_motion(kind, MACHINE, seconds, 5)
    log = simulate_tripod(MACHINE, TRUTH, motion.position, motion.velocity, effects)
    cycle = MACHINE.number('cycle')
    return Dataset(
        MACHINE.drives, cycle, 0, motion.position, motion.velocity, log.position, log.velocity,
        log.effort,
    )


def missed(data: Dataset, effects=(), values=()) -> np.ndarray:
    """Return (D,) RMS by which the controllers' effort misses the log, a constant left out."""
    model = make_model(MACHINE, data, effects=effects)
    theta = [TRUTH[p.name.split('.')[-1]] for p in model.parameters[: -len(values) or None]]
    there = np.ones(data.effort.shape, dtype=bool)
    there[:, :400] = False
    seen = recorded_motion(data, MACHINE.drives)
    out = model.replay_law(seen, np.array([[*theta, *values]]), there)
    return (data.effort[there] - out[0]).reshape(3, -1).std(axis=1)


def test_what_happens_in_the_machine_does_not_show() -> None:
    stribeck = Effect('stribeck', ('drive_2',), {'torque': 0.1, 'speed': 0.02})
    assert missed(recording(stribeck)).max() < 2e-4


def test_a_gain_that_differs_shows_on_its_drive_and_is_explained_by_the_effect() -> None:
    data = recording(Effect('velocity_gain_error', ('drive_2',), {'share': 0.2}, 'same'))
    plain = missed(data)
    assert plain[1] > 0.01
    assert plain[[0, 2]].max() < 2e-4
    at = (EffectAt('velocity_gain_error', 'drive_2'),)
    assert missed(data, at, (1.2,)).max() < 2e-4


def test_the_replay_is_the_same_for_any_batch() -> None:
    data = recording(seconds=1.5)
    model = make_model(MACHINE, data)
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    theta = low + (high - low) * np.random.default_rng(2).random((11, len(low)))
    seen = recorded_motion(data, MACHINE.drives)
    there = np.isfinite(data.effort)
    alone = np.concatenate([model.replay_law(seen, row[None], there) for row in theta])
    assert np.array_equal(model.replay_law(seen, theta, there), alone)


def test_steps_of_an_encoder_show_in_a_log_too_slow_to_replay_the_controllers() -> None:
    effect = Effect('encoder_quantisation', ('drive_3',), {'step': 6e-5})
    data = recording(effect, kind='mixed', seconds=6.0)
    noise = 0.01 * np.random.default_rng(4).standard_normal(data.effort.shape)
    seldom = np.arange(data.cycles) % 4 == 0
    data = replace(
        data,
        effort=np.where(seldom, data.effort + noise, np.nan),
        position=np.where(seldom, data.position, np.nan),
        velocity=None,
    )
    model = make_model(MACHINE, data)
    theta = np.array([TRUTH[p.name.split('.')[-1]] for p in model.parameters])
    assert model.recorded_motion() is None
    found = coarse_reading(model, None, theta, 'drive_3')
    assert found is not None
    assert found.step == pytest.approx(6e-5, abs=2.0 * found.error)
    other = coarse_reading(model, None, theta, 'drive_1')
    assert other is not None and not other.clear
