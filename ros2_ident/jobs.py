# SPDX-License-Identifier: Apache-2.0
"""One run, as all callers have it: a command, a goal of the node, a row of a fleet.

Each of them is a `Request`; `read` its logs, `identify` or `diagnose` them, `save` what was found.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
import hashlib
from pathlib import Path
import time
from typing import Any, Generic, TYPE_CHECKING, TypeVar

import numpy as np

from ros2_ident.effects import get_effect
from ros2_ident.errors import ErrorCode
from ros2_ident.files import remove_file, write_json
from ros2_ident.gates import examine
from ros2_ident.identify.data import Data, gather
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.outputs import checked, Outputs
from ros2_ident.identify.problem import Problem, problem_of, Setup
from ros2_ident.identify.result import Identification
from ros2_ident.identify.run import check_problem, solve
from ros2_ident.identify.settings import IdentifySettings, OnProgress
from ros2_ident.models import EffectAt, Machine
from ros2_ident.models.registry import compared_of, travel_of
from ros2_ident.recording import read_bags, RecordingBuilder, SAMPLES, Topics
from ros2_ident.search import Threads
from ros2_ident.search.evaluators import Cancel, Workers
from ros2_ident.search.fit import fit

# An identification needs none of the two.
if TYPE_CHECKING:
    from ros2_ident.change.result import Comparison
    from ros2_ident.gap.diagnose import DiagnoseProgress
    from ros2_ident.gap.result import Diagnosis


@dataclass(frozen=True)
class Request:
    """Request of a run.

    Attributes:
        bags: Paths of the recordings to fit; none for what was received.
        check: Paths of the recordings to judge on; none for parts held out of the others.
        drives: Drives to compare, in the machine's order; all where None.
        topics: Names of the topics in the bags.
        fixed: Parameters held at a value [their units].
        bounds: (low, high) instead of the machine file's [their units]; of an identification.
        outputs: What is compared, with weights; what the kind of machine compares where None. A
            diagnosis takes one.
        without: Ids of effects to leave out of the catalogue; of a diagnosis.
        settings: Search, budgets, threads.
        samples: Effort samples to fit on, all drives together; of an identification.
        workers: Who simulates; `settings.threads` threads of this process where None.
        machine_file: Path of the machine file, for the record; empty where there is none.
        earlier: An earlier result that is taken as known, for the record; see `knowing`.
    """

    machine: Machine
    bags: tuple[str, ...] = ()
    check: tuple[str, ...] = ()
    drives: tuple[str, ...] | None = None
    topics: Topics = field(default_factory=Topics)
    conditions: Conditions = Conditions()
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    outputs: Outputs | None = None
    effects: tuple[EffectAt, ...] = ()
    without: tuple[str, ...] = ()
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    seed: int = 1
    samples: int = SAMPLES
    workers: Workers | None = field(default=None, compare=False)
    machine_file: str = ''
    earlier: str = ''

    def problem(self, data: Data) -> Problem:
        """Return the nominal model on some data."""
        own = {x.name: getattr(self, x.name) for x in fields(Setup) if hasattr(self, x.name)}
        return problem_of(data=data, cutoff=self.settings.cutoff, **own)

    @property
    def seconds(self) -> float:
        """Time budget, s; 0 for none."""
        return self.settings.budget.seconds or 0.0

    def plain(self) -> dict[str, Any]:
        """Return what was asked for, as JSON and YAML hold it."""
        return {
            'bags': list(self.bags),
            'check_bags': list(self.check),
            'machine_file': self.machine_file,
            'drives': list(self.drives or self.machine.drives),
            'fixed': dict(self.fixed),
            'bounds': {name: list(pair) for name, pair in self.bounds.items()},
            **({'outputs': dict(self.outputs)} if self.outputs else {}),
            **({'without_effects': list(self.without)} if self.without else {}),
            **({'from': self.earlier} if self.earlier else {}),
            'time_budget': self.seconds,
            'seed': self.seed,
            **self.conditions.plain(),
        }


@dataclass(frozen=True, eq=False)
class Logs:
    """Data of a run.

    Attributes:
        check: The recordings to judge on; None for parts held out of the others.
        sha256: Hash of the bags to fit, or of the samples received.
        since: When reading began, by `time.monotonic`, s.
    """

    fit: Data
    check: Data | None
    sha256: str
    since: float


Result = TypeVar('Result', Identification, 'Diagnosis', 'Comparison')
Asking = TypeVar('Asking', bound=Request)


@dataclass(frozen=True, eq=False)
class Ended(Generic[Result]):
    """A run that has ended.

    Attributes:
        seconds: From reading to the result, s.
        checkpoint: File that the run could go on from; of no use once the result is safe.
    """

    request: Request
    logs: Logs
    result: Result
    seconds: float
    checkpoint: Path | None = None

    @property
    def complete(self) -> bool:
        """Whether no cancel and no budget cut it short."""
        return self.result.complete


class Identified(Ended[Identification]):
    """An identification that has ended."""

    def problem(self) -> Problem:
        """Return the model on the data it was found from, held as in the result."""
        found = self.result
        request = replace(self.request, drives=found.drives, fixed=found.fixed, bounds={})
        return request.problem(self.logs.fit)


@dataclass(frozen=True, eq=False)
class Diagnosed(Ended['Diagnosis']):
    """A diagnosis that has ended, and whether a cancel cut it short."""

    cancelled: bool = False


def knowing(request: Asking, path: str | Path | None) -> Asking:
    """Return a request that takes what an earlier result found as known.

    Its parameters have a normal distribution beforehand, of their values and intervals; its
    effects are in the model, but for loads, which are carried in one log; what was held is held.

    Args:
        path: What `ident identify` or `ident diagnose` wrote: a directory or a JSON file; the
            request stays as it is where None.

    Raises:
        IdentError: As `report.estimate.read_estimate`; INVALID_GOAL where nothing follows from it.
    """
    if path is None:
        return request
    from ros2_ident.report.estimate import read_estimate

    found = read_estimate(path)
    if found.doubt:
        raise ErrorCode.INVALID_GOAL.error(
            f'{path} cannot be taken as known ({found.doubt}); give another result, or leave out '
            '--from'
        )
    loads = [at for at in found.catalogued if get_effect(at.effect).shown_by == 'load']
    effects = [at for at in found.catalogued if at not in loads]
    prior = found.prior.without(tuple(at.prefix for at in loads))
    return replace(
        request,
        machine=replace(request.machine, prior=prior),
        effects=(*request.effects, *effects),
        fixed={**found.fixed, **request.fixed},
        earlier=str(path),
    )


@dataclass(frozen=True, eq=False)
class Compared(Ended['Comparison']):
    """A comparison of a request's logs with later bags; none of these for what was received."""

    later: tuple[str, ...] = ()


