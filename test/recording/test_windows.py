# SPDX-License-Identifier: Apache-2.0
"""Which parts of a long log are fitted on, and what the reader keeps of it."""

from pathlib import Path

import numpy as np
import pytest

from ros2_ident.identify.run import identify, read_data
from ros2_ident.models import load_machine
from ros2_ident.recording import choose_windows, Recording, Stream
from ros2_ident.report.files import load_result, write_result

ROOT = Path(__file__).parents[2]


def log(seconds: float, moving: list[tuple[float, float]], rate: float = 200.0) -> Recording:
    """Return a log of one drive that swings in the given spans and rests elsewhere."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    position = np.zeros_like(time)
    for begin, end in moving:
        there = (time >= begin) & (time < end)
        position[there] = 0.1 * (1.0 - np.cos(4.0 * np.pi * (time[there] - begin)))
    stamp = np.round(time * 1e9).astype(np.int64)
    column = position[:, None]
    return Recording(
        Stream(('a',), stamp, column), Stream(('a',), stamp, effort=column), None, 'log'
    )


def test_motion_is_taken_and_rest_is_not() -> None:
    recording = log(300.0, [(120.0, 150.0), (230.0, 250.0)])
    chosen = choose_windows([recording], ('a',), samples=8_000)
    assert chosen is not None
    assert chosen.samples == 60_000
    assert sum(e - b for _, b, e in chosen.fit) * 1e-9 * 200.0 <= 8_000
    moving = 0.0
    for _, begin, end in chosen.fit:
        part = recording.between(begin, end).state
        assert part is not None and part.position is not None
        moving += float((np.abs(np.diff(part.position[:, 0])) > 0.0).mean())
    assert moving / len(chosen.fit) > 0.8


def test_parts_do_not_overlap_begin_at_rest_and_as_many_again_are_spread_over_the_rest() -> None:
    recording = log(300.0, [(k + 1.0, k + 9.0) for k in range(0, 300, 10)])
    chosen = choose_windows([recording, log(5.0, [])], ('a',), samples=10_000)
    assert chosen is not None and chosen.samples == 61_000
    assert len(chosen.fit) == 5 == len(chosen.check)
    assert chosen.fit == tuple(sorted(chosen.fit))
    begins = [begin for _, begin, _ in chosen.check]
    assert begins[0] < 30e9 and begins[-1] > 250e9 and min(np.diff(begins)) > 30e9
    parts = sorted(chosen.fit + chosen.check)
    assert {number for number, *_ in parts} == {0}
    assert all(one[2] <= two[1] for one, two in zip(parts, parts[1:], strict=False))
    for _, begin, _ in parts:
        near = recording.between(begin, begin + 20_000_000).state
        assert near is not None and near.position is not None
        assert np.ptp(near.position) < 1e-4


def test_long_log_is_fitted_in_part_and_validated_on_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The bundled bag lasts six seconds: what is long is a matter of scale.
    monkeypatch.setattr('ros2_ident.recording.windows.LENGTH', 2.0)
    monkeypatch.setattr('ros2_ident.recording.windows._SHIFT', 0.4)
    machine = load_machine(ROOT / 'config/emps.yaml')
    data = read_data(ROOT / 'bags/axis_reversals', machine, samples=3_500)
    assert data.held_out is not None
    assert sum(d.duration for d in data.datasets) < 4.0
    result = identify(machine, data)
    assert result.validation[0].samples > 1000
    # as good where it was not fitted on, but for chance
    assert result.validation[0].rms == pytest.approx(result.residuals[0].rms, rel=0.1)
    assert any('windows' in warning for warning in result.quality.warnings)
    write_result(tmp_path, result)
    assert load_result(tmp_path).validation == result.validation
