# SPDX-License-Identifier: Apache-2.0
import io

import pytest

from ros2_ident.gap.blocks import Interval
from ros2_ident.report.pictures.charts import Rank, ranking, Stage, waterfall


def _drawn(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', dpi=60)
    return len(buffer.getvalue())


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