def read(request: Request, received: RecordingBuilder | None = None) -> Logs:
    """Read the logs of a request.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, BAD_VALUES and what else a log can lack.
    """
    since = time.monotonic()
    if not request.bags and received is None:
        raise ErrorCode.NO_DATA.error('there is no live data; replay a bag or name its path')

    def data_of(bags: Sequence[str], received: RecordingBuilder | None = None) -> Data:
        travel, drives = travel_of(request.machine), request.machine.drives
        if received is None:
            several = read_bags(bags, request.topics, travel, drives)
        else:
            several = received.build()
        needed = tuple(checked(request.outputs, compared_of(request.machine)))
        data = gather(
            several, request.machine, request.drives, samples=request.samples, quantities=needed
        )
        return data.without_command() if request.settings.method == 'algebraic' else data

    fit = data_of(request.bags, None if request.bags else received)
    check = data_of(request.check) if request.check else None
    # the same live data are recognised as the same
    prior = request.machine.prior
    if prior is not None and prior.sha256 and prior.sha256 == fit.sha256:
        raise ErrorCode.INVALID_GOAL.error(
            f'{prior.source} was found from this log, which would count twice; give another log, '
            'or leave out --from'
        )
    sha256 = fit.sha256 or hashlib.sha256(b''.join(x.digest for x in fit.datasets)).hexdigest()
    return Logs(fit, check, sha256, since)


