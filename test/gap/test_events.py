# SPDX-License-Identifier: Apache-2.0
"""Pushes from outside: on which drive, at which instants, and when there are none."""

from gap_signals import white
import numpy as np
import pytest

from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.where.events import bursts
from ros2_ident.gap.where.localise import Finding
from ros2_ident.machine.machine import Parameter
from ros2_ident.models.protocol import FullModel, Output
from ros2_ident.words.finding import where

CYCLE, COUNT = 0.01, 1200
TIME = CYCLE * np.arange(COUNT)
NOISE = 0.02
LOW, HIGH = np.array([0.0, 0.0]), np.array([2.0, 2.0])
TRUE = np.array([0.8, 0.5])


class Swinging(FullModel):
    """Two drives, each with an inertia on a motion of its own."""

    parameters = tuple(
        Parameter(f'{name}.inertia', 'kg m^2', 0.0, 2.0, 'physical', 'Newton')
        for name in ('hip', 'knee')
    )
    outputs = (Output('hip', 'N m'), Output('knee', 'N m'))
    measured = np.zeros((2, COUNT))
    cycle = CYCLE

    def __init__(self, pushed: np.ndarray) -> None:
        self.bend = np.stack([np.sin(2.1 * TIME), np.cos(3.4 * TIME)])
        noise = np.random.default_rng(0).normal(0.0, NOISE, (2, COUNT))
        # The motor need not make what something else does.
        self.measured = TRUE[:, None] * self.bend - pushed + noise

    def simulate(self, theta: np.ndarray) -> np.ndarray:
        return theta[:, :, None] * self.bend


def found(pushed: np.ndarray) -> list[Finding]:
    model = Swinging(pushed)
    # Where least squares end that count the pushes, too.
    theta = (model.measured * model.bend).sum(axis=1) / (model.bend**2).sum(axis=1)
    none = np.zeros(2)
    floor = Floor(np.full(2, NOISE), none, none, 'prediction', (white(NOISE),) * 2)
    return bursts(model, LOW, HIGH, theta, floor)


def pulses(*each: tuple[int, float, float], width: float = 0.12) -> np.ndarray:
    out = np.zeros((2, COUNT))
    for drive, instant, size in each:
        out[drive] += size * np.exp(-(((TIME - instant) / width) ** 2))
    return out


def test_pushes_are_told_with_drive_instant_and_size() -> None:
    (knee, hip) = found(pulses((0, 2.347, 0.3), (1, 4.0, -0.9), (1, 9.126, 0.7)))
    assert (knee.drive, hip.drive) == ('knee', 'hip')
    assert knee.coordinate == 'instants'
    told = [event.time for event in knee.events]
    assert told == pytest.approx([4.0, 9.126], abs=0.05)
    assert hip.events[0].time == pytest.approx(2.347, abs=0.05)
    sizes = [event.effort for event in knee.events]
    assert sizes == pytest.approx([-0.9, 0.7], abs=0.12)
    assert where(knee).startswith('knee: as if pushed at ')
    assert max(knee.p_value, hip.p_value) < 1e-6


@pytest.mark.parametrize(
    'pushed',
    [
        np.zeros((2, COUNT)),
        # A swing that rings down, and what comes with every period of the motion.
        pulses((0, 3.0, 0.8), (0, 3.2, -0.7), (0, 3.4, 0.6), width=0.07),
        pulses(*((1, float(t), 0.6) for t in range(1, 12, 2))),
        # A load that hangs there for seconds.
        pulses((0, 6.0, 0.5), width=2.0),
    ],
    ids=['nothing', 'a swing', 'every period', 'a load'],
)
def test_what_is_no_push_is_not_told(pushed: np.ndarray) -> None:
    assert found(pushed) == []
