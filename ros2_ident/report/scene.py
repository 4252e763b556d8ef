# SPDX-License-Identifier: Apache-2.0
"""A machine in space as it was measured: markers that RViz and Foxglove draw.

The drives are where the log has them, the tool where the machine file's geometry then holds it.
Its path is coloured by the residual effort.
"""

from dataclasses import dataclass
import functools
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.identify.problem import Problem
from ros2_ident.machine.kind import Figure
from ros2_ident.models.registry import kind_of
from ros2_ident.recording import Stream
from ros2_ident.recording.definition import standard
from ros2_ident.recording.motion import fill_gaps
from ros2_ident.recording.streams import FloatArray, IntArray

MARKERS = 'visualization_msgs/msg/MarkerArray'
# Pictures a second, and how often what stands still is said again, for those who come later.
RATE, REPEAT = 20.0, 20
# The brightest colour is the gap that this percentage of the path stays below.
TOP = 95.0
_CUBES, _STRIP, _LINES, _TEXT = 6, 4, 5, 9
Msg = Any

Colour = tuple[float, float, float, float]
GREY: Colour = (0.45, 0.45, 0.45, 1.0)
BLUE: Colour = (0.0, 0.45, 0.70, 1.0)
BLACK: Colour = (0.0, 0.0, 0.0, 1.0)
# From no gap to the largest one, dark to bright, also for those who see no red or green.
_SCALE = np.array([[0.00, 0.14, 0.40], [0.49, 0.48, 0.47], [0.99, 0.91, 0.14]])


@dataclass(frozen=True, eq=False)
class Scene:
    """A machine's motion in space, at F instants.

    Attributes:
        machine: The kind of machine, which names the frame of what is drawn.
        stamp: Stamps (F,), ns.
        figure: What to draw of the measured machine at each instant.
        gap: Residual effort, root of the mean square over the drives (F,); NaN where unknown.
    """

    machine: str
    stamp: IntArray
    figure: Figure
    gap: FloatArray
    unit: str


def scene_of(problem: Problem, theta: Array, residual: Stream, segment: int = 0) -> Scene | None:
    """Return the motion of a machine in space.

    Args:
        theta: (N,) parameters, physical units.
        residual: The segment's residual effort, from `overlay_streams`.
        segment: Its number, from 0.

    Returns:
        The scene; None where nothing of the machine is drawn or no positions were measured.
    """
    machine = problem.machine
    dataset = problem.data.datasets[segment]
    draw = kind_of(machine).scene
    if draw is None or dataset.position is None:
        return None
    cycle = np.arange(0, dataset.cycles, max(1, round(1.0 / (RATE * dataset.cycle))))
    order = [dataset.names.index(name) for name in machine.drives]
    own = problem.own(segment, theta)[0].tolist()
    names = (p.name for p in problem.models[segment].parameters)
    values = dict(zip(names, own, strict=True)) | problem.fixed
    position = np.stack([fill_gaps(dataset.position[d])[cycle] for d in order])
    figure = draw(machine.with_values(values), position)
    if figure is None:
        return None
    stamp = dataset.start + np.round(cycle * dataset.cycle * 1e9).astype(np.int64)
    assert residual.effort is not None
    gap = np.sqrt(np.nanmean(residual.effort**2, axis=1))
    there = np.isfinite(gap)
    gap = np.interp(stamp, residual.stamp[there], gap[there], np.nan, np.nan)
    return Scene(machine.kind, stamp, figure, gap, machine.effort_unit)


def scene_messages(scene: Scene) -> list[bytes]:
    """Return the scene as serialised MarkerArray messages, one an instant.

    The first message holds everything; later ones what moves, and from time to time all of it.
    """
    return [
        _serialised(_whole(scene, k) if k % REPEAT == 0 else _moving(scene, k))
        for k in range(scene.stamp.size)
    ]


def largest_gap(scene: Scene) -> bytes:
    """Return one serialised MarkerArray: all of the scene at the instant of the largest gap."""
    known = np.isfinite(scene.gap)
    return _serialised(_whole(scene, int(np.argmax(np.where(known, scene.gap, -1.0)))))