def identify(
    request: Request,
    logs: Logs,
    *,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
    checkpoint: Path | None = None,
) -> Identified:
    """Identify the parameters; arguments and errors as of `identify.run.solve`."""
    problem = request.problem(logs.fit)
    check = None if logs.check is None else check_problem(problem, logs.check)
    result = solve(
        problem, request.settings, request.seed, cancel=cancel, on_progress=on_progress,
        workers=request.workers, checkpoint=checkpoint, check=check,
    )  # fmt: skip
    return Identified(request, logs, result, time.monotonic() - logs.since, checkpoint)


def diagnose(
    request: Request,
    logs: Logs,
    *,
    cancel: Cancel | None = None,
    on_progress: 'Callable[[DiagnoseProgress], None] | None' = None,
    checkpoint: Path | None = None,
) -> Diagnosed:
    """Find the gap and its cause; arguments and errors as of `gap.diagnose`."""
    from ros2_ident.gap.diagnose import diagnose as find_gap

    if request.outputs is not None and len(request.outputs) > 1:
        raise ErrorCode.INVALID_GOAL.error(
            f'a diagnosis compares one quantity and {" and ".join(request.outputs)} are given; '
            'give one of them'
        )
    check = logs.check
    asked = 'conditions', 'drives', 'without', 'fixed', 'effects', 'seed', 'seconds'
    result = find_gap(
        request.machine,
        logs.fit.datasets,
        check.datasets if check else (),
        labels=logs.fit.labels,
        check_labels=check.labels if check else (),
        **{name: getattr(request, name) for name in asked},
        output=next(iter(request.outputs)) if request.outputs else None,
        cancelled=cancel.is_set if cancel is not None else lambda: False,
        on_progress=on_progress,
        workers=request.workers or Threads(request.settings.threads),
        checkpoint=checkpoint,
    )
    cut = cancel is not None and cancel.is_set() and not result.complete
    return Diagnosed(request, logs, result, time.monotonic() - logs.since, checkpoint, cut)


