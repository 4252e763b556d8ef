# SPDX-License-Identifier: Apache-2.0
"""Bounds of effects follow the logged effort, not a limit that a file may leave out."""

from dataclasses import replace
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from checks.reference.axis import simulate_axis
from checks.reference.effects import Effect
from ros2_ident.effects import EffectParameter
from ros2_ident.gap.criteria import at_bound
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.screen import limits_shown
from ros2_ident.identify.run import read_data
from ros2_ident.models import EffectAt, load_machine, Machine, make_model
from ros2_ident.models.recorded import effort_range
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion
from ros2_ident.words.verdict import sentence

ROOT = Path(__file__).parents[2]
AXIS = load_machine(ROOT / 'config/emps.yaml')
TRUTH = {'moving_mass': 95.0, 'coulomb_friction': 20.0, 'viscous_friction': 215.0}


def without_limit(machine: Machine) -> Machine:
    return machine.with_constants(torque_limit=math.inf)


def recording(effect: Effect, seed: int) -> Dataset:
    motion = draw_motion('reversals', AXIS, 6.0, seed)
    log = simulate_axis(AXIS, TRUTH, motion.position, motion.velocity, [effect])
    noise = AXIS.effort_noise * np.random.default_rng(seed).standard_normal(log.effort.shape)
    return Dataset(
        AXIS.drives, log.cycle, 0, motion.position, motion.velocity, log.position, log.velocity,
        log.effort + noise,
    )  # fmt: skip


def test_the_bundled_axis_needs_no_limit() -> None:
    fit = read_data(str(ROOT / 'bags/axis_reversals'), AXIS).datasets
    stated, unstated = (diagnose(m, fit, seed=1) for m in (AXIS, without_limit(AXIS)))
    assert (unstated.effect, unstated.where) == (stated.effect, stated.where)
    assert sentence(unstated) == sentence(stated)
    assert unstated.not_testable == stated.not_testable
    for name, value in stated.parameters.items():
        assert unstated.parameters[name].value == pytest.approx(value.value, rel=1e-9)


def test_the_range_is_what_one_sample_in_a_thousand_exceeds() -> None:
    still = np.zeros((1, 4000))
    effort = np.linspace(-50.0, 50.0, 4000)[None].copy()
    effort[0, 7], effort[0, 9] = 1e4, np.nan
    data = Dataset(AXIS.drives, 1e-3, 0, still, still, None, None, effort)
    assert effort_range(AXIS, [data])[0] == pytest.approx(50.0, rel=2e-3)
    quiet = replace(data, effort=0.1 * effort)
    assert effort_range(AXIS, [quiet, data])[0] == effort_range(AXIS, [data])[0]
    assert effort_range(AXIS, [replace(data, effort=still)])[0] == AXIS.effort_noise


def test_only_sizes_away_from_neutral_are_at_a_bound() -> None:
    size = EffectParameter('torque', 'N m', 0.0, 2.0, 0.0)
    assert at_bound(size, 2.0) and at_bound(size, 1.999)
    assert not at_bound(size, 0.0) and not at_bound(size, 1.9)
    assert not at_bound(replace(size, role='shape'), 2.0)


def test_each_drive_has_its_own_measure() -> None:
    tripod = load_machine(ROOT / 'config/tripod.yaml').with_constants(
        torque_limit=(6.0, 3.0, math.inf), gear_factor=(80.0, 40.0, 20.0)
    )
    still = np.full((3, 4000), 0.2)
    ramp = np.linspace(-1.0, 1.0, 4000)
    effort = np.array([2.0 * ramp, 1.0 * ramp, 0.5 * ramp])
    data = Dataset(tripod.drives, 5e-4, 0, still, 0.0 * still, None, None, effort)
    model = make_model(tripod, data)
    drives = tripod.drives
    high = [model.scaled(EffectAt('coulomb_friction', d))[0].high for d in drives]
    assert high == pytest.approx([2.0, 1.0, 0.5], rel=2e-3)
    # A share of the limit is one of the drive's own, or of twice what it was seen to make.
    limits = [model.effort_limit(d) for d in drives]
    assert limits == pytest.approx([6.0, 3.0, 1.0], rel=2e-3)
    heating = [model.scaled(EffectAt('friction_drift', d))[1].high for d in drives]
    assert heating == pytest.approx([100.0 / x for x in (160.0, 40.0, 10.0)], rel=2e-3)


# ---------------------------------------------------------------------- limits, where they start

NOISE = 0.01


def _log(limit: float) -> np.ndarray:
    generator = np.random.default_rng(1)
    time = np.arange(8000) * 1e-3
    effort = 0.2 + 0.6 * np.sin(2.0 * np.pi * time) * np.sin(0.7 * time)
    return np.clip(effort, -limit, limit) + NOISE * generator.standard_normal(time.size)


def _positions(*efforts: np.ndarray) -> list[SimpleNamespace]:
    """Return models that compare positions, on logs that hold efforts too."""
    return [
        SimpleNamespace(
            places=('one',), outputs=[SimpleNamespace(quantity='position')], noise=0.0,
            measured=np.zeros((1, effort.size)),
            data=SimpleNamespace(names=('two', 'one'), effort=np.stack([9.0 * effort, effort])),
            scaled=lambda at: (SimpleNamespace(low=0.02, high=1.0),),
            effort_limit=lambda place: 10.0,
        )
        for effort in efforts
    ]  # fmt: skip


LIMIT, GAIN = EffectAt('torque_saturation', 'one'), EffectAt('position_gain_error', 'one')
THETAS = [np.array([1.0]), np.array([1.0])]


def test_a_limit_is_looked_for_at_the_highest_logged_effort_whatever_is_compared() -> None:
    cut, free = _log(0.5), _log(10.0)
    cut[::3] = np.nan
    # A mean of nine keeps a third of the noise.
    (share,) = limits_shown(LIMIT, _positions(cut), THETAS[:1])
    assert share == pytest.approx(0.05, abs=2e-3)
    (share,) = limits_shown(LIMIT, _positions(cut, free), THETAS)
    assert share == pytest.approx(0.1 * np.abs(free).max(), abs=3e-3)
    assert limits_shown(GAIN, _positions(cut), THETAS[:1]) == []


def test_without_a_logged_effort_a_limit_is_looked_for_below_what_the_model_makes() -> None:
    silent = _positions(_log(0.5), _log(0.5))
    for number, model in enumerate(silent, 1):
        model.data.effort = None
        model.simulated_effort = lambda theta, n=number: n * theta[0] * np.array([[-3.0, 1.0]])

    def starts(scale: float) -> list[float]:
        found = limits_shown(LIMIT, silent, [scale * x for x in THETAS])
        return np.array(found).ravel().tolist()

    assert starts(1.0) == pytest.approx([0.3, 0.39, 0.48, 0.552])
    # No share beyond its bounds, and each once.
    assert starts(10.0) == [1.0]
    assert starts(0.0) == []
