# SPDX-License-Identifier: Apache-2.0
"""One run, as the worker's thread does it: from what a goal asks for to values, files and series.

Knows nothing of rclpy, so that it can be read and tested without.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import hashlib
import math
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import yaml

from ros2_ident import jobs
from ros2_ident.effects import CATALOGUE
from ros2_ident.files import write_text
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.jobs import Diagnosed, Identified, Logs, Request
from ros2_ident.machine.keys import DESCRIPTION_TOPIC
from ros2_ident.models import EffectAt, make_model, Parameter
from ros2_ident.recording import cdr, RecordingBuilder, Stream
from ros2_ident.report.overlay import (
    OVERLAY,
    overlay_streams,
    Preview,
    Series,
    verdict_of,
    write_overlay,
)
from ros2_ident.report.scene import largest_gap, scene_of
from ros2_ident.ros.paths import checkpoint_of, new_folder
from ros2_ident.search.evaluators import Cancel

CONFIGURATION = 'configuration.yaml'
ROBOT, MACHINE = 'robot.urdf', 'machine.yaml'

Done = TypeVar('Done', Identified, Diagnosed)


@dataclass(frozen=True)
class Wanted:
    """What a goal asks for; complete, so that a change of parameters has no effect on its run.

    Attributes:
        request: The run.
        machine_text: Content of the machine file.
        output_directory: Where to make the run's folder; empty to write nothing.
        description: What was heard of the robot in the place of a file; None where it has one.
        preview_rate: Most previews of an identification per second, Hz; 0 for none.
    """

    request: Request
    machine_text: str = ''
    output_directory: str = ''
    description: str | None = None
    preview_rate: float = 1.0

    @property
    def configuration(self) -> str:
        """Machine file and settings in force, as YAML."""
        settings = self.request.settings
        machine = yaml.safe_load(self.machine_text) if self.machine_text else {}
        asked = {
            **self.request.plain(),
            'genetic': dict(vars(settings.genetic)),
            'refine': settings.refine,
            'budget': dict(vars(settings.budget)),
        }
        return yaml.safe_dump({'machine': machine, 'settings': asked}, sort_keys=False)


@dataclass(frozen=True, eq=False)
class Finished(Generic[Done]):
    """What a run leaves behind.

    Attributes:
        wanted: What was asked for.
        done: What came of it.
        cancelled: Whether a cancel cut a diagnosis short.
        declared: Of a diagnosis the parameters of the nominal model and of every effect in the
            ranking, by name.
    """

    wanted: Wanted
    done: Done
    cancelled: bool = False
    declared: Mapping[str, Parameter] = field(default_factory=dict)

    @property
    def configuration_sha256(self) -> str:
        """Hash of the configuration."""
        return hashlib.sha256(self.wanted.configuration.encode()).hexdigest()


def identify(
    wanted: Wanted,
    received: RecordingBuilder | None,
    cancel: Cancel | None = None,
    on_progress: Callable[[IdentifyProgress], None] = lambda progress: None,
    on_preview: Callable[[Series, Series], None] | None = None,
) -> Finished[Identified]:
    """Identify.

    Args:
        wanted: What to do.
        received: What the node has received; needed where the request names no bag.
        cancel: The best so far is kept.
        on_progress: Called from this thread.
        on_preview: Gets simulated and residual effort of better and better candidates, from this
            thread; see `Preview`.

    Returns:
        The result, also where the run was cancelled.

    Raises:
        IdentError: With the remedy.
    """
    request, rate = wanted.request, wanted.preview_rate
    logs = jobs.read(request, received)
    preview = None
    if on_preview is not None and rate:
        preview = Preview(request.problem(logs.fit), on_preview, 1.0 / rate)

    def report(progress: IdentifyProgress) -> None:
        on_progress(progress)
        if preview is not None:
            preview(progress)

    place = _place(wanted, logs, 'identify')
    done = jobs.identify(request, logs, cancel=cancel, on_progress=report, checkpoint=place)
    return Finished(wanted, done)


def diagnose(
    wanted: Wanted,
    received: RecordingBuilder | None,
    cancel: Cancel,
    on_progress: Callable[[DiagnoseProgress], None],
    on_preview: object = None,
) -> Finished[Diagnosed]:
    """Diagnose; arguments, result and errors as of `identify`, but that nothing is previewed."""
    on_progress(DiagnoseProgress('reading the recordings', 0.0, '', 0.0, math.nan))
    request = wanted.request
    logs = jobs.read(request, received)
    place = _place(wanted, logs, 'diagnose')
    done = jobs.diagnose(request, logs, cancel=cancel, on_progress=on_progress, checkpoint=place)
    cancelled = cancel.is_set() and not done.complete
    return Finished(wanted, done, cancelled, _declared(done))


def _place(wanted: Wanted, logs: Logs, what: str) -> Path | None:
    request = wanted.request
    check = logs.check.sha256 if logs.check else ''
    asked = request.machine.digest, wanted.configuration, repr(request.settings)
    return checkpoint_of(wanted.output_directory, what, *asked, logs.sha256, check)


def _declared(done: Diagnosed) -> dict[str, Parameter]:
    """Return the units and bounds the fits worked with; an effort's depend on the drive."""
    found, request = done.result, done.request
    effects: list[EffectAt] = [ranked.at for ranked in found.ranking]
    if found.where and found.effect in CATALOGUE:
        effects += [EffectAt(found.effect, found.where[0]), *found.also]
    model = make_model(
        request.machine,
        done.logs.fit.datasets[0],
        drives=request.drives,
        effects=list(dict.fromkeys(effects)),
        quantities=tuple(request.outputs) if request.outputs else None,
    )
    return {parameter.name: parameter for parameter in model.parameters}


