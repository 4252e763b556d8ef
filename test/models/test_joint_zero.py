# SPDX-License-Identifier: Apache-2.0
"""A joint whose position in the log is 0 elsewhere than in the description."""

from dataclasses import replace
from pathlib import Path

from arm_cases import described, JOINTS, LINKS, URDF
import numpy as np
import numpy.typing as npt
import pytest

from ros2_ident.gap.diagnose import diagnose
from ros2_ident.machine.machine import Machine
from ros2_ident.models import EffectAt, make_model
from ros2_ident.recording import Dataset

Array = npt.NDArray[np.float64]
CYCLE = 0.004
ELBOW = EffectAt('joint_zero_error', 'elbow')
HEAVIER = URDF.replace('mass value="3"', 'mass value="4.2"').replace('"1.5"', '"2.2"')


def swinging(cycles: int = 2500) -> Dataset:
    """All joints swing, each at three frequencies of its own."""
    rng = np.random.default_rng(4)
    time, shape = np.arange(cycles) * CYCLE, (len(JOINTS), 3, 1)
    waves = np.sin(rng.uniform(0.8, 5.0, shape) * time + rng.uniform(0.0, 6.0, shape))
    place = (rng.uniform(0.2, 0.5, shape) * waves).sum(axis=1)
    return Dataset(JOINTS, CYCLE, 0, None, None, place, None, np.zeros_like(place))


def logged(data: Dataset, effort: Array, by: float = 0.0) -> Dataset:
    """Return the log with these efforts and another zero of the elbow."""
    assert data.position is not None
    more = np.array([[by * (joint == ELBOW.where)] for joint in JOINTS])
    return replace(data, position=data.position + more, effort=effort)


def asked(machine: Machine, data: Dataset) -> Array:
    """Return (D, K) what the links ask along a log."""
    model = make_model(machine, data)
    return model.simulated_effort(np.array([0.5 * (p.low + p.high) for p in model.parameters]))


def test_another_zero_is_another_position_of_the_links(tmp_path: Path) -> None:
    machine, data = described(tmp_path, coulomb_torque=[-1.0, 1.0, 'N m']), swinging()
    there, by = asked(machine, data), 1e-3
    elsewhere = logged(data, there, by)
    model = make_model(machine, elsewhere, effects=[ELBOW])
    nothing = np.zeros(len(model.parameters))
    nothing[-1] = by
    off = np.abs(asked(machine, elsewhere) - there).max()
    assert model.parameters[-1].name == 'elbow.joint_zero_error.zero'
    np.testing.assert_allclose(model.simulated_effort(nothing), there, rtol=0, atol=2e-3 * off)


def test_the_zero_is_that_of_the_links_as_they_are_and_not_as_described(tmp_path: Path) -> None:
    data, by = swinging(), 0.03
    effort = asked(described(tmp_path / 'heavier', HEAVIER), data)
    model = make_model(described(tmp_path / 'as_told'), logged(data, effort, by), effects=[ELBOW])
    middle = np.array([0.5 * (p.low + p.high) for p in model.parameters])
    plain = model.simulated_effort(middle)
    steps = np.array([model.simulated_effort(middle + e) - plain for e in np.eye(len(middle))])
    found = np.linalg.lstsq(steps.reshape(len(middle), -1).T, (effort - plain).ravel(), rcond=None)
    assert middle[-1] + found[0][-1] == pytest.approx(by, rel=0.05)


def test_it_is_named_with_its_joint_and_size(tmp_path: Path) -> None:
    data, by = swinging(3000), 0.03
    effort = asked(described(tmp_path / 'heavier', HEAVIER), data)
    noise = np.random.default_rng(1).normal(0.0, 0.1, effort.shape)
    friction = {'coulomb_torque': [0.0, 5.0, 'N m']}
    found = diagnose(described(tmp_path / 'as_told', **LINKS, **friction),
                     [logged(data, effort + noise, by)])  # fmt: skip
    assert (found.effect, found.where, found.also) == (ELBOW.effect, (ELBOW.where,), ())
    zero = found.parameters['elbow.joint_zero_error.zero']
    assert zero.low < by < zero.high and zero.value == pytest.approx(by, rel=0.1)
