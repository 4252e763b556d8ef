# SPDX-License-Identifier: Apache-2.0
import io

from gap_signals import CYCLE, floor_of, motion, residual
import numpy as np
import pytest

from ros2_ident.gap.blocks import Interval
from ros2_ident.gap.localise import localise
from ros2_ident.report.pictures.charts import Rank, ranking, Stage, waterfall
from ros2_ident.report.pictures.residuals import overlay, residual_map, residual_maps

OF = motion(4.0)
ROW = residual(OF, 0.03 * np.tanh(OF.velocity[0] / 0.003))


def _drawn(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', dpi=60)
    return len(buffer.getvalue())


@pytest.mark.parametrize(
    'name', ['velocity, odd', 'position', 'motor angle', 'size by load', 'time', 'frequency',
             'way since reversal, odd', 'torque rate']
)
def test_maps_are_drawn(name):
    figure = residual_map(OF, ROW, floor_of(), 0, name)
    assert 'drive_1' in figure.axes[0].get_title(loc='left')
    assert figure.axes[0].get_xlabel()
    assert _drawn(figure) > 2000


def test_maps_of_findings_have_names_for_files():
    figures = residual_maps(OF, ROW, floor_of(), localise(OF, ROW, floor_of()), most=2)
    assert 1 <= len(figures) <= 2
    assert all(name.startswith('drive_1_') and ' ' not in name for name in figures)


def test_the_overlay_has_two_panels_a_drive():
    measured = OF.torque + np.where(np.isfinite(ROW), ROW, np.nan)
    figure = overlay(OF, measured, ROW, floor_of())
    assert len(figure.axes) == 2 * len(OF.drives)
    assert _drawn(figure) > 5000
    assert figure.axes[-1].get_xlim()[1] > OF.position.shape[1] * CYCLE * 0.9


@pytest.mark.parametrize(('first', 'scale'), [(0.3, 'log'), (0.03, 'linear')])
def test_the_waterfall_shows_every_stage(first, scale):
    stages = [
        Stage('nominal fit', Interval(first, 0.9 * first, 1.1 * first)),
        Stage('+ stribeck on drive_1', Interval(0.0101, 0.01, 0.0102)),
    ]
    axes = waterfall(stages, Interval(0.01, 0.0098, 0.0102), 'N m').axes[0]
    assert [t.get_text() for t in axes.get_yticklabels()][-1] == 'noise floor'
    assert axes.get_xscale() == scale


def test_the_ranking_is_sorted():
    figure = ranking([Rank('b', 0.1), Rank('a', 0.8, 0.01)], 'N m')
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ['a', 'b']
    assert _drawn(figure) > 1000
