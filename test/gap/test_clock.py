# SPDX-License-Identifier: Apache-2.0
"""How long a diagnosis says that it will still take, with a clock of the test's own."""

from typing import Any

import pytest

from ros2_ident.gap.clock import Clock, DiagnoseProgress


class Time:
    """Seconds that the test sets."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def told(seconds: float = 0.0) -> tuple[Time, Clock, list[DiagnoseProgress]]:
    time, said = Time(), []  # type: tuple[Time, list[DiagnoseProgress]]
    return time, Clock(seconds, lambda: False, said.append, time), said


def run(sizes: list[float], before: float, lengths: list[float], end: float) -> list[Any]:
    """A diagnosis: 4 steps of each part, 1 of the noise; return what was said, and the truth."""
    time, clock, said = told()
    for low, high, length, steps in ((0.0, 0.2, 0.4, 4), (0.2, 0.35, 0.6, 1)):
        clock.enter(low, high)
        for k in range(steps):
            clock.step(k / 4, 'before')
            time.now += before * length / steps
    for size, length in zip(sizes, lengths, strict=True):
        clock.rounds(size)
        for k in range(4):
            clock.step(k / 4, f'round of {size}')
            time.now += length / 4
    clock.rounds(0.0)
    for k in range(4):
        clock.step(k / 4, 'end')
        time.now += end / 4
    whole = clock.elapsed
    return [(whole - p.elapsed, p) for p in said]


@pytest.mark.parametrize(
    ('sizes', 'before', 'lengths', 'end'),
    [
        ([], 3.0, [], 1.6),  # a bundled axis, where nothing is missing
        ([], 4.3, [], 3.3),  # a bundled tripod, likewise
        ([3.2], 12.4, [11.5], 3.0),  # a tripod with Stribeck friction
        ([7.4, 5.6, 5.1, 4.5], 7.0, [7.5, 7.6, 7.5, 12.0], 3.0),  # the axis of EMPS
    ],
)
def test_the_time_to_go_is_honest_to_a_factor_of_two(
    sizes: list[float], before: float, lengths: list[float], end: float
) -> None:
    seen = run(sizes, before, lengths, end)
    whole = seen[0][0]
    begins = [p for (_, p), (_, q) in zip(seen[1:], seen, strict=False) if p.stage != q.stage]
    late = [(left, p) for left, p in seen if p.elapsed >= 0.2 * whole and left > 0.02 * whole]
    assert len(late) >= 4
    for left, progress in late:
        # at the end of a round nobody knows yet whether there will be another one
        most = 2.0 if progress in begins else 3.5
        assert left / most <= progress.eta <= most * left, progress
    shares = [p.fraction for _, p in seen]
    assert shares == sorted(shares) and 0.7 < shares[-1] < 1.0


def test_a_limit_of_time_bounds_what_is_said() -> None:
    time, clock, said = told(seconds=12.0)
    time.now += 10.0
    clock.rounds(8.0)
    clock.step(0.0, 'round')
    assert said[-1].eta == pytest.approx(2.0)
    time.now += 5.0
    assert clock.stopped()
    clock.step(0.5, 'round')
    assert said[-1].eta == 0.0
