# SPDX-License-Identifier: Apache-2.0
"""How long a diagnosis says that it will still take."""

import pytest

from ros2_ident.gap.diagnose import Clock, DiagnoseProgress


def test_a_limit_of_time_bounds_what_is_said() -> None:
    said: list[DiagnoseProgress] = []
    now = 100.0
    clock = Clock(12.0, lambda: False, said.append, lambda: now)
    now += 10.0
    clock.rounds(8.0)
    clock.step(0.0, 'round')
    assert said[-1].eta == pytest.approx(2.0)
    now += 5.0
    assert clock.stopped()
    clock.step(0.5, 'round')
    assert said[-1].eta == 0.0
