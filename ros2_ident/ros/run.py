# SPDX-License-Identifier: Apache-2.0
"""One run of an identification, as the worker's thread does it: from a request to values.

Knows nothing of rclpy, so that it can be read and tested without.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import hashlib
import time
from typing import Any, Protocol

import numpy as np
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify import identify
from ros2_ident.models import Machine
from ros2_ident.problem import Problem
from ros2_ident.recording import read_bag, Recording, RecordingBuilder, Topics
from ros2_ident.result import Identification
from ros2_ident.segments import Data, gather
from ros2_ident.settings import IdentifySettings, OnProgress


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
        bag_path: Bag to read; empty for what the node has received.
        topics: Names of the topics in the bag.
        fixed: Parameters held at a value.
        bounds: Bounds other than the machine file's.
        settings: How to search.
        seed: Of the random generator.
        output_directory: Where to make the run's folder; empty to write nothing.
    """

    machine: Machine
    machine_text: str
    drives: tuple[str, ...]
    bag_path: str = ''
    topics: Topics = field(default_factory=Topics)
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    seed: int = 1
    output_directory: str = ''

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
    """

    request: Request
    identification: Identification
    data: Data
    configuration_sha256: str
    data_sha256: str
    seconds: float

    def problem(self) -> Problem:
        """Return the model on the data it was identified from."""
        request = self.request
        return Problem(
            request.machine,
            self.data,
            drives=request.drives,
            fixed=request.fixed,
            bounds=request.bounds,
            cutoff=request.settings.cutoff,
        )


def run(
    request: Request,
    buffer: RecordingBuilder | None,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
) -> Finished:
    """Do a run.

    Args:
        request: What to do.
        buffer: What the node has received; needed where the request names no bag.
        cancel: The best so far is kept.
        on_progress: Called from this thread.

    Returns:
        The result, also where the run was cancelled.

    Raises:
        IdentError: With the remedy.
    """
    start = time.monotonic()
    recordings = recordings_of(request.bag_path, request.topics, buffer)
    data = gather(recordings, request.machine, request.drives)
    identification = identify(
        request.machine,
        data,
        drives=request.drives,
        fixed=request.fixed,
        bounds=request.bounds,
        settings=request.settings,
        seed=request.seed,
        cancel=cancel,
        on_progress=on_progress,
    )
    return Finished(
        request=request,
        identification=identification,
        data=data,
        configuration_sha256=hashlib.sha256(request.configuration.encode()).hexdigest(),
        data_sha256=data.sha256 or _digest(recordings),
        seconds=time.monotonic() - start,
    )


def recordings_of(
    bag_path: str, topics: Topics, buffer: RecordingBuilder | None
) -> list[Recording]:
    """Return the recordings of a bag, or what the node has received where no bag is named."""
    if bag_path:
        return read_bag(bag_path, topics)
    if buffer is None:
        raise IdentError(ErrorCode.NO_DATA, 'there is no live data; replay a bag or name its path')
    return buffer.build()


def _digest(recordings: Sequence[Recording]) -> str:
    """Return a hash of the samples: the same live data can be told to be the same."""
    total = hashlib.sha256()
    for recording in recordings:
        for role, stream in recording.streams.items():
            total.update(f'{role} {" ".join(stream.names)}'.encode())
            for values in (stream.stamp, stream.position, stream.velocity, stream.effort):
                if values is not None:
                    total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
