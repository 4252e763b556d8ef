# SPDX-License-Identifier: Apache-2.0
"""Charts of a diagnosis: how far the gap shrank, and what is most probable."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure
import numpy as np

from ros2_ident.gap.blocks import Interval
from ros2_ident.report.pictures.style import BLUE, GREEN, GREY, numbers, plain, SKY, WIDTH


@dataclass(frozen=True)
class Stage:
    """One step of the waterfall.

    Attributes:
        label: What was done.
        gap: RMS gap after it, with its interval.
    """

    label: str
    gap: Interval


@dataclass(frozen=True)
class Rank:
    """One bar of the ranking.

    Attributes:
        label: Effect and place.
        probability: How probable it is, 0..1.
        gap: Gap with it in the model, in the effort's unit; NaN where not known.
    """

    label: str
    probability: float
    gap: float = float('nan')


def waterfall(stages: Sequence[Stage], floor: Interval, unit: str) -> Figure:
    """Draw the gap before, after the nominal fit, after each effect, and the floor.

    Args:
        stages: The steps in order.
        floor: The noise floor with its interval.
        unit: Unit of the effort.
    """
    figure = Figure(figsize=(WIDTH, 0.9 + 0.5 * (len(stages) + 1)), layout='constrained')
    axes = figure.add_subplot()
    values = [s.gap for s in stages]
    labels = [s.label for s in stages] + ['noise floor']
    # The first gap may be a hundred times the last: then only powers of ten show both.
    wide = max(v.value for v in values) > 8.0 * max(floor.value, 1e-300)
    left = 0.6 * min(floor.value, *(v.value for v in values)) if wide else 0.0
    for i, gap in enumerate([*values, floor]):
        colour = GREY if i == len(values) else GREEN if i == len(values) - 1 else BLUE
        if wide:
            # A bar's length means nothing on a logarithmic axis, a dot's place does.
            axes.plot([left, gap.value], [i, i], color=colour, lw=2.0)
            axes.plot(gap.value, i, color=colour, marker='o', ms=9)
        else:
            axes.barh(i, gap.value, color=colour, height=0.62)
        if np.isfinite(gap.low) and np.isfinite(gap.high):
            axes.plot([gap.low, gap.high], [i, i], color='black', lw=1.4, marker='|', ms=7)
        end = max(gap.value, gap.high if np.isfinite(gap.high) else gap.value)
        text = f'{gap.value:.3g}'
        if 0 < i < len(values) and values[i - 1].value > 0.0:
            text += f'  ({100.0 * (gap.value / values[i - 1].value - 1.0):+.0f} %)'
        axes.annotate(
            text, (end, i), xytext=(6, 0), textcoords='offset points', va='center', fontsize=9
        )
    axes.axvline(floor.value, color=GREY, lw=1.2, ls='--', zorder=0)
    if wide:
        axes.set_xscale('log')
        axes.set_xlim(left, 3.0 * max(v.value for v in values))
        numbers(axes.xaxis)
    else:
        axes.set_xlim(0.0, 1.3 * max(max(v.value, v.high) for v in (*values, floor)))
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.set_xlabel(f'gap between simulated and measured effort, RMS [{unit}], with 95 % interval')
    plain(axes)
    axes.grid(axis='y', visible=False)
    return figure


def ranking(ranks: Sequence[Rank], unit: str, most: int = 10) -> Figure:
    """Draw how probable each effect is, the most probable first.

    Args:
        ranks: Effects with their places.
        unit: Unit of the gaps.
        most: How many are drawn.
    """
    chosen = sorted(ranks, key=lambda r: -r.probability)[:most]
    figure = Figure(figsize=(WIDTH, 0.9 + 0.36 * max(1, len(chosen))), layout='constrained')
    axes = figure.add_subplot()
    for i, rank in enumerate(chosen):
        axes.barh(i, rank.probability, color=GREEN if i == 0 else SKY, height=0.65)
        text = f'{100.0 * rank.probability:.0f} %' if rank.probability >= 0.01 else '< 1 %'
        if np.isfinite(rank.gap):
            text += f'   leaves {rank.gap:.3g} {unit}'
        axes.annotate(
            text, (rank.probability, i), xytext=(5, 0), textcoords='offset points', va='center',
            fontsize=9,
        )
    axes.set_yticks(range(len(chosen)), [r.label for r in chosen])
    axes.set_xlim(0.0, 1.35)
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axes.invert_yaxis()
    axes.set_xlabel('probability')
    plain(axes)
    axes.grid(axis='y', visible=False)
    return figure