def _serialised(markers: list[Msg]) -> bytes:
    store = standard()
    return bytes(store.serialize_cdr(store.types[MARKERS](markers=markers), MARKERS))


def colours(scene: Scene) -> FloatArray:
    """Return a colour (F, 4) for the gap at each instant; transparent where it is unknown."""
    known = np.isfinite(scene.gap)
    top = float(np.percentile(scene.gap[known], TOP)) if known.any() else 1.0
    share = np.clip(np.where(known, scene.gap, 0.0) / max(top, 1e-300), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(_SCALE))
    rgb = np.stack([np.interp(share, steps, _SCALE[:, c]) for c in range(3)], axis=1)
    return np.column_stack([rgb, known])


def _whole(scene: Scene, k: int) -> list[Msg]:
    """Return what stands still and what moves, at an instant."""
    figure = scene.figure
    known = scene.gap[np.isfinite(scene.gap)]
    largest = float(np.percentile(known, TOP)) if known.size else math.nan
    text = f'path: residual effort 0 (dark) to {largest:.2g} {scene.unit} and more (yellow)'
    above = np.array([0.0, 0.0, figure.frame[..., 2].max() + 0.2 * figure.size])
    draw = functools.partial(_marker, scene, k)
    return [
        draw('frame', 0, _LINES, 0.02, GREY, figure.frame.reshape(-1, 3)),
        draw('frame', 1, _TEXT, 0.08, BLACK, above[None], text=text),
        draw('gap', 0, _STRIP, 0.006, BLACK, figure.tool, colours(scene)),
        *_moving(scene, k),
    ]


def _moving(scene: Scene, k: int) -> list[Msg]:
    figure = scene.figure
    draw = functools.partial(_marker, scene, k)
    body = (figure.tool[k] + figure.body).reshape(-1, 3)
    markers = [
        draw('measured', 0, _CUBES, 0.05, BLUE, figure.blocks[k]),
        draw('measured', 2, _LINES, 0.008, BLUE, figure.links[k].reshape(-1, 3)),
    ]
    if body.size:
        markers.append(draw('measured', 1, _LINES, 0.01, BLUE, body))
    return markers


def _marker(
    scene: Scene,
    k: int,
    name: str,
    number: int,
    kind: int,
    size: float,
    colour: Colour,
    points: FloatArray,
    each: FloatArray | None = None,
    text: str = '',
) -> Msg:
    """Return a visualization_msgs/Marker with points (P, 3), m, in the machine's frame."""
    types, stamp = standard().types, int(scene.stamp[k])
    time, header = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']
    point, rgba = types['geometry_msgs/msg/Point'], types['std_msgs/msg/ColorRGBA']
    here = point(*points[0].tolist()) if kind == _TEXT else point(0.0, 0.0, 0.0)
    return types['visualization_msgs/msg/Marker'](
        header=header(time(stamp // 10**9, stamp % 10**9), scene.machine),
        ns=name,
        id=number,
        type=kind,
        action=0,
        pose=types['geometry_msgs/msg/Pose'](
            here, types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
        ),
        scale=types['geometry_msgs/msg/Vector3'](size, size, size),
        color=rgba(*colour),
        lifetime=types['builtin_interfaces/msg/Duration'](0, 0),
        frame_locked=False,
        points=[] if kind == _TEXT else [point(*row) for row in points.tolist()],
        colors=[] if each is None else [rgba(*row) for row in each.tolist()],
        texture_resource='',
        texture=types['sensor_msgs/msg/CompressedImage'](
            header(time(0, 0), ''), '', np.empty(0, dtype=np.uint8)
        ),
        uv_coordinates=[],
        text=text,
        mesh_resource='',
        mesh_file=types['visualization_msgs/msg/MeshFile']('', np.empty(0, dtype=np.uint8)),
        mesh_use_embedded_materials=False,
    )