# ---------------------------------------------------------------------- files and series


def save(finished: Finished[Any], directory: str | None = None) -> str:
    """Write a result and the configuration it was found with, in a new folder.

    Args:
        finished: The run.
        directory: Where to make its folder; that of the goal where None.

    Returns:
        Path of the result file; empty where the directory is.

    Raises:
        IdentError: INVALID_GOAL where nothing can be written there.
    """
    wanted = finished.wanted
    base = wanted.output_directory if directory is None else directory
    if not base:
        return ''
    folder = new_folder(base)
    # The overlay takes longer than the answer may.
    path = jobs.save(finished.done, folder, overlay=False)[0]
    write_text(folder / CONFIGURATION, wanted.configuration)
    if wanted.description is not None:  # a robot that was heard, so that `ident` can read it
        write_text(folder / ROBOT, wanted.description)
        write_text(folder / MACHINE, wanted.machine_text.replace(DESCRIPTION_TOPIC, ROBOT))
    return str(path)


def attempted(save: Callable[[], str]) -> tuple[str, Exception | None]:
    """Return the path of what was saved, or why it was not: a result is not lost with its file."""
    try:
        return save(), None
    except Exception as error:
        return '', error


def messages(streams: Series) -> list[bytes]:
    """Return streams as serialised JointState messages, one after the other."""

    def encoded(stream: Stream) -> list[bytes]:
        fields = [stream.position, stream.velocity, stream.effort]
        return cdr.encode(stream.stamp, stream.names, fields)

    return [message for stream in streams for message in encoded(stream)]


def compare(
    finished: Finished[Identified], result_file: str
) -> tuple[list[bytes], list[bytes], bytes | None]:
    """Set the simulated effort beside the measured one, and write both as a bag beside the result.

    Args:
        finished: The run.
        result_file: Its result file; empty to write nothing.

    Returns:
        Simulated and residual effort (measured less simulated) at the measured stamps, in the
        log's unit, as JointState messages; and a MarkerArray of the first segment, None where the
        machine has no scene. Nothing where no candidate converged.
    """
    done = finished.done
    theta = done.result.theta
    if not np.isfinite(theta).all():
        return [], [], None
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
    return (
        messages([x['simulated'] for x in streams]),
        messages([x['residual'] for x in streams]),
        None if scene is None else largest_gap(scene),
    )
