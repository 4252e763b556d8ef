# SPDX-License-Identifier: Apache-2.0
"""One run, as the worker's thread does it: from what a goal asks for to values, files and series.

Knows nothing of rclpy, so that it can be read and tested without.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from functools import partial
import hashlib
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from ros2_ident import jobs
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import Growing, remove_file, unreadable, write_text
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.identify.problem import sources
from ros2_ident.jobs import Compared, Diagnosed, Identified, Request
from ros2_ident.machine.keys import DESCRIPTION_TOPIC
from ros2_ident.recording import cdr, RecordingBuilder
from ros2_ident.report.overlay import OVERLAY, overlay_streams, preview, Series, write_overlay
from ros2_ident.report.scene import largest_gap, scene_of
from ros2_ident.search.evaluators import Cancel
from ros2_ident.search.journal import MAGIC

UNFINISHED, SUFFIX = 'unfinished', '.checkpoint'
# Goals that were never sent again: the oldest files go.
MOST = 8
CONFIGURATION = 'configuration.yaml'
ROBOT, MACHINE = 'robot.urdf', 'machine.yaml'


@dataclass(frozen=True)
class Wanted(Request):
    """Request of a goal; complete, so that a change of parameters has no effect on its run.

    Attributes:
        output_directory: Where to make the run's folder; empty to write nothing.
        description: What was heard of the robot in the place of a file; None where it has one.
        preview_rate: Most previews of an identification per second, Hz; 0 for none.
        later: Paths of the bags after, of a comparison: none for what was received; else None.
        paired: Whether they belong to those before one by one.
    """

    machine_text: str = ''
    output_directory: str = ''
    description: str | None = None
    preview_rate: float = 1.0
    later: tuple[str, ...] | None = None
    paired: bool = False

    @property
    def live(self) -> bool:
        """Whether what was received is looked at."""
        return not (self.bags if self.later is None else self.later)

    @property
    def configuration(self) -> str:
        """Machine file and settings in force, as YAML."""
        machine = yaml.safe_load(self.machine_text) if self.machine_text else {}
        asked = {
            **self.plain(),
            **({} if self.later is None else {'after_bags': [*self.later], 'pairs': self.paired}),
            'genetic': dict(vars(self.settings.genetic)),
            'refine': self.settings.refine,
            'budget': dict(vars(self.settings.budget)),
        }
        return yaml.safe_dump({'machine': machine, 'settings': asked}, sort_keys=False)


def asked_of(done: Identified | Diagnosed | Compared) -> Wanted:
    """Return what the goal of a run asked for."""
    assert isinstance(done.request, Wanted)
    return done.request


def carry_out(
    what: Literal['identify', 'diagnose', 'diff'],
    wanted: Wanted,
    received: RecordingBuilder | None,
    cancel: Cancel | None = None,
    on_progress: Callable[[Any], None] = lambda progress: None,
    on_preview: Callable[[Series, Series], None] | None = None,
) -> Any:
    """Identify, diagnose or compare.

    Args:
        received: What the node has received; needed where the request is live.
        cancel: The best so far is kept.
        on_progress: Called from this thread.
        on_preview: Gets simulated and residual effort of better and better candidates of an
            identification, from this thread; see `preview`.

    Returns:
        What `jobs` returns, also where the run was cancelled.

    Raises:
        IdentError: With the remedy.
    """
    at = partial(DiagnoseProgress, best_so_far='', elapsed=0.0, eta=math.nan)
    if what == 'diff':
        return jobs.compare(
            wanted, wanted.later or (), paired=wanted.paired, received=received, cancel=cancel,
            on_step=lambda share, text: on_progress(at(text, share)),
        )  # fmt: skip
    identifying = what == 'identify'
    if not identifying:
        on_progress(at('reading the recordings', 0.0))
    logs, rate = jobs.read(wanted, received), wanted.preview_rate
    listeners = [on_progress]
    if identifying and on_preview is not None and rate:
        listeners.append(preview(wanted.problem(logs.fit), on_preview, 1.0 / rate))

    def report(progress: Any) -> None:
        for listener in listeners:
            listener(progress)

    check = logs.check.sha256 if logs.check else ''
    asked = wanted.machine.digest, wanted.configuration, repr(wanted.settings)
    place = checkpoint_of(wanted.output_directory, what, *asked, logs.sha256, check)
    find: Callable[..., Any] = jobs.identify if identifying else jobs.diagnose
    return find(wanted, logs, cancel=cancel, on_progress=report, checkpoint=place)


def _no_path(path: str, reason: object) -> IdentError:
    return ErrorCode.INVALID_GOAL.error(f'{path!r} is no path ({reason}); give one that is')


def expanded(path: str) -> Path:
    """Return a path with `~` replaced by the home directory.

    Raises:
        IdentError: INVALID_GOAL where it can be no path.
    """
    if '\0' in path:
        raise _no_path(path, 'it holds a zero byte')
    try:
        return Path(path).expanduser()
    except RuntimeError as exc:
        raise _no_path(path, exc) from None


def allowed(path: str, directory: str, *, there: bool = True) -> Path:
    """Return a path to read.

    Args:
        path: As the goal has it.
        directory: What it has to lie in, wherever links lead; empty for anywhere.
        there: Whether it has to exist.

    Raises:
        IdentError: NO_DATA where nothing is there, INVALID_GOAL where it is not allowed.
    """
    found = expanded(path)
    try:
        real = found.resolve()
        why = unreadable(real) if there else ''
    except (OSError, RuntimeError) as exc:
        raise _no_path(path[:80], getattr(exc, 'strerror', None) or exc) from None
    if directory and not real.is_relative_to(expanded(directory).resolve()):
        raise ErrorCode.INVALID_GOAL.error(
            f'{path} lies outside of allowed_directory {directory}; move it there or have the '
            'parameter changed'
        )
    if why:
        raise ErrorCode.NO_DATA.error(
            f"{path}: {why} on the node's machine; give the path of a bag there"
        )
    return found


def new_folder(directory: str) -> Path:
    """Make a folder named by the time; never one that is there already.

    Raises:
        IdentError: INVALID_GOAL where nothing can be written there.
    """
    base = expanded(directory)
    stamp = f'{datetime.now().astimezone():%Y%m%d_%H%M%S}'
    for number in range(1, 1000):
        path = base / (stamp if number == 1 else f'{stamp}_{number}')
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as exc:
            raise ErrorCode.INVALID_GOAL.error(
                f'output_directory {base} cannot be written ({exc.strerror}); give another one, '
                'or an empty string to write nothing'
            ) from None
        return path
    raise ErrorCode.INVALID_GOAL.error(f'{base} is full of runs of {stamp}; clear it')


def checkpoint_of(directory: str, *what: str) -> Path | None:
    """Return where a run keeps its checkpoint; None where that is not to be, or cannot be.

    It is named by what the run depends on: a client that sends its goal again after a crash need
    not know of it.

    Args:
        directory: The request's output directory; empty to write nothing.
    """
    if not directory:
        return None
    folder = expanded(directory) / UNFINISHED
    name = hashlib.sha256('\n'.join((sources(), *what)).encode()).hexdigest()[:16]
    path = folder / f'{name}{SUFFIX}'
    try:
        with closing(Growing(path)) as file:
            if not file.size:
                file.write(MAGIC)
        others = [x for x in folder.glob(f'*{SUFFIX}') if x != path]
        for old in sorted(others, key=lambda x: x.stat().st_mtime)[: -(MOST - 1)]:
            remove_file(old)
    except (IdentError, OSError):
        return None  # a full disk, or another node on the same goal, is no reason not to run
    return path


def save(done: Identified | Diagnosed | Compared, directory: str | None = None) -> str:
    """Write a result and the configuration it was found with, in a new folder.

    Args:
        directory: Where to make its folder; that of the goal where None.

    Returns:
        Path of the result file; empty where the directory is.

    Raises:
        IdentError: INVALID_GOAL where nothing can be written there.
    """
    wanted = asked_of(done)
    base = wanted.output_directory if directory is None else directory
    if not base:
        return ''
    folder = new_folder(base)
    # The overlay takes longer than the answer may.
    path = jobs.save(done, folder, overlay=False)[0]
    write_text(folder / CONFIGURATION, wanted.configuration)
    if wanted.description is not None:  # a robot that was heard, so that `ident` can read it
        write_text(folder / ROBOT, wanted.description)
        write_text(folder / MACHINE, wanted.machine_text.replace(DESCRIPTION_TOPIC, ROBOT))
    return str(path)


def messages(streams: Series) -> list[bytes]:
    """Return streams as serialised JointState messages, one after the other."""
    return [
        message
        for x in streams
        for message in cdr.encode(x.stamp, x.names, [x.position, x.velocity, x.effort])
    ]


def compare(done: Identified, result_file: str) -> tuple[list[bytes], list[bytes], bytes | None]:
    """Set the simulated effort beside the measured one, and write both as a bag beside the result.

    Args:
        result_file: Its result file; empty to write nothing.

    Returns:
        Simulated and residual effort (measured less simulated) at the measured stamps, in the
        log's unit, as JointState messages; and a MarkerArray of the first segment, None where the
        machine has no scene. Nothing where no candidate converged.
    """
    theta = done.result.theta
    if not np.isfinite(theta).all():
        return [], [], None
    problem = done.problem()
    if result_file:
        write_overlay(
            Path(result_file).with_name(OVERLAY), problem, theta, topics=done.request.topics
        )
    streams = overlay_streams(problem, theta)
    scene = scene_of(problem, theta, streams[0]['residual'])
    return (
        messages([x['simulated'] for x in streams]),
        messages([x['residual'] for x in streams]),
        None if scene is None else largest_gap(scene),
    )
