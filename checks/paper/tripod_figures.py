# SPDX-License-Identifier: Apache-2.0
"""Figures 11 to 13 of the paper, drawn from our own runs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from checks.paper.figures import GREY, INK, save, SECOND, tidy
from checks.paper.tripod_runs import DriveTrial

Array = NDArray[np.float64]

PALE = '#b4b4b4'

# Scale for the axis, label.
AXES: Mapping[str, tuple[float, str]] = {
    'measurement_delay': (1e3, 'time delay ΔT (ms)'),
    'gear_stiffness': (1e-3, 'gear stiffness c_G (10³ N/m)'),
    'gear_damping_ratio': (1.0, 'gear damping ζ_G (1)'),
    'tool_mass': (1.0, 'tool mass m_t (kg)'),
    'drive_inertia': (1e6, 'drive inertia J_D (10⁻⁶ kg m²)'),
}


def candidates(path: Path, trial: DriveTrial, noise: float) -> None:
    """Draw Fig. 11: the cost of every candidate over each parameter.

    Args:
        noise: Standard deviation of the log's noise, N m.
    """
    figure = Figure(figsize=(10.0, 6.2), layout='constrained')
    grid = figure.add_gridspec(2, 4, height_ratios=(1.25, 1.0))
    places = [grid[0, :], *(grid[1, i] for i in range(4))]
    there = np.isfinite(trial.costs)
    first = there & (trial.generations == 1)
    later = there & (trial.generations > 1)
    # The few candidates that shake against the torque limit would squeeze the rest.
    top = 1.15 * float(np.quantile(trial.costs[there], 0.985))
    for column, place in enumerate(places):
        axes: Any = figure.add_subplot(place)
        tidy(axes)
        name = trial.names[column].split('.')[-1]
        scale, label = AXES[name]
        x = trial.candidates[:, column] * scale
        axes.plot(x[first], trial.costs[first], '.', color=GREY, markersize=2.5, alpha=0.6)
        axes.plot(x[later], trial.costs[later], '.', color=INK, markersize=3.5, alpha=0.6)
        axes.axhline(noise, color='k', linewidth=0.7, linestyle=':')
        axes.axvline(trial.truth[column] * scale, color=SECOND, linewidth=1.0)
        axes.set(xlabel=label, ylim=(0.0, top))
        if column < 2:
            axes.set_ylabel('cost e (N m)')
        else:
            axes.tick_params(labelleft=False)
        if column == 0:
            _legend(axes, int(first.sum()), int(later.sum()), noise)
    above = int((trial.costs[there] > top).sum())
    lost = int((~there).sum())
    said = f'{len(trial.costs)} candidates, seed {trial.seed}'
    said += f'; {above} lie above the axis' if above else ''
    said += f', {lost} diverged' if lost else ''
    figure.suptitle(said, fontsize=10)
    save(figure, path)


def _legend(axes: Any, first: int, later: int, noise: float) -> None:
    axes.plot([], [], '.', color=GREY, markersize=8, label=f'first generation ({first})')
    axes.plot([], [], '.', color=INK, markersize=8, label=f'children ({later})')
    axes.plot([], [], color=SECOND, linewidth=1.0, label='truth')
    axes.plot([], [], color='k', linewidth=0.7, linestyle=':', label=f'noise, {noise:g} N m')
    axes.legend(frameon=True, framealpha=0.9, edgecolor='none', loc=(0.78, 0.16), fontsize=8)


def torque(
    path: Path,
    time: Array,
    measured: Array,
    found: Mapping[str, Array],
    window: tuple[float, float],
) -> None:
    """Draw Fig. 12 or 13: torque measured and optimised, and what is left.

    Args:
        time: (K,) s.
        measured: (K,) N m, NaN where there is no sample.
        found: Label -> (K,) simulated torque, N m; two of them.
        window: Begin and end, s.
    """
    seen = (time >= window[0]) & (time <= window[1])
    there = seen & ~np.isnan(measured)
    close = window[1] - window[0] < 3.0
    figure = Figure(figsize=(10.0, 5.4), layout='constrained')
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
    tidy(upper)
    tidy(lower)
    upper.plot(
        time[there],
        measured[there],
        '.' if close else '-',
        color=PALE,
        linewidth=0.6,
        markersize=2.5,
        label='measurement',
    )
    thin = 1.3 if close else 0.8
    # The second is drawn first and wider, so that both can be seen where they are one.
    for number, (label, values) in reversed(list(enumerate(found.items()))):
        upper.plot(
            time[seen],
            values[seen],
            color=(INK, SECOND)[number],
            linewidth=thin * (1.0, 2.8)[number],
            alpha=(1.0, 0.65)[number],
            label='optimised, ' + label,
        )
    (label, one), (_, other) = found.items()
    left = measured[there] - one[there]
    apart = one[seen] - other[seen]
    lower.plot(
        time[there],
        left,
        '.',
        color=PALE,
        markersize=1.5,
        label=f'measured less optimised, {label}',
    )
    lower.plot(
        time[seen],
        apart,
        color=SECOND,
        linewidth=1.0,
        label=f'the two optimised apart, {1e3 * np.sqrt(np.mean(apart**2)):.2g} mN m RMS',
    )
    limit = 1.9 * float(np.abs(left).max())
    upper.set(ylabel='M (N m)')
    lower.set(xlabel='t (s)', ylabel='M (N m)', xlim=window, ylim=(-0.6 * limit, limit))
    # Room for the legend above the curve.
    low, high = upper.get_ylim()
    upper.set_ylim(low, high + 0.16 * (high - low))
    for axes in (upper, lower):
        axes.legend(frameon=False, loc='upper right', ncols=3, fontsize=8, markerscale=4)
    figure.suptitle('Motor torque of drive 1' + (', close-up' if close else ''), fontsize=10)
    save(figure, path)
