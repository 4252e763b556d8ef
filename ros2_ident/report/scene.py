# SPDX-License-Identifier: Apache-2.0
"""The tripod in space: markers that RViz and Foxglove draw, moving as measured and as simulated.

The measured carriages are where the log has them, the platform where rigid rods of the machine
file's geometry then hold it. The simulated platform would hide behind the measured one: what it is
off is drawn larger by a power of ten, which a text says. The platform's path is coloured by the
residual effort.
"""

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from rosbags.typesys import get_typestore, Stores

from ros2_ident.errors import IdentError
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import Array
from ros2_ident.recording import Stream
from ros2_ident.recording.streams import FloatArray, IntArray
from ros2_ident.reference.rest import platform_at
from ros2_ident.reference.tripod import simulate_tripod, tripod_plant

MARKERS = 'visualization_msgs/msg/MarkerArray'
FRAME = 'tripod'
# Pictures a second, and how often what stands still is said again, for those who come later.
RATE, REPEAT = 20.0, 20
# The largest deviation that is drawn, as a share of the rails' radius.
SHOWN = 0.25
# The brightest colour is the gap that this percentage of the path stays below.
TOP = 95.0
_CUBES, _STRIP, _LINES, _TEXT = 6, 4, 5, 9
Msg = Any
_STORE = get_typestore(Stores.ROS2_JAZZY)

Colour = tuple[float, float, float, float]
GREY: Colour = (0.45, 0.45, 0.45, 1.0)
BLUE: Colour = (0.0, 0.45, 0.70, 1.0)
ORANGE: Colour = (0.90, 0.60, 0.0, 1.0)
BLACK: Colour = (0.0, 0.0, 0.0, 1.0)
# From no gap to the largest one, dark to bright, also for those who see no red or green.
_SCALE = np.array([[0.00, 0.14, 0.40], [0.49, 0.48, 0.47], [0.99, 0.91, 0.14]])


@dataclass(frozen=True, eq=False)
class Scene:
    """A tripod's motion in space, at F instants.

    Attributes:
        stamp: Stamps (F,), ns.
        rail: Directions of the rails from the vertical axis (3, 2).
        radius: Rail circle less platform circle, m.
        carriage: Measured heights of the carriages (F, 3), m.
        platform: Where they hold the platform (F, 3), m.
        simulated: Where the simulated machine has it (F, 3), m; None where not simulated.
        gap: Residual effort, root of the mean square over the drives (F,); NaN where unknown.
        unit: Its unit.
    """

    stamp: IntArray
    rail: FloatArray
    radius: float
    carriage: FloatArray
    platform: FloatArray
    simulated: FloatArray | None
    gap: FloatArray
    unit: str

    @property
    def magnification(self) -> float:
        """Power of ten by which the simulated platform's deviation is drawn larger."""
        if self.simulated is None:
            return 1.0
        largest = float(np.linalg.norm(self.simulated - self.platform, axis=1).max())
        if largest <= 0.0:
            return 1.0
        return max(1.0, 10.0 ** math.floor(math.log10(SHOWN * self.radius / largest)))


def scene_of(problem: Problem, theta: Array, residual: Stream, segment: int = 0) -> Scene | None:
    """Return the motion of a tripod in space.

    Args:
        problem: The problem, from data that hold their recordings.
        theta: (N,) parameters, physical units.
        residual: The segment's residual effort, from `overlay_streams`.
        segment: Its number, from 0.

    Returns:
        The scene; None where the machine is no tripod or no positions were measured.
    """
    machine = problem.machine
    dataset = problem.data.datasets[segment]
    if machine.kind != 'tripod' or dataset.position is None:
        return None
    cycle = np.arange(0, dataset.cycles, max(1, round(1.0 / (RATE * dataset.cycle))))
    order = [dataset.names.index(name) for name in machine.drives]
    carriage = np.stack([_filled(dataset.position[d])[cycle] for d in order], axis=1)
    azimuth = np.asarray(machine.geometry['rail_azimuth'], dtype=float)
    some = dict.fromkeys(machine.bounds, 1.0)
    rods = tripod_plant(machine, some).drive
    try:
        platform = np.array([platform_at(row, rods) for row in carriage])
    except IdentError:
        # positions that no rod reaches, as with a wrong zero: there is no pose to draw
        return None
    stamp = dataset.start + np.round(cycle * dataset.cycle * 1e9).astype(np.int64)
    assert residual.effort is not None
    gap = np.sqrt(np.nanmean(residual.effort**2, axis=1))
    known = np.isfinite(gap)
    return Scene(
        stamp,
        np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1),
        float(machine.geometry['rail_radius']),
        carriage,
        platform,
        _simulated(problem, theta, segment, cycle),
        np.interp(stamp, residual.stamp[known], gap[known], np.nan, np.nan),
        machine.effort_unit,
    )


def _filled(row: FloatArray) -> FloatArray:
    there = np.flatnonzero(np.isfinite(row))
    return np.interp(np.arange(row.size), there, row[there])


def _simulated(problem: Problem, theta: Array, segment: int, cycle: IntArray) -> FloatArray | None:
    """Return the platform (F, 3) of the reference with these parameters, where it has them all."""
    dataset = problem.data.datasets[segment]
    if dataset.command_position is None or dataset.command_velocity is None:
        return None
    order = [dataset.names.index(name) for name in problem.machine.drives]
    model = problem.models[segment]
    own = problem.own(segment, theta)[0].tolist()
    values = dict(zip((p.name for p in model.parameters), own, strict=True))
    try:
        log = simulate_tripod(
            problem.machine,
            values | problem.fixed,
            dataset.command_position[order],
            dataset.command_velocity[order],
        )
    except IdentError:
        # a drive that only follows has no parameters; an effect is not the reference's
        return None
    platform: FloatArray = log.platform[:, cycle].T
    return platform


