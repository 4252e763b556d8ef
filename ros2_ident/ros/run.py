# SPDX-License-Identifier: Apache-2.0
"""One run, as the worker's thread does it: from what a goal asks for to values.

Knows nothing of rclpy, so that it can be read and tested without.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import hashlib
import math
from pathlib import Path
from typing import Generic, TypeVar

import yaml

from ros2_ident import jobs
from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.identify.settings import IdentifyProgress, OnProgress
from ros2_ident.jobs import Diagnosed, Identified, Logs, Request
from ros2_ident.models import EffectAt, make_model, Parameter
from ros2_ident.recording import RecordingBuilder
from ros2_ident.report.preview import Preview, Series
from ros2_ident.ros.unfinished import place_of
from ros2_ident.search.evaluators import Cancel

Done = TypeVar('Done', Identified, Diagnosed)


@dataclass(frozen=True)
class Wanted:
    """What a goal asks for; complete, so that a change of parameters has no effect on its run.

    Attributes:
        request: The run.
        machine_text: Content of the machine file.
        output_directory: Where to make the run's folder; empty to write nothing.
        description: What was heard of the robot in the place of a file; None where it has one.
    """

    request: Request
    machine_text: str = ''
    output_directory: str = ''
    description: str | None = None

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
        cancelled: Whether a cancel cut it short.
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
    on_progress: OnProgress | None = None,
    on_preview: Callable[[Series, Series], None] | None = None,
    preview_period: float = 1.0,
) -> Finished[Identified]:
    """Identify.

    Args:
        wanted: What to do.
        received: What the node has received; needed where the request names no bag.
        cancel: The best so far is kept.
        on_progress: Called from this thread.
        on_preview: Gets simulated and residual effort of better and better candidates, from this
            thread; see `Preview`.
        preview_period: Least time between previews, s.

    Returns:
        The result, also where the run was cancelled.

    Raises:
        IdentError: With the remedy.
    """
    request = wanted.request
    logs = jobs.read(request, received)
    preview = on_preview and Preview(request.problem(logs.fit), on_preview, preview_period)

    def report(progress: IdentifyProgress) -> None:
        if on_progress is not None:
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
) -> Finished[Diagnosed]:
    """Diagnose; arguments, result and errors as of `identify`."""
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
    return place_of(wanted.output_directory, what, *asked, logs.sha256, check)


def _declared(done: Diagnosed) -> dict[str, Parameter]:
    """Return the units and bounds the fits worked with; an effort's depend on the drive."""
    found, request = done.result, done.request
    effects: list[EffectAt] = [ranked.at for ranked in found.ranking]
    if found.where and found.effect in CATALOGUE:
        effects += [EffectAt(found.effect, found.where[0]), *found.also]
    effects = list(dict.fromkeys(effects))
    model = make_model(
        request.machine,
        done.logs.fit.datasets[0],
        drives=request.drives,
        effects=effects,
        quantities=tuple(request.outputs) if request.outputs else None,
    )
    return {parameter.name: parameter for parameter in model.parameters}
