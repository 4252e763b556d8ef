# SPDX-License-Identifier: Apache-2.0
"""Figures 4 to 9 of the paper, drawn from our own runs."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from checks.paper.belt import Array, eigenfrequencies_over_position, Trial, TRUTH
from ros2_ident.files import replacing
from ros2_ident.models.belt_drive.model import BeltDrive

# Two inks that differ in lightness too, and grey for what only frames them.
INK, SECOND, GREY = '#1f4e79', '#d1732b', '#8a8a8a'


def _axes(width: float = 6.4, height: float = 3.4) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout='constrained')
    axes = figure.add_subplot()
    tidy(axes)
    return figure, axes


def tidy(axes: Any) -> None:
    """Give axes the look that all pictures of the page share."""
    axes.spines[['top', 'right']].set_visible(False)
    axes.grid(color='#e4e4e4', linewidth=0.6)
    axes.set_axisbelow(True)


def save(figure: Figure, path: Path) -> None:
    """Write a picture."""
    # Without a date in the file, equal pictures are equal files.
    with replacing(path, replace=True) as file:
        figure.savefig(file, format='png', dpi=120, metadata={'Software': None})


def eigenfrequency(path: Path) -> tuple[float, float]:
    """Draw Fig. 4 and return the lowest and highest first eigenfrequency, Hz."""
    positions = np.linspace(0.0, 0.7, 141)
    first = eigenfrequencies_over_position(positions)[:, 0]
    figure, axes = _axes()
    axes.plot(positions, first, color=INK, linewidth=1.8)
    axes.set(xlabel='x0 (m)', ylabel='f (Hz)', xlim=(0.0, 0.7), ylim=(65.0, 85.0))
    title = f'First eigenfrequency over the rail position, P = {TRUTH[1]:.4g} Nm/rad'
    axes.set_title(title, fontsize=10)
    save(figure, path)
    return float(first.min()), float(first.max())


def angle(path: Path, belt: BeltDrive) -> None:
    """Draw Fig. 5: the set-point and the driving gear's angle."""
    phi1 = belt.simulate(TRUTH[None, :])[0, 0]
    time = np.arange(phi1.size) * belt.cycle
    figure, axes = _axes()
    axes.plot(time, np.degrees(phi1), color=INK, linewidth=0.8, label='angle φ1')
    axes.plot(time, np.degrees(belt.reference), color=SECOND, linewidth=1.6, label='set-point φ1d')
    axes.set(xlabel='t (s)', ylabel='angle (degrees)', xlim=(0.0, 1.0))
    axes.legend(frameon=False, loc='upper left')
    axes.set_title('Step-like set-point and angle of the driving gear', fontsize=10)
    save(figure, path)


def torque(path: Path, belt: BeltDrive, window: tuple[float, float]) -> float:
    """Draw Fig. 6 or 7, the driving torque; return its largest magnitude in the window, Nm."""
    moment = belt.simulate(TRUTH[None, :])[0, 1]
    time = np.arange(moment.size) * belt.cycle
    seen = (time >= window[0] - 1e-9) & (time <= window[1] + 1e-9)
    close = window[1] - window[0] < 0.5
    figure, axes = _axes()
    axes.plot(
        time[seen],
        moment[seen],
        color=INK,
        linewidth=1.2 if close else 0.7,
        marker='.' if close else None,
        markersize=3,
    )
    axes.set(xlabel='t (s)', ylabel='M1 (Nm)', xlim=window)
    axes.set_title('Driving torque' + (', close-up' if close else ''), fontsize=10)
    save(figure, path)
    return float(np.abs(moment[seen]).max())


def cloud(path: Path, belt: BeltDrive, trial: Trial, title: str) -> None:
    """Draw Fig. 8 or 9: the cost of every candidate over EA, and over EA and P."""
    figure = Figure(figsize=(10.0, 4.2))
    flat = figure.add_axes((0.07, 0.13, 0.46, 0.76))
    tidy(flat)
    stiffness = trial.points[:, 0] * 1e-5
    gain = trial.points[:, 1]
    flat.plot(stiffness, trial.costs, '.', color=INK, markersize=3, alpha=0.45)
    flat.plot(*_line(belt), color=GREY, linewidth=0.6, label='cost along EA at P = 45 Nm/rad')
    flat.plot(
        trial.found[0] * 1e-5,
        trial.cost,
        'o',
        color=SECOND,
        markersize=7,
        clip_on=False,
        zorder=5,
        label='found: EA = {:.0f} N, P = {:.4f} Nm/rad'.format(*trial.found),
    )
    # Room for the legend above the cloud, where no candidate lies.
    flat.set(xlabel='EA (1e5 N)', ylabel='cost e', xlim=(1.5, 2.5))
    flat.set_ylim(0.0, 1.25 * float(trial.costs.max()))
    flat.legend(frameon=False, loc='upper left', fontsize=8)
    solid: Any = figure.add_axes((0.54, 0.03, 0.44, 0.94), projection='3d')
    solid.scatter(stiffness, gain, trial.costs, s=3, color=INK, alpha=0.35, depthshade=False)
    solid.scatter(
        [trial.found[0] * 1e-5],
        [trial.found[1]],
        [trial.cost],
        s=40,
        color=SECOND,
        depthshade=False,
    )
    solid.set(xlabel='EA (1e5 N)', ylabel='P (Nm/rad)')
    solid.set(xticks=[1.5, 2.0, 2.5], yticks=[30, 45, 60], zticks=[0.0, 0.05, 0.1, 0.15])
    solid.tick_params(labelsize=8)
    solid.set_zlabel('cost e')
    solid.view_init(22.0, -60.0)
    solid.set_box_aspect(None, zoom=0.88)
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def _line(belt: BeltDrive) -> tuple[Array, Array]:
    stiffness = np.linspace(1.5e5, 2.5e5, 2001)
    line = np.column_stack([stiffness, np.full(stiffness.size, TRUTH[1])])
    return stiffness * 1e-5, belt.cost(line, belt.simulate(TRUTH[None, :])[0])
