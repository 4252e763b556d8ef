# SPDX-License-Identifier: Apache-2.0
"""A motion in files: a bag of set-points with a trajectory for a controller, its worth."""

from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.excite.plan import Excitation
from ros2_ident.files import make_directory, require_ours, write_json
from ros2_ident.recording import Stream, write_bag
from ros2_ident.recording.definition import standard
from ros2_ident.recording.write import require_room, Topic

BAG, WORTH = 'set_points', 'excite.json'
MARK = 'excitation'
TOPIC = '/joint_trajectory_controller/joint_trajectory'
_KIND = 'trajectory_msgs/msg/JointTrajectory'
# Points of a trajectory in the period of the highest frequency: a quintic between two of them is
# off by some hundred thousandths of its amplitude.
_POINTS = 6.0
# Stamp of the first set-point, ns.
_START = 1_700_000_000_000_000_000


def write_excitation(
    directory: str | Path, found: Excitation, lead: float, asked: str = ''
) -> list[Path]:
    """Write a motion; return the files.

    Args:
        directory: Where to; it is made.
        lead: Time that the controller of a trajectory has to reach its first point, s.
        asked: The command, for the bag's metadata.

    Raises:
        IdentError: INVALID_GOAL where something is in the way.
    """
    require_place(directory)
    folder = make_directory(directory)
    position, velocity = found.planned.position.T, found.planned.velocity.T
    cycle = found.courses.series.cycle
    stamp = _START + np.round(1e9 * cycle * np.arange(len(position))).astype(np.int64)
    stream = Stream(found.courses.machine.drives, stamp, position=position, velocity=velocity)
    bag = write_bag(
        folder / BAG,
        {'/joint_command': stream},
        mark=MARK,
        custom={'command': asked},
        others=[Topic(TOPIC, _KIND, [_START], [_trajectory(found, lead)])],
    )
    return [bag, write_json(folder / WORTH, worth(found))]


def require_place(directory: str | Path) -> None:
    """Refuse, before any work is done, a directory that holds what is not ours to replace.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    folder = Path(directory)
    require_room(folder / BAG, MARK)
    require_ours([folder / WORTH])


def _trajectory(found: Excitation, lead: float) -> bytes:
    store, series = standard(), found.courses.series
    types = store.types
    highest = float(series.harmonics.max()) / series.period
    every = max(1, int(1.0 / (_POINTS * highest * series.cycle)))
    last = found.planned.position.shape[1] - 1
    points = []
    for k in sorted({*range(0, last, every), last}):
        seconds, fraction = divmod(round(1e9 * (lead + k * series.cycle)), 1_000_000_000)
        rows = (found.planned.position, found.planned.velocity, found.planned.acceleration)
        points.append(
            types['trajectory_msgs/msg/JointTrajectoryPoint'](
                *(np.round(row[:, k], 9) for row in rows),
                effort=np.empty(0),
                time_from_start=types['builtin_interfaces/msg/Duration'](seconds, fraction),
            )
        )
    stamp = types['builtin_interfaces/msg/Time'](sec=0, nanosec=0)
    header = types['std_msgs/msg/Header'](stamp=stamp, frame_id='')
    names = list(found.courses.machine.drives)
    whole = types[_KIND](header=header, joint_names=names, points=points)
    return bytes(store.serialize_cdr(whole, _KIND))


def worth(found: Excitation) -> dict[str, Any]:
    """Return what a motion is worth, for a file."""
    rows = zip(
        found.parameters, found.values, found.half_widths, found.chance, found.wanted, strict=True
    )
    return {
        'schema': 'ros2_ident.excitation',
        'version': 1,
        'seconds': (found.planned.position.shape[1] - 1) * found.courses.series.cycle,
        'parameters': {
            p.name: {
                'unit': p.unit,
                'expected': value,
                'half_width': half,
                'half_width_of_a_random_motion': chance,
                'wanted': wanted,
            }
            for p, value, half, chance, wanted in rows
        },
        'largest_share_of_a_limit': {n: round(x, 6) for n, x in found.loads.items()},
        'evaluations': found.evaluations,
        'stop': found.stop,
    }