def scene_messages(scene: Scene) -> list[tuple[int, bytes]]:
    """Return the scene as serialised MarkerArray messages with their stamps, ns.

    The first message holds everything; later ones what moves, and from time to time all of it.
    """
    messages = []
    for k, stamp in enumerate(scene.stamp.tolist()):
        still = _still(scene, stamp) if k % REPEAT == 0 else []
        messages.append((stamp, _serialised([*still, *_moving(scene, k, stamp)])))
    return messages


def largest_gap(scene: Scene) -> bytes:
    """Return one serialised MarkerArray: all of the scene at the instant of the largest gap."""
    known = np.isfinite(scene.gap)
    k = int(np.argmax(np.where(known, scene.gap, -1.0)))
    stamp = int(scene.stamp[k])
    return _serialised([*_still(scene, stamp), *_moving(scene, k, stamp)])


def _serialised(markers: list[Msg]) -> bytes:
    return bytes(_STORE.serialize_cdr(_STORE.types[MARKERS](markers=markers), MARKERS))


def joints(scene: Scene, platform: FloatArray) -> FloatArray:
    """Return where the rods meet a platform (3,): (3, 3), m.

    Only the difference of the two circles matters to the motion; the platform's is drawn as a
    quarter of it, and the rails stand out by as much.
    """
    return platform + np.column_stack([0.25 * scene.radius * scene.rail, np.zeros(3)])


def feet(scene: Scene, carriage: FloatArray) -> FloatArray:
    """Return where the rods meet carriages at heights (3,): (3, 3), m."""
    return np.column_stack([1.25 * scene.radius * scene.rail, carriage])


def colours(scene: Scene) -> FloatArray:
    """Return a colour (F, 4) for the gap at each instant; transparent where it is unknown."""
    known = np.isfinite(scene.gap)
    top = float(np.percentile(scene.gap[known], TOP)) if known.any() else 1.0
    share = np.clip(np.where(known, scene.gap, 0.0) / max(top, 1e-300), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(_SCALE))
    rgb = np.stack([np.interp(share, steps, _SCALE[:, c]) for c in range(3)], axis=1)
    return np.column_stack([rgb, known])


def _still(scene: Scene, stamp: int) -> list[Msg]:
    low = float(scene.carriage.min()) - 0.5 * scene.radius
    high = float(scene.carriage.max()) + 0.25 * scene.radius
    rails = np.concatenate([feet(scene, np.full(3, z))[:, None] for z in (low, high)], axis=1)
    known = scene.gap[np.isfinite(scene.gap)]
    largest = float(np.percentile(known, TOP)) if known.size else math.nan
    words = [f'path: residual effort 0 (dark) to {largest:.2g} {scene.unit} and more (yellow)']
    if scene.simulated is not None:
        words.append(
            f'blue: measured, orange: simulated, its deviation times {scene.magnification:g}'
        )
    above = np.array([0.0, 0.0, high + 0.2 * scene.radius])
    return [
        _marker('frame', 0, stamp, _LINES, 0.02, GREY, rails.reshape(-1, 3)),
        _marker('frame', 1, stamp, _TEXT, 0.08, BLACK, above[None], text='\n'.join(words)),
        _marker('gap', 0, stamp, _STRIP, 0.006, BLACK, scene.platform, colours(scene)),
    ]


def _moving(scene: Scene, k: int, stamp: int) -> list[Msg]:
    top = feet(scene, scene.carriage[k])
    markers = [_marker('measured', 0, stamp, _CUBES, 0.05, BLUE, top)]
    markers += _platform(scene, 'measured', stamp, BLUE, top, scene.platform[k])
    if scene.simulated is not None:
        off = scene.magnification * (scene.simulated[k] - scene.platform[k])
        markers += _platform(scene, 'simulated', stamp, ORANGE, None, scene.platform[k] + off)
    return markers


def _platform(
    scene: Scene,
    name: str,
    stamp: int,
    colour: Colour,
    top: FloatArray | None,
    platform: FloatArray,
) -> list[Msg]:
    """Return a platform as a triangle with its middle, and its rods where they are known."""
    corner = joints(scene, platform)
    sides = np.stack([corner, np.roll(corner, -1, axis=0)], axis=1)
    spokes = np.stack([corner, np.broadcast_to(platform, (3, 3))], axis=1)
    lines = np.concatenate([sides, spokes]).reshape(-1, 3)
    markers = [_marker(name, 1, stamp, _LINES, 0.01, colour, lines)]
    if top is not None:
        rods = np.stack([top, corner], axis=1).reshape(-1, 3)
        markers.append(_marker(name, 2, stamp, _LINES, 0.008, colour, rods))
    return markers


def _marker(
    name: str,
    number: int,
    stamp: int,
    kind: int,
    size: float,
    colour: Colour,
    points: FloatArray,
    each: FloatArray | None = None,
    text: str = '',
) -> Msg:
    """Return a visualization_msgs/Marker with points (P, 3), m, in the tripod's frame."""
    types = _STORE.types
    time, header = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']
    point, rgba = types['geometry_msgs/msg/Point'], types['std_msgs/msg/ColorRGBA']
    here = point(*points[0].tolist()) if kind == _TEXT else point(0.0, 0.0, 0.0)
    return types['visualization_msgs/msg/Marker'](
        header=header(time(stamp // 10**9, stamp % 10**9), FRAME),
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
