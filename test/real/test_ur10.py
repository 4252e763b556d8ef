# SPDX-License-Identifier: Apache-2.0
"""A UR10's recording: identified on the first half, judged on the second."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from ros2_ident.identify.run import identify  # noqa: E402
from ros2_ident.identify.settings import IdentifySettings  # noqa: E402
from ros2_ident.models import EffectAt, load_machine, make_model  # noqa: E402
from ros2_ident.recording import align, Dataset, read_bag  # noqa: E402

ROOT = Path(__file__).parents[2]
RECORDED = ROOT.parent / 'shared/data/ur10_exciting'
MACHINE = load_machine(ROOT / 'config/ur10.yaml')

pytestmark = pytest.mark.skipif(
    not RECORDED.is_dir(), reason='the recording of the UR10 is not here'
)


@pytest.fixture(scope='module')
def halves() -> tuple[Dataset, Dataset]:
    data = align(read_bag(RECORDED)[0], MACHINE.drives, 0.008)
    middle = data.cycles // 2

    def part(cut: slice) -> Dataset:
        fields = ('position', 'velocity', 'effort')
        return replace(data, **{name: getattr(data, name)[:, cut] for name in fields})

    return part(slice(None, middle)), part(slice(middle, None))


def left(halves: tuple[Dataset, Dataset], *effects: EffectAt, **fixed: float) -> np.ndarray:
    """Return the share of each joint's torque that is left on the second half, percent."""
    first, second = halves
    settings = IdentifySettings(method='algebraic')
    found = identify(MACHINE, first, effects=effects, fixed=fixed, settings=settings)
    scales = make_model(MACHINE, first).scales
    model = make_model(MACHINE, second, effects=effects, fixed=fixed, scales=scales)
    counts = np.isfinite(model.measured).sum(axis=1)
    errors = np.split(model.residuals(found.theta)[0], np.cumsum(counts)[:-1])
    return 100.0 * np.array([x.std() for x in errors]) / np.nanstd(model.measured, axis=1)


def test_least_squares_leave_no_more_than_a_plain_regression(halves) -> None:
    # Base parameters, friction and offset behind a low-pass of 5 Hz, made without this package.
    plain = np.array([17.0, 4.4, 5.6, 13.9, 12.5, 31.0])
    assert (left(halves) < 1.1 * plain).all()


def test_with_smoothed_efforts_every_joint_is_left_with_less(halves) -> None:
    plain = left(halves)
    smoothed = left(
        halves, EffectAt('effort_smoothing', 'all'), **{'effort_smoothing.period': 0.53}
    )
    # The last wrist misses its friction, with and without.
    assert (smoothed[:5] < plain[:5]).all()
    assert smoothed[5] < 1.01 * plain[5]
    assert (smoothed[[0, 2, 3]] < 0.7 * plain[[0, 2, 3]]).all()
