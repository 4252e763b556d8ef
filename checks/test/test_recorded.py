# SPDX-License-Identifier: Apache-2.0
"""Logs without a set-point and with nothing missing: no effect is named, values are right."""

import pytest

from checks.recorded import draw, judged, line


@pytest.mark.parametrize('number', [7, 8])
def test_nothing_is_named_where_nothing_is_missing(number: int) -> None:
    row = line(drawn := draw(number, 1), judged(drawn))
    assert row['named'] == 'none', row['log']
    held = [x[0] for x in row['held'].values()]
    assert len(held) > 3 and sum(held) >= len(held) - 1
