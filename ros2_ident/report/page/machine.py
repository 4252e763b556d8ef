# SPDX-License-Identifier: Apache-2.0
"""The machine in space along the log, moved by `page.js`."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass
import json
import math

from markupsafe import Markup
import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.report.page.numbers import number, unit_of
from ros2_ident.report.scene import Scene, TOP

WIDTH, HEIGHT, _MARGIN = 560.0, 420.0, 16.0
# Width and height of a carriage in pixels; of a joint of an arm, whose links are drawn thick.
_CARRIAGE, _JOINT = (10.0, 14.0), (8.0, 8.0)
# Whole numbers of two bytes to a pixel, and instants that the page holds at most.
FINE, MOST = 50.0, 900
# Where it is seen from: turned about the vertical, and from above, rad.
_AZIMUTH, _ELEVATION = math.radians(-65.0), math.radians(18.0)
# The path is the thicker, the larger the residual: classes of its share of the largest.
_CLASSES = 0.25, 0.5, 0.75


@dataclass(frozen=True)
class Moving:
    """A machine that moves.

    Attributes:
        svg: What stands still, as SVG.
        data: What moves, as JSON.
        frames: Instants.
        first: The one that is shown first, of the largest residual.
        summary: What it shows, in words.
        note: What the colours are.
        arm: Whether its links are bodies of their own, and no platform.
    """

    svg: Markup
    data: Markup
    frames: int
    first: int
    summary: str
    note: str
    arm: bool


def moving(scene: Scene) -> Moving:
    """Return a machine as the page moves it."""
    every = max(1, -(-len(scene.stamp) // MOST))
    here = slice(None, None, every)
    figure, gap = scene.figure, scene.gap[here]
    tool, links = figure.tool[here], figure.links[here]
    parts = {
        'links': links.reshape(len(tool), -1, 3),
        'body': (tool[:, None, None] + figure.body).reshape(len(tool), -1, 3),
        'blocks': figure.blocks[here],
    }
    if scene.simulated is not None:
        off = scene.magnification * (scene.simulated[here] - tool)
        parts['simulated'] = (parts['body'] + off[:, None]).reshape(len(tool), -1, 3)
    view = _View.of([figure.frame, *parts.values()])
    time = 1e-9 * (scene.stamp[here] - scene.stamp[0])
    arm = not figure.body.size
    content = {
        'time': np.round(time, 3).tolist(),
        'gap': [None if math.isnan(x) else float(f'{x:.3g}') for x in gap.tolist()],
        'unit': unit_of(scene.unit),
        'fine': FINE,
        'block': _JOINT if arm else _CARRIAGE,
        'parts': {name: _coded(view.seen(points)) for name, points in parts.items()},
    }
    return Moving(
        Markup(''.join(_still(view, figure.frame, view.seen(tool), gap))),
        Markup(json.dumps(content).replace('<', '\\u003c')),
        len(tool),
        int(np.argmax(np.where(np.isnan(gap), -1.0, gap))),
        f'The {scene.machine.replace("_", " ")} in space along the first recording',
        _note(scene),
        arm,
    )


def _note(scene: Scene) -> str:
    known = scene.gap[np.isfinite(scene.gap)]
    text = 'The machine as measured; its path is the thicker, the larger the residual effort'
    if known.size:
        top = float(np.percentile(known, TOP))
        text += f' (thickest from {number(0.75 * top, 2)} {unit_of(scene.unit)} on)'
    if scene.simulated is None:
        return f'{text}.'
    return (
        f'{text}. Orange: the platform as simulated, its deviation times '
        f'{scene.magnification:.0f}.'
    )


@dataclass(frozen=True)
class _View:
    """Where points in space are seen: two directions (2, 3), scale and offset to pixels."""

    directions: Array
    scale: float
    offset: Array

    @classmethod
    def of(cls, parts: list[Array]) -> '_View':
        """Return the view that all points fit into."""
        sin, cos = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
        tilt = math.sin(_ELEVATION)
        across = np.array([-sin, cos, 0.0])
        down = np.array([cos * tilt, sin * tilt, -math.cos(_ELEVATION)])
        directions = np.stack([across, down])
        flat = np.concatenate([part.reshape(-1, 3) for part in parts]) @ directions.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        room = np.array([WIDTH, HEIGHT]) - 2.0 * _MARGIN
        scale = float((room / np.maximum(high - low, 1e-9)).min())
        middle = 0.5 * np.array([WIDTH, HEIGHT])
        return cls(directions, scale, middle - 0.5 * scale * (low + high))

    def seen(self, points: Array) -> Array:
        """Return (..., 2) pixels of points (..., 3)."""
        return self.scale * (points @ self.directions.T) + self.offset


def _coded(points: Array) -> str:
    """Return pixels (F, P, 2) as base64 of whole numbers of two bytes."""
    limit = np.iinfo(np.int16).max
    codes = np.clip(np.round(FINE * points), -limit, limit).astype('<i2')
    return base64.b64encode(codes.tobytes()).decode()


def _still(view: _View, frame: Array, path: Array, gap: Array) -> Iterator[str]:
    """Yield the rails and the tool's path, thicker where the residual is larger."""
    yield f'<path class="zero" d="{_lines(view.seen(frame))}"/>'
    known = gap[np.isfinite(gap)]
    top = float(np.percentile(known, TOP)) if known.size else math.inf
    share = np.nan_to_num(gap[:-1]) / max(top, 1e-300)
    wide = np.digitize(share, _CLASSES)
    pieces = np.stack([path[:-1], path[1:]], axis=1)
    for k in range(len(_CLASSES) + 1):
        yield f'<path class="way w{k}" d="{_lines(pieces[wide == k])}"/>'


def _lines(ends: Array) -> str:
    """Return lines (L, 2, 2) as an SVG path."""
    return ''.join(f'M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}' for (a, b), (c, d) in ends.tolist())
