# SPDX-License-Identifier: Apache-2.0
"""A diagnosis of a log in which one drive hardly moves."""

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.gap.recordings import recordings_of, Split
from ros2_ident.identify.data import gather
from ros2_ident.models import machine_from_mapping
from ros2_ident.recording import Recording, Stream

MACHINE = machine_from_mapping(
    {
        'machine': 'linear_axis',
        'drives': ['near', 'far'],
        'effort_unit': 'N',
        'controller': {'cycle': 0.02},
        'parameters': {'moving_mass': [0.0, 9.0, 'kg'], 'coulomb_friction': [0.0, 9.0, 'N']},
    }
)


def test_the_drive_that_hardly_moves_can_be_left_out_as_said():
    time = 0.02 * np.arange(1000)
    place = np.stack([np.sin(2.0 * time), 0.05 * np.clip(4.0 * (time - 10.0), 0.0, 1.0)], axis=1)
    rate = np.gradient(place, time, axis=0)
    effort = 3.0 * np.gradient(rate, time, axis=0) + 2.0 * np.tanh(rate / 0.01)
    effort += np.random.default_rng(1).normal(0.0, 0.05, effort.shape)
    stamp = np.round(1e9 * time).astype(np.int64)
    log = Recording(Stream(MACHINE.drives, stamp, place, None, effort), source='log')
    data = gather([log], MACHINE).datasets
    with pytest.raises(IdentError, match=r'far moves too little .*leave it out \(--drives near\)'):
        Split(recordings_of(MACHINE, data))
    assert Split(recordings_of(MACHINE, data, drives=['near'])).drives == ('near',)
