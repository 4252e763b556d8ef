# SPDX-License-Identifier: Apache-2.0
"""From data to identified parameters, and whether the result can be believed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
import math
from pathlib import Path

import numpy as np

from ros2_ident.arrays import Array, fast_noise
from ros2_ident.errors import ErrorCode
from ros2_ident.gates import examine, GateReport, sentences
from ros2_ident.gates.scale import FLOORS, MORE
from ros2_ident.identify.data import Data, gather
from ros2_ident.identify.data import read_data as read_data
from ros2_ident.identify.hidden import Missing, missing_beside
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.outcome import assemble, cut_short, doubted
from ros2_ident.identify.outputs import checked, Outputs
from ros2_ident.identify.problem import Problem, problem_of, problem_of_models
from ros2_ident.identify.result import Identification, Outcome, PoorFit
from ros2_ident.identify.settings import IdentifyProgress as IdentifyProgress
from ros2_ident.identify.settings import IdentifySettings, OnProgress
from ros2_ident.models import EffectAt, Machine, Model
from ros2_ident.models.registry import compared_of
from ros2_ident.prediction import CHECK, IDENTIFIED, LOG, of_description, predicted, Prediction
from ros2_ident.recording import Dataset, Recording
from ros2_ident.search import algebraic
from ros2_ident.search.evaluators import Cancel, Threads, Workers
from ros2_ident.search.fit import fit
from ros2_ident.search.journal import Journal
from ros2_ident.search.least_squares import BOX_DEVIATION
from ros2_ident.search.uncertainty import even_weights

# Time that the intervals take: a share of the refinement's, and so many seconds beside it, as
# measured on a tripod of 6 s and axes of 6 and 25 s.
INTERVALS_SHARE, INTERVALS_BESIDE = 1.5, 0.7

# A log is left out in so many parts. By hand.
PARTS = 4
QUARTERS = 'each quarter of the log, predicted from the other three'
REST = 'parts of the log that were not fitted on'

# A model that leaves this share of how an output varies, and far more than its noise, is not the
# machine's. By hand.
LARGE = 0.3
# What is said of every parameter then.
NOTE = 'means nothing: the model does not fit the log'

Measured = Data | Dataset | Sequence[Dataset] | Sequence[Recording]


def identify(
    machine: Machine | None = None,
    data: Measured | None = None,
    *,
    model: Model | Sequence[Model] | None = None,
    drives: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    effects: Sequence[EffectAt] = (),
    conditions: Conditions | None = None,
    outputs: Outputs | None = None,
    settings: IdentifySettings | None = None,
    seed: int = 0,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
    workers: Workers | None = None,
    checkpoint: str | Path | None = None,
    check: Data | None = None,
) -> Identification:
    """Identify the parameters of a machine, or of any model.

    Same machine, data, settings and seed give the same parameters to the bit, wherever simulated
    and however many there are, unless a budget of seconds or a cancel cuts the run.

    Args:
        machine: What is known of the machine, and the box of what is not.
        data: From `read_data` or `gather`, or data sets or recordings; several are one problem.
        model: Instead of machine and data: an object that meets `models.protocol.Model`, or
            several, one for each recording.
        drives: Drives whose effort is compared and whose parameters are free; all where None.
        fixed: Parameters to hold at a value [their units]: `drive_1.gear_stiffness`, or
            `gear_stiffness` for every drive.
        bounds: (low, high) instead of the machine file's, by the same names.
        outputs: What is compared: of `effort`, `position` and `velocity`, each with its weight,
            None for one by its noise; the effort alone by default.
        cancel: A `threading.Event` or the like; the best so far is kept.
        on_progress: Called from this thread at most ten times a second.
        workers: Who simulates; `settings.threads` threads of this process where None.
        checkpoint: File that is written on the way, and from which the same run goes on where it
            was cut off, with the same result to the bit. It stays: delete it once the result is
            safe.

    Returns:
        The parameters with intervals, and how it ended in words.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, MISSING_STREAM, BAD_VALUES or
            UNKNOWN_MODEL, before anything is simulated.
    """
    settings = settings or IdentifySettings()
    if not isinstance(seed, int) or seed < 0:
        raise ErrorCode.INVALID_GOAL.error(f'seed is {seed!r}; give a whole number of at least 0')
    if model is not None:
        if machine is not None or data is not None or drives or effects or outputs:
            raise ErrorCode.INVALID_GOAL.error(
                'a model brings its own data, drives, effects and outputs; give either the model, '
                'or machine and data'
            )
        problem = problem_of_models(model, fixed=fixed, bounds=bounds, conditions=conditions)
    elif machine is None or data is None:
        raise ErrorCode.INVALID_GOAL.error(
            'there is nothing to identify; give machine and data, or model'
        )
    else:
        compared = tuple(checked(outputs, compared_of(machine)))
        given = _as_data(machine, data, drives, compared)
        problem = problem_of(
            machine,
            given.without_command() if settings.method == 'algebraic' else given,
            drives=drives,
            fixed=fixed,
            bounds=bounds,
            effects=effects,
            cutoff=settings.cutoff,
            conditions=conditions,
            outputs=outputs,
        )
    return solve(
        problem,
        settings,
        seed,
        cancel=cancel,
        on_progress=on_progress,
        workers=workers,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        check=None if check is None else check_problem(problem, check),
    )


def solve(
    problem: Problem,
    settings: IdentifySettings,
    seed: int,
    *,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
    workers: Workers | None = None,
    checkpoint: Path | None = None,
    check: Problem | None = None,
) -> Identification:
    """Solve a problem; arguments and result as for `identify`."""
    # A user's own models have no machine file that a log could contradict.
    report = GateReport()
    if problem.setup is not None:
        report = examine(problem.machine, problem.data.datasets, problem.drives)
    watch = _Watch(on_progress) if on_progress and settings.budget.seconds is None else None
    if settings.method == 'algebraic':
        thinned = any(model.thinned for model in problem.models)
        found = algebraic.solve(
            problem, 1 if thinned else settings.decimation, settings.level, problem.box.known
        )
    else:
        with Journal(checkpoint, f'{problem.key} {seed} {settings.genetic}') as journal:
            found = fit(
                problem,
                settings,
                seed,
                cancel=cancel,
                on_progress=watch or on_progress,
                workers=workers or Threads(settings.threads),
                journal=journal,
                first=problem.suggested,
                known=problem.box.known,
                even=True,
            )
    weighed = None
    if found.intervals is not None and not cut_short(found):
        stopped = cancel.is_set if cancel else lambda: False
        if watch:
            watch.intervals()
        weighed = missing_beside(problem, found.theta, None, stopped, settings.threads)
    evidence = None if weighed is None else weighed.evidence
    # Threads do not change the result, so files of one and of two of them are the same.
    plain = {name: value for name, value in asdict(settings).items() if name != 'threads'}
    result = assemble(problem, found, seed, plain, evidence)
    result = judged(result, report, poorly_fitted(problem, found.residual))
    if found.cancelled:
        return result
    result = with_held_out(result, problem, weighed, check)
    return replace(result, prediction=_predicted(problem, result.theta, check))


def _predicted(problem: Problem, theta: Array, check: Problem | None) -> Prediction | None:
    """Return how far free runs come from the recordings judged on."""
    if not np.isfinite(theta).all():
        return None
    on, own = (LOG, theta) if check is None else (CHECK, check.taken_from(problem, theta))
    runs = (check or problem).each(own)
    return predicted(on, [*of_description(runs), (IDENTIFIED, runs)])


class _Watch:
    """Progress of an identification, with the time that its intervals will take."""

    def __init__(self, on_progress: OnProgress) -> None:
        self._tell = on_progress
        self._last: IdentifyProgress | None = None
        self._searched = 0.0

    def __call__(self, progress: IdentifyProgress) -> None:
        self._last = progress
        if progress.phase == 'search':
            self._searched = progress.elapsed
        refinement = progress.elapsed + progress.eta - self._searched
        later = INTERVALS_BESIDE + INTERVALS_SHARE * refinement
        self._tell(replace(progress, eta=progress.eta + later))

    def intervals(self) -> None:
        if self._last is not None:
            self(replace(self._last, phase='intervals', eta=0.0))


def _as_data(
    machine: Machine, data: Measured, drives: Sequence[str] | None, quantities: Sequence[str]
) -> Data:
    if isinstance(data, Data):
        return data
    several = [data] if isinstance(data, Dataset) else data
    datasets = tuple(x for x in several if isinstance(x, Dataset))
    recordings = [x for x in several if isinstance(x, Recording)]
    if datasets and not recordings:
        return Data(datasets)
    return gather(recordings, machine, drives, quantities=quantities)


def poorly_fitted(problem: Problem, residual: Array) -> tuple[PoorFit, ...]:
    """Return the outputs of which a fit leaves a large part of what varies.

    Args:
        residual: (R,) what is left, as `Problem.residuals` has it; empty where nothing was.
    """
    if not residual.size or not np.isfinite(residual).all():
        return ()
    outputs = problem.models[0].outputs
    rest: list[list[Array]] = [[] for _ in outputs]
    varied: list[list[Array]] = [[] for _ in outputs]
    for o, *both in problem.parts(residual):
        # An offset that is left is no other machine's motion.
        for of, row in zip((rest[o], varied[o]), both, strict=True):
            of.append(row - row.mean() if row.size else row)
    found = []
    for output, parts, measured in zip(outputs, rest, varied, strict=True):
        left, spread = (float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (parts, measured))
        stated = problem.noise if output.quantity == outputs[0].quantity else 0.0
        noise = max(stated, fast_noise(*parts))
        # Noise alone leaves all of what varies, and no more.
        if left > MORE * spread or (left > LARGE * spread and left > FLOORS * noise):
            share = left / spread if spread > 0.0 else math.inf
            floors = left / noise if noise > 0.0 else math.inf
            found.append(PoorFit(output.name, left, output.unit, share, floors))
    return tuple(found)


def judged(result: Identification, report: GateReport, poor: Sequence[PoorFit]) -> Identification:
    """Return a result with the findings of the gates, that claims no more than can be."""
    first = report.contradictions[:1]  # is the headline
    warned = sentences(g for g in report.gates if g.level != 'ok' and g not in first)
    warnings = tuple(dict.fromkeys((*warned, *result.quality.warnings)))
    quality = replace(result.quality, warnings=warnings)
    result = replace(result, gates=report.gates, quality=quality, poor=tuple(poor))
    ended = result.outcome in (Outcome.IDENTIFIED, Outcome.NOT_IDENTIFIABLE)
    spent = result.outcome is Outcome.BUDGET_SPENT
    if (poor and ended) or (report.blocked and (ended or spent)):
        return replace(
            result,
            outcome=Outcome.CONTRADICTED,
            parameters=tuple(doubted(p, NOTE) for p in result.parameters),
        )
    return result


def with_held_out(
    result: Identification, problem: Problem, weighed: Missing | None, check: Problem | None
) -> Identification:
    """Return a result with its held-out error.

    It is judged on the check recording where there is one, else on the parts of a long log that
    were not fitted on, else on each quarter of the log in turn. The estimate stays that of all.

    Args:
        weighed: What its residual shows; None where the run was cut short.
        check: The same problem on data to judge on.
    """
    if not np.isfinite(result.theta).all():
        return result
    on = REST if check is None else check.data.source
    if check is None and problem.setup is not None:
        check = problem.setup.held_out()
    if check is not None:
        theta = check.taken_from(problem, result.theta)
        left = check.left(check.residuals(theta[None, :])[0])
        return replace(result, validation=left, validated_on=on)
    if weighed is None:
        return result
    grown = zip(
        result.residuals,
        problem.left(quarters(problem, weighed, result.theta), weighed.rows.masks),
        problem.left(weighed.residual, weighed.rows.masks),
        strict=True,
    )
    # What is weighed leaves out a log's start and part of a long one; the whole grows likewise.
    validation = tuple(
        replace(whole, rms=whole.rms * factor, share=whole.share * factor)
        for whole, out, fitted in grown
        for factor in [out.rms / fitted.rms if fitted.rms > 0.0 else 1.0]
    )
    return replace(result, validation=validation, validated_on=QUARTERS)


def check_problem(problem: Problem, check: Data) -> Problem:
    """Return the same problem on recordings to judge on; raises as `problem_of`.

    Raises:
        IdentError: INVALID_GOAL where a parameter has a value of its own in every bag, or the
            models are a user's own.
    """
    if problem.setup is None:
        raise ErrorCode.INVALID_GOAL.error(
            'a model brings its own data, and no other can be judged on; leave out check'
        )
    other = problem.setup.judged_on(check)
    own = [p.name for p in other.parameters if p.name not in problem.names]
    if own:
        raise ErrorCode.INVALID_GOAL.error(
            f'{own[0]} has a value of its own in every bag (--each), so that no other bag can be '
            'predicted; leave out --check, or share the parameter'
        )
    return other


def quarters(problem: Problem, weighed: Missing, theta: Array) -> Array:
    """Return (R,) each part's residual at the estimate from all other parts of the log.

    That estimate is a Gauss-Newton step away from the one of the whole log; no fit is repeated.

    Args:
        weighed: Residual and slopes at its solution.
        theta: (N,) the solution.
    """
    rows, blocks = weighed.rows, weighed.rows.blocks
    lengths = [n for x in rows.masks for n in x.sum(axis=1)]
    weights = even_weights(weighed.residual, lengths, problem.outputs)
    slopes, residual = weighed.slopes * weights[:, None], weighed.residual * weights
    part = (blocks - blocks.min()) * PARTS // (int(np.ptp(blocks)) + 1)
    parts = [part == k for k in np.unique(part)]
    # A triangular factor says all that a part does, in few rows.
    factors = [np.linalg.qr(np.column_stack([slopes[x], residual[x]]), mode='r') for x in parts]
    size = float(np.sqrt(np.mean(residual**2)))
    box = np.column_stack([np.eye(theta.size) * size / BOX_DEVIATION, np.zeros(theta.size)])
    unit = (theta - problem.low) / (problem.high - problem.low)
    if (known := problem.box.known) is not None:
        box = np.vstack([box, size * np.column_stack([known.rows, known.residual(unit)])])
    left = residual.copy()
    for k, own in enumerate(parts):
        others = np.vstack([*factors[:k], *factors[k + 1 :], box])
        step = np.linalg.lstsq(others[:, :-1], -others[:, -1], rcond=None)[0]
        left[own] += slopes[own] @ (np.clip(unit + step, 0.0, 1.0) - unit)
    return left / weights
