# SPDX-License-Identifier: Apache-2.0
"""Bounds of effects follow the logged effort, not a limit that a file may leave out."""

import math

from identify_cases import axis, ROOT
import pytest

from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.run import read_data
from ros2_ident.words.verdict import sentence


def test_the_bundled_axis_needs_no_limit() -> None:
    fit = read_data(str(ROOT / 'bags/axis_reversals'), axis()).datasets
    machines = axis(), axis().with_constants(torque_limit=math.inf)
    stated, unstated = (diagnose(m, fit, seed=1) for m in machines)
    assert (unstated.effect, unstated.where) == (stated.effect, stated.where)
    assert sentence(unstated) == sentence(stated)
    assert unstated.not_testable == stated.not_testable
    for name, value in stated.parameters.items():
        assert unstated.parameters[name].value == pytest.approx(value.value, rel=1e-9)