def compare(
    request: Request,
    later: Sequence[str],
    *,
    paired: bool = False,
    among: int = 1,
    received: RecordingBuilder | None = None,
    cancel: Cancel | None = None,
    on_step: Callable[[float, str], None] = lambda share, text: None,
) -> Compared:
    """Say what changed between the bags of a request and later ones.

    Args:
        request: The bags before, and all else that is asked.
        later: Paths of the bags after; none for what was received.
        paired: As of `change.find_change`, like `among`.
        cancel: Ends it with the best so far.
        on_step: Told the share that is done, and a sentence.

    Raises:
        IdentError: As `read`; INVALID_GOAL where pairs are asked for and the sides have not as
            many bags, DIVERGED where nothing can be simulated, CANCELLED where that came first.
    """
    from ros2_ident.change.find import find_change
    from ros2_ident.change.logs import apart
    from ros2_ident.gap.diagnose import SEARCH

    if paired and len(request.bags) != len(later):
        raise ErrorCode.INVALID_GOAL.error(
            f'{len(request.bags)} bags before and {len(later)} after are no pairs; give as many '
            'of each, in the same order, or leave out --pairs'
        )
    logs = read(request), read(replace(request, bags=tuple(later)), received)
    sides = [x.fit for x in logs]
    data = replace(sides[0], datasets=tuple(d for x in sides for d in x.datasets), labels=(),
                   recordings=tuple(r for x in sides for r in x.recordings))  # fmt: skip
    problem = request.problem(data)
    on_step(0.0, 'fitting all logs alike')
    fitted = fit(
        problem, replace(request.settings, genetic=SEARCH.genetic), request.seed, cancel=cancel,
        workers=request.workers or Threads(request.settings.threads), first=problem.suggested,
        known=problem.box.known,
    )  # fmt: skip
    if not np.isfinite(fitted.theta).all():
        if fitted.cancelled:
            raise ErrorCode.CANCELLED.error('cancelled before anything was compared; run it again')
        raise ErrorCode.DIVERGED.error(
            'every candidate diverges on these logs; check units, gains and geometry in the '
            'machine file with `ident check`'
        )
    after = np.repeat([False, True], [len(x.datasets) for x in sides])
    names = [(bool(s), r.source) for s, r in zip(after, data.recordings, strict=True)]
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    datasets = [x.datasets for x in sides]
    reports = [examine(request.machine, x, request.drives) for x in datasets]
    result = find_change(
        problem,
        after,
        fitted.theta,
        np.array([number[name] for name in names]),
        paired=paired,
        among=among,
        without=request.without,
        stopped=cancel.is_set if cancel is not None else lambda: False,
        on_step=on_step,
        threads=request.settings.threads,
        reports=reports,
    )
    if not result.pushed:
        reports = [x.without('not_asked') for x in reports]
    told = apart(problem, request.machine, datasets, reports, request.drives)
    result = replace(result, apart=(*told, *result.apart))
    seconds = time.monotonic() - logs[0].since
    return Compared(request, logs[0], result, seconds, later=tuple(later))


def save(
    done: Identified | Diagnosed | Compared,
    folder: Path,
    *,
    overlay: bool = True,
    live: bool = False,
) -> list[Path]:
    """Write what a run found, and forget its checkpoint where it came to its end.

    Args:
        folder: Where to write; it exists.
        overlay: Whether to write the overlay bags, too.
        live: Whether the page there is this run's own, which a browser reloads.

    Raises:
        IdentError: INVALID_GOAL where something cannot be written.
    """
    # A fleet writes nothing of this, and its rows do not depend on it.
    from ros2_ident.report import files as results
    from ros2_ident.report import overlay as bags

    request, logs = done.request, done.logs
    if isinstance(done, Compared):
        asked = {**request.plain(), 'after_bags': list(done.later), 'seconds': done.seconds}
        found = {'format': 'ros2_ident.change', 'version': 1, **asdict(done.result)}
        return [write_json(folder / results.CHANGE, {**found, 'settings': asked})]
    # What is new does not lie beside what is old.
    bags.withdraw_overlay(folder / bags.OVERLAY)
    if not live:
        remove_file(folder / results.PAGE)
    if isinstance(done, Identified):
        problem, theta = done.problem(), done.result.theta
        held_out = None if logs.check is None else check_problem(problem, logs.check)
        asked = {k: v for k, v in request.plain().items() if k in _ASKED}
        result = replace(done.result, settings={**done.result.settings, **asked})
        files = list(results.write_result(folder, result, problem, held_out))
    else:
        from ros2_ident.report.diagnosis import effects_in, write_diagnosis

        diagnosed = done.result, request.machine, logs.fit, logs.check, request.plain()
        files = list(write_diagnosis(folder, *diagnosed))
        if overlay:
            values = done.result.parameters
            effects = effects_in(values, done.result.nominal)
            more = replace(request, outputs=None, effects=(*request.effects, *effects))
            problem = more.problem(logs.fit)
            theta = np.array([values[p.name].value for p in problem.parameters])
    if overlay:
        files += bags.write_overlay(folder / bags.OVERLAY, problem, theta, topics=request.topics)
    if done.checkpoint is not None and done.complete:
        remove_file(done.checkpoint)
    return files


# What a result says of its logs beside its own settings: the commands that a page proposes next.
_ASKED = 'bags', 'check_bags', 'machine_file', 'from'
