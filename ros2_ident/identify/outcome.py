# SPDX-License-Identifier: Apache-2.0
"""From a fit to the result: its outcome, its origin, and how certain each parameter is.

A parameter is identified where half of its 95 % interval, with what the model may lack, is at most
`KNOWN` of its value, and the interval narrower than half of its box; one that a machine can be
without (friction, an offset, a delay) also where no value of the interval changes an output by
more than `LITTLE` of it. Otherwise an interval that ends inside the box bounds it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, UTC
import importlib.metadata
from itertools import accumulate, pairwise
import platform

import numpy as np

from ros2_ident import package_version
from ros2_ident.arrays import Array
from ros2_ident.gates.scale import figure, OTHER_NOISE
from ros2_ident.identify.data import Data
from ros2_ident.identify.hidden import MATERIAL
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import (
    bound_of,
    Cost,
    DriveResidual,
    History,
    Identification,
    Outcome,
    ParameterEstimate,
    Provenance,
    State,
)
from ros2_ident.models import Machine
from ros2_ident.recording.limits import likewise
from ros2_ident.search import RefineStatus, StopReason
from ros2_ident.search.evidence import Evidence
from ros2_ident.search.fit import Fitted
from ros2_ident.search.noise import fit_noise
from ros2_ident.search.refine import StartOutcome

# Of every parameter where refinements ended in different minima.
ONE_OF_SEVERAL = 'of one of several minima that fit almost alike'
# Minima lie apart by this part of the box in some parameter, and by so many half widths of its
# interval: a parameter that the data do not determine makes none. By hand.
APART, BEYOND = 0.01, 3.0
# One that leaves less than so many times the best one's mean square above the noise fits alike. By
# hand.
ALIKE = 2.0
# Half an interval over the value up to which the value is known. By hand.
KNOWN = 0.2
# An interval wider than this part of the box says no more than the box does. By hand.
MOST_OF_BOX = 0.5
# Share of an output that does not matter. By hand.
LITTLE = 0.01

NOT_IDENTIFIABLE = 'not identifiable from this data'
# Of an interval that is too wide to identify a parameter; the second where noise alone would do.
WIDE, HIDDEN = 'interval wider than {}', ' once model error is allowed for'
NIL = 'below 1 % of the output'
# Of what stands for several parameters of links and rotors that show together only.
BASE = 'base parameter, of either sign'
# Of an inertia or a mass below 0, which there is none of.
BELOW = (
    'physically impossible, below 0: the links that the description has there are too heavy, or '
    'the logged effort is too small or of the other sign; correct the description or effort_unit'
)
CUT_SHORT = 'interval not computed: the run was cut short'


def assemble(
    problem: Problem,
    found: Fitted,
    seed: int,
    settings: Mapping[str, object],
    evidence: Evidence | None = None,
) -> Identification:
    """Return the result of a run; without evidence where the residual was not weighed."""
    estimates = estimates_of(problem, found, evidence)
    rivals = rival_minima(problem, found)
    if rivals:
        estimates = tuple(doubted(e, ONE_OF_SEVERAL) for e in estimates)
    size, setup = len(estimates), problem.setup
    left = problem.left(found.residual) if found.residual.size else ()
    quality = problem.quality()
    refined = found.refined is not None and np.isfinite(found.refined.cost)
    return Identification(
        outcome=_outcome(found, estimates, rivals=bool(rivals)),
        rival=tuple(float(x) for x in rivals[0].theta) if rivals else (),
        model=problem.name,
        drives=problem.drives,
        parameters=estimates,
        fixed=dict(problem.fixed),
        correlation=found.intervals.correlation
        if found.intervals
        else np.full((size, size), np.nan),
        cost=Cost(
            found.ga.cost,
            problem.cost_of(found.residual) if refined else float('nan'),
            problem.unit,
        ),
        residuals=left,
        evaluations=found.evaluations,
        generations=found.ga.generations,
        seconds=found.seconds,
        seed=seed,
        search_stop=found.ga.stop.value,
        refinement=found.refined.status.value if found.refined else '',
        history=History(
            np.array(found.ga.best_costs), found.candidates, found.costs, found.generations
        ),
        quality=replace(
            quality,
            warnings=(
                *quality.warnings,
                *_of_outputs({e.name: BELOW for e in estimates if e.impossible}),
                *_gap(problem, left, evidence),
            ),
        ),
        provenance=provenance_of(setup.machine, setup.data) if setup else provenance_of(),
        settings=settings,
    )


def _gap(
    problem: Problem, left: tuple[DriveResidual, ...], evidence: Evidence | None
) -> tuple[str, ...]:
    """Return warnings of the residual: a model that lacks something, noise other than stated."""
    noise, machine = problem.noise, problem.models[0].machine
    told = machine is None or machine.stated('effort_noise')
    missing, noisy = dict[str, str](), dict[str, str]()
    if evidence is None:
        for x in left:
            if noise > 0.0 and not x.unit and x.rms > OTHER_NOISE * noise:
                noisy[x.drive] = (
                    f'the residual is {figure(x.rms / noise)} times the effort noise of the '
                    'machine file; `ident diagnose` looks for what the model leaves out'
                )
        return _of_outputs(noisy)
    outputs = problem.models[0].outputs
    rows = zip(outputs, evidence.predicted, evidence.floor, strict=True)
    for output, predicted, floor in rows:
        unit = '' if output.unit == '1' else f' {output.unit}'
        found = floor / output.weight
        stated = told and output.quantity == 'effort' and noise > 0.0
        if predicted >= MATERIAL * floor:
            missing[output.name] = (
                f'effects of the catalogue predict {predicted / output.weight:.2g}{unit} of the '
                f'residual, {figure(predicted / floor)} times the noise; `ident diagnose` looks '
                'for what the model leaves out'
            )
        elif stated and not noise / OTHER_NOISE < found < noise * OTHER_NOISE:
            noisy[output.name] = (
                f'the noise of the log is {found:.2g}{unit}, and the machine file states '
                f'{noise:.2g}{unit} (effort_noise); the log decides'
            )
    return (*_of_outputs(missing), *_of_outputs(noisy))


def _of_outputs(said: Mapping[str, str]) -> tuple[str, ...]:
    """Return one sentence on several outputs: the first one's, with the others' names."""
    names = list(said)
    return tuple(f'{name}: {said[name]}{likewise(names[1:])}' for name in names[:1])


def _outcome(found: Fitted, estimates: tuple[ParameterEstimate, ...], *, rivals: bool) -> Outcome:
    if found.cancelled:
        return Outcome.CANCELLED
    if not np.isfinite(found.ga.cost):
        return Outcome.DIVERGED
    if cut_short(found):
        return Outcome.BUDGET_SPENT
    sure = not rivals and all(e.identifiable for e in estimates)
    return Outcome.IDENTIFIED if sure else Outcome.NOT_IDENTIFIABLE


def cut_short(found: Fitted) -> bool:
    """Return whether a cancel or a budget ended the run."""
    status = found.refined.status if found.refined else None
    return (
        found.cancelled
        or found.ga.stop in (StopReason.EVALUATIONS, StopReason.SECONDS)
        or status in (RefineStatus.CANCELLED, RefineStatus.EVALUATIONS)
        or bool(found.left_out)
    )


def provenance_of(machine: Machine | None = None, data: Data | None = None) -> Provenance:
    """Return where numbers from a machine file and data come from, as of now and here."""
    return Provenance(
        source=data.source if data else 'a model of its own',
        sha256=data.sha256 if data else '',
        machine_sha256=machine.digest if machine else '',
        package_version=package_version(),
        platform=', '.join(
            [
                f'{platform.system()} {platform.machine()}',
                f'Python {platform.python_version()}',
                *(
                    f'{name} {importlib.metadata.version(name)}'
                    for name in ('numpy', 'numba', 'scipy')
                ),
            ]
        ),
        created=datetime.now(UTC).isoformat(timespec='seconds'),
    )


def rival_minima(problem: Problem, found: Fitted) -> tuple[StartOutcome, ...]:
    """Return minima beside the best one that fit almost as well, lowest cost first.

    Args:
        found: How; its refinements' ends are compared.

    Returns:
        Nothing where the best fit leaves noise only, or several refinements ended there.
    """
    refined, known = found.refined, found.intervals
    if refined is None or known is None or not np.isfinite(found.residual).all():
        return ()
    near = np.maximum(APART * (problem.high - problem.low), BEYOND * known.half_width)
    ends = [s for s in refined.starts if s.status is RefineStatus.CONVERGED]
    # the end from which the estimate goes on, its series weighted
    own = min(refined.starts, key=lambda s: float(np.abs((s.theta - found.theta) / near).max()))
    apart = [s for s in ends if (np.abs(s.theta - own.theta) > near).any()]
    if not apart or len(ends) - len(apart) > 1:
        return ()
    noise = _noise(found.residual, problem.series)
    limit = noise + ALIKE * (refined.cost**2 - noise)
    return tuple(sorted((s for s in apart if s.cost**2 < limit), key=lambda s: s.cost))


def _noise(residual: Array, series: Sequence[int]) -> float:
    """Return the mean innovation variance of an AR model of each series."""
    ends = pairwise(accumulate(series, initial=0))
    total = sum((b - a) * fit_noise(residual[a:b]).innovation for a, b in ends)
    return total / max(1, residual.size)


def state_of(value: float, low: float, high: float, lower: float, upper: float) -> State:
    """Return the state of a value with an interval (low, high) in a box (lower, upper)."""
    if high - low <= min(2.0 * KNOWN * abs(value), MOST_OF_BOX * (upper - lower)):
        return 'identified'
    return 'bounded' if bound_of(low, high, lower, upper, '') else 'not determined'


def doubted(estimate: ParameterEstimate, why: str) -> ParameterEstimate:
    """Return an estimate whose interval means nothing, with the reason."""
    return replace(estimate, state='not determined', note=why)


def estimates_of(
    problem: Problem, found: Fitted, evidence: Evidence | None
) -> tuple[ParameterEstimate, ...]:
    """Return the parameters with intervals, states and words; no intervals where cut short."""
    known, nothing = found.intervals, np.full(len(found.theta), np.nan)
    noise = (known.low, known.high) if known else (nothing, nothing)
    ends = noise
    if evidence is not None:
        ends = evidence.ends(found.theta, problem.low, problem.high, *noise)
    rows = np.stack([*ends, *noise], axis=1).tolist()
    return tuple(_estimate(problem, found, k, *row) for k, row in enumerate(rows))


def _estimate(
    problem: Problem, found: Fitted, k: int,
    low: float, high: float, noise_low: float, noise_high: float,
) -> ParameterEstimate:  # fmt: skip
    p, value = problem.parameters[k], float(found.theta[k])
    state = state_of(value, low, high, p.low, p.high)
    bound = bound_of(low, high, p.low, p.high, p.unit)
    said, hidden = [], False
    if found.intervals is None:
        at = 'lower' if value <= p.low else 'upper' if value >= p.high else ''
        said.append(CUT_SHORT)
    else:
        at = found.intervals.at_bound[k]
        if state != 'identified' and _is_nil(problem, found, k, low, high):
            state = 'identified'
            said.append(f'{bound}: {NIL}' if bound else NIL)
        elif state != 'identified':
            hidden = state_of(value, noise_low, noise_high, p.low, p.high) == 'identified'
            most = f'{200.0 * KNOWN:.0f} % of the value'
            wide = WIDE.format(
                most if high - low > 2.0 * KNOWN * abs(value) else 'half its bounds'
            )
            said += [bound or NOT_IDENTIFIABLE]
            said += [wide + (HIDDEN if hidden else '')] if bound or hidden else []
    said += [f'at its {at} bound'] if at else []
    said += [BASE] if p.kind == 'base' else []
    estimate = ParameterEstimate(
        p.name, p.unit, value, low, high, p.low, p.high, float(found.ga.theta[k]), bool(at), state,
        p.kind, ', '.join(said), noise_low, noise_high, hidden,
    )  # fmt: skip
    below = BELOW.partition(':')[0]
    note = estimate.note.replace(BASE, below) if estimate.impossible else estimate.note
    return replace(estimate, note=note)


def _is_nil(problem: Problem, found: Fitted, number: int, low: float, high: float) -> bool:
    """Return whether nothing of an interval shows in any output, beside there being none."""
    p = problem.parameters[number]
    if p.absent is None or high - low > MOST_OF_BOX * (p.high - p.low):
        return False
    candidates = np.repeat(found.theta[None, :], 3, axis=0)
    candidates[:, number] = np.clip([p.absent, low, high], p.low, p.high)
    without, *others = problem.residuals(candidates)
    changes = (x for other in others for x in problem.left(other - without))
    return all(x.rms == 0.0 or x.share <= LITTLE for x in changes)
