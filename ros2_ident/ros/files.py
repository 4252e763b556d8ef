# SPDX-License-Identifier: Apache-2.0
"""The files of a run, in a folder of its own inside the output directory."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident import jobs
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_text
from ros2_ident.jobs import Identified
from ros2_ident.machine.keys import DESCRIPTION_TOPIC
from ros2_ident.recording import Stream
from ros2_ident.report.overlay import OVERLAY, overlay_streams, verdict_of, write_overlay
from ros2_ident.report.scene import largest_gap, scene_of
from ros2_ident.ros.paths import expanded
from ros2_ident.ros.run import Finished, Wanted

CONFIGURATION = 'configuration.yaml'
ROBOT, MACHINE = 'robot.urdf', 'machine.yaml'


def save(finished: Finished[Any], directory: str | None = None) -> str:
    """Write a result and the configuration it was found with.

    Args:
        finished: The run.
        directory: Where to make its folder; that of the goal where None.

    Returns:
        Path of the result file; empty where the directory is.

    Raises:
        IdentError: INVALID_GOAL where nothing can be written there.
    """
    base = finished.wanted.output_directory if directory is None else directory
    if not base:
        return ''
    folder = _folder(base)
    # The overlay takes longer than the answer may.
    path = jobs.save(finished.done, folder, overlay=False)[0]
    _write_configuration(folder, finished.wanted)
    return str(path)


def attempted(save: Callable[[], str]) -> tuple[str, Exception | None]:
    """Return the path of what was saved, or why it was not: a result is not lost with its file."""
    try:
        return save(), None
    except Exception as error:
        return '', error


@dataclass(frozen=True)
class Compared:
    """The simulated machine beside the measured one.

    Attributes:
        simulated: Simulated effort of each segment, at the measured stamps, in the log's unit.
        residual: Measured less simulated effort, likewise.
        scene: A serialised MarkerArray of the first segment; None where it is no tripod's.
    """

    simulated: list[Stream]
    residual: list[Stream]
    scene: bytes | None = None


def compare(finished: Finished[Identified], result_file: str) -> Compared:
    """Set the simulated effort beside the measured one, and write both as a bag beside the result.

    Args:
        finished: The run.
        result_file: Its result file; empty to write nothing.

    Returns:
        The comparison; nothing in it where no candidate converged.
    """
    done = finished.done
    theta = done.result.theta
    if not np.isfinite(theta).all():
        return Compared([], [])
    problem = done.problem()
    if result_file:
        write_overlay(
            Path(result_file).with_name(OVERLAY),
            problem,
            theta,
            topics=done.request.topics,
            verdict=verdict_of(done.result),
        )
    streams = overlay_streams(problem, theta)
    scene = scene_of(problem, theta, streams[0]['residual'])
    return Compared(
        [x['simulated'] for x in streams],
        [x['residual'] for x in streams],
        None if scene is None else largest_gap(scene),
    )


def _write_configuration(folder: Path, wanted: Wanted) -> None:
    """Write what a run was asked, and a robot that was heard so that `ident` can read it."""
    write_text(folder / CONFIGURATION, wanted.configuration)
    if wanted.description is not None:
        write_text(folder / ROBOT, wanted.description)
        write_text(folder / MACHINE, wanted.machine_text.replace(DESCRIPTION_TOPIC, ROBOT))


def _folder(directory: str) -> Path:
    """Make a folder named by the time; never one that is there already."""
    base = expanded(directory)
    stamp = f'{datetime.now().astimezone():%Y%m%d_%H%M%S}'
    for number in range(1, 1000):
        path = base / (stamp if number == 1 else f'{stamp}_{number}')
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as exc:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'output_directory {base} cannot be written ({exc.strerror}); give another one, '
                'or an empty string to write nothing',
            ) from None
        return path
    raise IdentError(ErrorCode.INVALID_GOAL, f'{base} is full of runs of {stamp}; clear it')
