# SPDX-License-Identifier: Apache-2.0
"""One run of an identification, as the worker's thread does it: from a request to values.

Knows nothing of rclpy, so that it can be read and tested without.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import hashlib
from pathlib import Path
import time
from typing import Any, Protocol

import numpy as np
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import Data, gather
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.outputs import checked, Outputs
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import Identification
from ros2_ident.identify.run import identify
from ros2_ident.identify.settings import IdentifyProgress, IdentifySettings, OnProgress
from ros2_ident.identify.setup import problem_of
from ros2_ident.models import Machine
from ros2_ident.models.registry import compared_of
from ros2_ident.recording import read_bags, Recording, RecordingBuilder, Topics
from ros2_ident.report.preview import Preview, Series
from ros2_ident.ros.unfinished import place_of


class Cancel(Protocol):
    """What a `threading.Event` has."""

    def is_set(self) -> bool:
        """Return whether the run shall end."""
        ...


@dataclass(frozen=True)
class Request:
    """What a run is to do; complete, so that a change of parameters during it has no effect.

    Attributes:
        machine: The machine.
        machine_text: Content of its file.
        drives: Drives to identify, in the machine's order.
        bag_paths: Bags to read; none for what the node has received.
        conditions: What differs between the bags.
        outputs: What is compared; the effort where None.
        topics: Names of the topics in the bag.
        fixed: Parameters held at a value.
        bounds: Bounds other than the machine file's.
        settings: How to search.
        seed: Of the random generator.
        output_directory: Where to make the run's folder; empty to write nothing.
        description: What was heard of the robot in the place of a file; None where it has one.
    """

    machine: Machine
    machine_text: str
    drives: tuple[str, ...]
    bag_paths: tuple[str, ...] = ()
    conditions: Conditions = Conditions()
    outputs: Outputs | None = None
    topics: Topics = field(default_factory=Topics)
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    seed: int = 1
    output_directory: str = ''
    description: str | None = None

    def problem(self, data: Data) -> Problem:
        """Return the model on some data."""
        return problem_of(
            self.machine,
            data,
            drives=self.drives,
            fixed=self.fixed,
            bounds=self.bounds,
            cutoff=self.settings.cutoff,
            conditions=self.conditions,
            outputs=self.outputs,
        )

    @property
    def configuration(self) -> str:
        """Machine file and settings in force, as YAML."""
        genetic = self.settings.genetic
        budget = self.settings.budget
        settings: dict[str, Any] = {
            'drives': list(self.drives),
            'fixed': dict(self.fixed),
            'bounds': {name: list(pair) for name, pair in self.bounds.items()},
            'genetic': dict(vars(genetic)),
            'refine': self.settings.refine,
            'budget': dict(vars(budget)),
            'seed': self.seed,
            **self.conditions.plain(),
            **({'outputs': dict(self.outputs)} if self.outputs else {}),
        }
        machine = yaml.safe_load(self.machine_text) if self.machine_text else {}
        return yaml.safe_dump({'machine': machine, 'settings': settings}, sort_keys=False)


@dataclass(frozen=True, eq=False)
class Finished:
    """What a run leaves behind.

    Attributes:
        request: What was asked for.
        identification: The result.
        data: What it was identified from.
        configuration_sha256: Hash of the request's configuration.
        data_sha256: Hash of the bag, or of the buffered samples.
        seconds: From the request to the result, s.
        checkpoint: What the run could be gone on with; of no use once the result is safe.
    """

    request: Request
    identification: Identification
    data: Data
    configuration_sha256: str
    data_sha256: str
    seconds: float
    checkpoint: Path | None = None

    def problem(self) -> Problem:
        """Return the model on the data it was identified from."""
        return self.request.problem(self.data)


def run(
    request: Request,
    buffer: RecordingBuilder | None,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
    on_preview: Callable[[Series, Series], None] | None = None,
    preview_period: float = 1.0,
) -> Finished:
    """Do a run.

    Args:
        request: What to do.
        buffer: What the node has received; needed where the request names no bag.
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
    start = time.monotonic()
    recordings = recordings_of(request.bag_paths, request.topics, buffer)
    compared = tuple(checked(request.outputs, compared_of(request.machine)))
    data = gather(recordings, request.machine, request.drives, quantities=compared)
    data_sha256 = data.sha256 or digest_of(recordings)
    asked = request.machine.digest, request.configuration, repr(request.settings)
    checkpoint = place_of(request.output_directory, *asked, data_sha256)
    preview = on_preview and Preview(request.problem(data), on_preview, preview_period)

    def report(progress: IdentifyProgress) -> None:
        if on_progress is not None:
            on_progress(progress)
        if preview is not None:
            preview(progress)

    identification = identify(
        request.machine,
        data,
        drives=request.drives,
        fixed=request.fixed,
        bounds=request.bounds,
        conditions=request.conditions,
        outputs=request.outputs,
        settings=request.settings,
        seed=request.seed,
        cancel=cancel,
        on_progress=report,
        checkpoint=checkpoint,
    )
    return Finished(
        request=request,
        identification=identification,
        data=data,
        configuration_sha256=hashlib.sha256(request.configuration.encode()).hexdigest(),
        data_sha256=data_sha256,
        seconds=time.monotonic() - start,
        checkpoint=checkpoint,
    )


def recordings_of(
    bag_paths: Sequence[str], topics: Topics, buffer: RecordingBuilder | None
) -> list[Recording]:
    """Return the recordings of bags, or what the node has received where no bag is named."""
    if bag_paths:
        return read_bags(bag_paths, topics)
    if buffer is None:
        raise IdentError(ErrorCode.NO_DATA, 'there is no live data; replay a bag or name its path')
    return buffer.build()


def digest_of(recordings: Sequence[Recording]) -> str:
    """Return a hash of the samples: the same live data can be told to be the same."""
    total = hashlib.sha256()
    for recording in recordings:
        for role, stream in recording.streams.items():
            total.update(f'{role} {" ".join(stream.names)}'.encode())
            for values in (stream.stamp, stream.position, stream.velocity, stream.effort):
                if values is not None:
                    total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
