# SPDX-License-Identifier: Apache-2.0
"""One diagnosis, as the worker's thread does it: from a request to values.

Knows nothing of rclpy, so that it can be read and tested without.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
import time

import yaml

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose, DiagnoseProgress
from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.identify.data import Data, gather
from ros2_ident.identify.layout import Conditions
from ros2_ident.models import EffectAt, Machine, make_model, Parameter
from ros2_ident.recording import Dataset, RecordingBuilder, Topics
from ros2_ident.ros.run import Cancel, digest_of, recordings_of
from ros2_ident.ros.unfinished import place_of
from ros2_ident.search import Threads


@dataclass(frozen=True)
class DiagnoseRequest:
    """What a diagnosis is to do; complete, so that a change of parameters has no effect on it.

    Attributes:
        machine: The machine.
        machine_text: Content of its file.
        drives: Drives to look at, in the machine's order.
        fit_paths: Bags to fit to; none for what the node has received.
        check_paths: Bags to judge on; none for blocks held out of the others.
        conditions: What differs between the bags.
        topics: Names of the topics in the bags.
        without: Ids of effects to leave out of the catalogue.
        output: Quantity whose gap is diagnosed; what the kind of machine compares where None.
        threads: Threads that simulate; one for each processor where None.
        seconds: Time budget, s; 0 for none.
        seed: Of the random generator.
        output_directory: Where to make the run's folder; empty to write nothing.
        description: What was heard of the robot in the place of a file; None where it has one.
    """

    machine: Machine
    machine_text: str
    drives: tuple[str, ...]
    fit_paths: tuple[str, ...] = ()
    check_paths: tuple[str, ...] = ()
    conditions: Conditions = Conditions()
    topics: Topics = field(default_factory=Topics)
    without: tuple[str, ...] = ()
    output: str | None = None
    threads: int | None = None
    seconds: float = 0.0
    seed: int = 1
    output_directory: str = ''
    description: str | None = None

    @property
    def configuration(self) -> str:
        """Machine file and settings in force, as YAML."""
        settings = {
            'drives': list(self.drives),
            'fit_bags': list(self.fit_paths),
            'check_bags': list(self.check_paths),
            'without_effects': list(self.without),
            **({'output': self.output} if self.output else {}),
            'time_budget': self.seconds,
            'seed': self.seed,
            **self.conditions.plain(),
        }
        machine = yaml.safe_load(self.machine_text) if self.machine_text else {}
        return yaml.safe_dump({'machine': machine, 'settings': settings}, sort_keys=False)


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """What a diagnosis leaves behind.

    Attributes:
        request: What was asked for.
        diagnosis: The result.
        data: What it was fitted to.
        check: What it was judged on; None where that is held out of the same.
        declared: Parameters of the nominal model and of every effect in the ranking, by name.
        cancelled: Whether it was cut short by a cancel.
        seconds: From the request to the result, s.
        checkpoint: What the run could be gone on with; of no use once the result is safe.
    """

    request: DiagnoseRequest
    diagnosis: Diagnosis
    data: Data
    check: Data | None
    declared: Mapping[str, Parameter]
    cancelled: bool
    seconds: float
    checkpoint: Path | None = None


def run_diagnosis(
    request: DiagnoseRequest,
    buffer: RecordingBuilder | None,
    cancel: Cancel,
    on_progress: Callable[[DiagnoseProgress], None],
) -> Diagnosed:
    """Do a diagnosis.

    Args:
        request: What to do.
        buffer: What the node has received; needed where the request names no bag to fit to.
        cancel: The best so far is kept.
        on_progress: Called from this thread.

    Returns:
        The result, also where the run was cancelled.

    Raises:
        IdentError: With the remedy.
    """
    start = time.monotonic()

    def tell(progress: DiagnoseProgress) -> None:
        on_progress(replace(progress, elapsed=time.monotonic() - start))

    tell(DiagnoseProgress('reading the recordings', 0.0, '', 0.0, math.nan))
    machine, drives = request.machine, request.drives
    heard = recordings_of(request.fit_paths, request.topics, buffer)
    compared = None if request.output is None else (request.output,)
    fit = gather(heard, machine, drives, quantities=compared)
    check = None
    if request.check_paths:
        recordings = recordings_of(request.check_paths, request.topics, None)
        check = gather(recordings, machine, drives, quantities=compared)

    digests = fit.sha256 or digest_of(heard), check.sha256 if check else ''
    asked = 'diagnose', machine.digest, request.configuration, *digests
    checkpoint = place_of(request.output_directory, *asked)

    def stop() -> bool:
        spent = 0.0 < request.seconds < time.monotonic() - start
        return cancel.is_set() or spent

    found = diagnose(
        machine,
        fit.datasets,
        check.datasets if check else (),
        labels=fit.labels,
        check_labels=check.labels if check else (),
        conditions=request.conditions,
        drives=drives,
        without=request.without,
        output=request.output,
        seed=request.seed,
        cancelled=stop,
        on_progress=tell,
        workers=Threads(request.threads),
        checkpoint=checkpoint,
    )
    return Diagnosed(
        request=request,
        diagnosis=found,
        data=fit,
        check=check,
        declared=_declared(request, fit.datasets[0], found),
        cancelled=cancel.is_set() and not found.complete,
        seconds=time.monotonic() - start,
        checkpoint=checkpoint,
    )


def _declared(
    request: DiagnoseRequest, dataset: Dataset, found: Diagnosis
) -> dict[str, Parameter]:
    """Return the units and bounds the fits worked with; an effort's depend on the drive."""
    effects: list[EffectAt] = [ranked.at for ranked in found.ranking]
    if found.where and found.effect in CATALOGUE:
        effects += [EffectAt(found.effect, found.where[0]), *found.also]
    effects = list(dict.fromkeys(effects))
    compared = None if request.output is None else (request.output,)
    model = make_model(
        request.machine, dataset, drives=request.drives, effects=effects, quantities=compared
    )
    return {parameter.name: parameter for parameter in model.parameters}
