# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of one machine's recordings, from the nominal fit to the advice."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
import time

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import get_effect, shown_by
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.attribute import Attribution, Explanation, visibility
from ros2_ident.gap.blocks import Blocks, Interval
from ros2_ident.gap.case import Case
from ros2_ident.gap.coordinates import motion_of
from ros2_ident.gap.diagnosis import Diagnosis, DriveGap, Ranked, Step, Trace, Value
from ros2_ident.gap.explain import Explained, Explainer, Rules
from ros2_ident.gap.floor import Floor, pooled_floor
from ros2_ident.gap.gates import run_gates
from ros2_ident.gap.localise import Finding, localise
from ros2_ident.gap.reading import coarse_readings, CoarseReading
from ros2_ident.gap.verdict import advice, judge, NONE, UNKNOWN, Verdict
from ros2_ident.models import EffectAt, Machine
from ros2_ident.recording import Dataset
from ros2_ident.search import GeneticSettings, intervals

Array = npt.NDArray[np.float64]

# The nominal search need not be sharp: local fits follow, from its best survivors.
SEARCH = GeneticSettings(initial_population=512, survivors=8, children=8, generations=8)
# An effect whose largest trial leaves less than this, in units of the floor, cannot be seen in the
# log.
VISIBLE = 0.3


@dataclass(frozen=True)
class DiagnoseProgress:
    """How far a diagnosis is.

    Attributes:
        stage: What is being done.
        fraction: Share of the work done, 0 to 1.
        best_so_far: The verdict if it ended now, as a sentence; empty for none yet.
        elapsed: Seconds since the start.
        eta: Seconds expected until the end, NaN where unknown.
    """

    stage: str
    fraction: float
    best_so_far: str
    elapsed: float
    eta: float


class _Run:
    """Clock, cancel and progress of one diagnosis."""

    def __init__(
        self,
        seconds: float,
        cancelled: Callable[[], bool],
        on_progress: Callable[[DiagnoseProgress], None] | None,
    ) -> None:
        self.begin = time.monotonic()
        self.seconds = seconds
        self.cancelled = cancelled
        self.on_progress = on_progress
        self.best = ''
        self.stage = (0.0, 1.0)

    @property
    def elapsed(self) -> float:
        return time.monotonic() - self.begin

    def stopped(self) -> bool:
        return self.cancelled() or 0.0 < self.seconds < self.elapsed

    def step(self, share: float, text: str) -> None:
        if self.on_progress is None:
            return
        low, high = self.stage
        fraction = low + (high - low) * share
        eta = self.elapsed * (1.0 - fraction) / fraction if fraction > 0.02 else math.nan
        self.on_progress(DiagnoseProgress(text, fraction, self.best, self.elapsed, eta))


def diagnose(
    machine: Machine,
    fit: Sequence[Dataset],
    check: Sequence[Dataset] = (),
    *,
    drives: Sequence[str] | None = None,
    without: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    rules: Rules | None = None,
    seed: int = 1,
    seconds: float = 0.0,
    cancelled: Callable[[], bool] = lambda: False,
    on_progress: Callable[[DiagnoseProgress], None] | None = None,
) -> Diagnosis:
    """Say where the gap lies, which effect causes it, and how far it closes with it.

    Args:
        machine: The machine.
        fit: Recordings to fit on.
        check: Recordings held out; without them every second block of the fit recordings is held
            out.
        drives: Drives to look at; all by default.
        without: Ids of effects to leave out of the catalogue.
        fixed: Parameters not to be identified.
        rules: When something counts.
        seed: Of the search and of the resampling.
        seconds: Time budget; 0 for none. At its end the best so far is the answer.
        cancelled: Asked often; True ends with the best so far.
        on_progress: Told how far it is.

    Returns:
        The diagnosis.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DIVERGED or UNKNOWN_PARAMETER with the remedy.
    """
    if not fit:
        raise IdentError(
            ErrorCode.NO_DATA, 'there is no recording to fit on; give a bag with drive data'
        )
    for name in without:
        get_effect(name)
    run = _Run(seconds, cancelled, on_progress)
    case = Case(machine, fit, check, drives=drives, fixed=fixed)
    run.stage = (0.0, 0.15)
    run.step(0.0, 'identifying the nominal parameters')
    guess = np.full(len(case.drives), machine.effort_noise)
    attribution = Attribution(case, guess, stopped=run.stopped, on_step=run.step)
    base = attribution.nominal(SEARCH, seed)
    if not np.isfinite(base.residual).all():
        raise IdentError(
            ErrorCode.DIVERGED,
            'every candidate diverges on this log; '
            'check units, gains and geometry in the machine file',
        )
    floor = _capped(_floor(attribution, base), machine.effort_noise)
    attribution = Attribution(case, floor.per_drive, stopped=run.stopped, on_step=run.step)
    base = attribution.refit((), base.theta)
    base = attribution.watch_law(base)
    gates: list[tuple[str, str, str]] = []
    if not run.stopped():
        report = run_gates(case.models((), case.fit)[0], base.theta, floor)
        gates = [(g.gate, g.level, g.sentence) for g in report.gates]
    explainer = Explainer(attribution, rules or Rules())

    def note(e: Explanation) -> None:
        names = ', '.join(f'{get_effect(a.effect).title} on {a.where}' for a in e.effects)
        run.best = f'{names}: closes {100 * explainer.share(base, e):.0f} % of the explainable gap'
        low = run.stage[1]
        run.stage = (low, low + 0.5 * (0.95 - low))

    def together() -> Diagnosis:
        """Diagnose with both recordings fitted on, block by block."""
        return diagnose(
            machine,
            [*fit, *check],
            drives=drives,
            without=without,
            fixed=fixed,
            rules=rules,
            seed=seed,
            seconds=max(1e-3, seconds - run.elapsed) if seconds else 0.0,
            cancelled=cancelled,
        )

    run.stage = (0.15, 0.6)
    candidates = case.candidates(without)
    if check and explainer.size(base) >= explainer.rules.material and not run.stopped():
        both = Case(machine, [*fit, *check], drives=drives, fixed=fixed)
        if _nominal_is_enough(both, base.theta, explainer):
            second = together()
            if second.effect == NONE and second.complete:
                return replace(second, seconds=run.elapsed)
    found = explainer.explain(base, candidates, note)
    base = found.chain[0]
    # Where nothing is missing nothing was tried; what the motion could not have shown is said all
    # the same.
    visible = (
        found.rounds[0].visible if found.rounds else visibility(attribution.look(base, candidates))
    )
    verdict = judge(explainer, found, _readings(case, base, candidates))
    if verdict.effect == UNKNOWN and not run.stopped() and _shows_later(explainer, found):
        second = together()
        if second.effect not in (NONE, UNKNOWN) and second.complete:
            return replace(second, seconds=run.elapsed)
    run.stage = (0.95, 1.0)
    run.step(0.0, 'saying where')
    model = case.models((), case.fit)[0]
    outputs = base.residual[: len(attribution.weight)]
    rows = case.fit.rows(outputs / attribution.weight)[:, : model.measured.shape[1]]
    where: tuple[Finding, ...] = ()
    if not run.stopped():
        findings = localise(motion_of(model, base.theta), rows, floor, seed=seed)
        where = tuple(f for f in findings if f.significant)
    testable = tuple(at for at, seen in visible.items() if seen < VISIBLE)
    return _compose(explainer, found, verdict, floor, gates, where, testable, run, seed)


def _readings(
    case: Case, base: Explanation, candidates: Sequence[EffectAt]
) -> tuple[CoarseReading, ...]:
    """Return encoders whose steps show, where these are among the effects looked for."""
    known = shown_by('reading_steps')
    if known is None or known.id not in {at.effect for at in candidates}:
        return ()
    return coarse_readings(case, base.theta, base.law)


def _nominal_is_enough(both: Case, theta: Array, explainer: Explainer) -> bool:
    """Whether the nominal parameters leave nothing once they are fitted to all recordings.

    Where the recording fitted on does not show one of them, its value is chance, and wrong on the
    one held out; an effect that lets the fit go on from there would look like the cause.
    """
    attribution = explainer.attribution
    fits = Attribution(both, attribution.floor, stopped=attribution.stopped)
    judge_of_both = Explainer(fits, explainer.rules)
    return judge_of_both.size(fits.refit((), theta)) < explainer.rules.material


def _shows_later(explainer: Explainer, found: Explained) -> bool:
    """Whether what is missing shows on the recording held out and hardly on the one fitted on.

    Then no fit could find its parameters, and both recordings have to take turns, block by block.
    """
    base = found.chain[0]
    fitted = base.fit / explainer.fit_count - 1.0
    held = base.check / explainer.check_count - 1.0
    worst = int(held.argmax())
    apart = explainer.attribution.case.held_out == 'check bag'
    return apart and bool(
        held[worst] > explainer.rules.material**2 and held[worst] > 4.0 * max(fitted[worst], 0.0)
    )


def _floor(attribution: Attribution, base: Explanation) -> Floor:
    """Estimate the floor on all recordings together."""
    case = attribution.case
    residuals: dict[int, Array] = {}
    datasets: dict[int, Dataset] = {}
    unit = ''
    for part in (case.fit, case.check):
        for model, data in zip(case.models((), part), part.data, strict=True):
            residual = model.measured - model.simulate(base.theta[None])[0]
            residual[:, : int(round(0.1 / model.cycle))] = np.nan
            # Without a check bag both parts are blocks of the same recordings.
            residuals[id(data)], datasets[id(data)] = residual, data
            unit = model.unit
    return pooled_floor(list(residuals.values()), list(datasets.values()), case.drives, unit)


def _capped(floor: Floor, noise: float) -> Floor:
    """Keep a floor taken from the fast part of the residual near the noise that is stated.

    What is fast and more than that is no noise of the log: steps of an encoder in the loop, a
    ripple at speed. It belongs to the gap. And a log that was smoothed before has no fast part.
    """
    if floor.method == 'repeats':
        return floor
    return replace(floor, per_drive=np.clip(floor.per_drive, 0.5 * noise, 1.3 * noise))


def _compose(
    explainer: Explainer,
    found: Explained,
    verdict: Verdict,
    floor: Floor,
    gates: Sequence[tuple[str, str, str]],
    where: tuple[Finding, ...],
    testable: tuple[EffectAt, ...],
    run: _Run,
    seed: int,
) -> Diagnosis:
    attribution = explainer.attribution
    case = attribution.case
    chain = found.chain if verdict.effect not in (NONE, UNKNOWN) else found.chain[:1]
    final = chain[-1]
    model = case.models(final.effects, case.fit)[0]
    rows = [case.check.rows(e.check_residual / attribution.check_weight) for e in found.chain]
    blocks = Blocks(rows, model.cycle, seed=seed, starts=case.check.starts)
    labels = ['nominal'] + [
        f'{get_effect(a.effect).title} on {a.where}' for a in found.chain[-1].effects
    ]
    steps = tuple(Step(labels[i], blocks.rms(i)[1]) for i in range(len(found.chain)))
    last = len(found.chain) - 1
    share = blocks.share_closed(0, last, floor) if last else Interval(0.0, math.nan, math.nan)
    values = _values(explainer, final) | _steps(verdict.readings)
    nominal = {
        p.name: v
        for p, v in zip(case.models((), case.fit)[0].parameters, found.chain[0].theta, strict=True)
    }
    moved = {
        name: (values[name].value - v) / v
        for name, v in nominal.items()
        if name in values and v != 0.0
    }
    return Diagnosis(
        effect=verdict.effect,
        where=verdict.where,
        probability=verdict.probability,
        sentence=_sentence(verdict, explainer, found, floor, model.unit),
        also=verdict.also,
        confusable=tuple(
            _ranked(explainer, found.chain[0], w.at, w.probability, w.model)
            for w in verdict.confusable
        ),
        ranking=tuple(
            _ranked(explainer, found.chain[0], w.at, w.probability, w.model)
            for w in verdict.ranking
        ),
        unit=model.unit,
        steps=steps,
        floor=floor,
        share_closed=share,
        held_out=case.held_out,
        evidence={
            'size': explainer.size(found.chain[0]),
            'remaining': found.remaining,
            'closed': verdict.closed,
            'material': explainer.rules.material,
        },
        per_drive=_per_drive(explainer, found, blocks, floor),
        localisation=where,
        parameters=values,
        moved=moved,
        nominal=nominal,
        gates=tuple(gates),
        not_testable=testable,
        advice=advice(verdict, testable),
        complete=found.complete,
        seconds=run.elapsed,
        seed=seed,
        traces=_traces(case, found),
    )


def _traces(case: Case, found: Explained) -> tuple[Trace, ...]:
    """Return every recording beside the nominal fit and the last one."""
    base, last = found.chain[0], found.chain[-1]
    parts = [case.fit, case.check] if case.held_out == 'check bag' else [case.fit]
    return tuple(
        Trace(
            held_out=part is case.check,
            motion=motion_of(nominal, base.theta),
            measured=nominal.measured,
            extended=extended.simulate(last.theta[None])[0],
            fitted=mask if part is case.fit else np.zeros_like(mask),
        )
        for part in parts
        for nominal, extended, mask in zip(
            case.models((), part), case.models(last.effects, part), part.masks, strict=True
        )
    )


def _values(explainer: Explainer, e: Explanation) -> dict[str, Value]:
    case = explainer.attribution.case
    model = case.models(e.effects, case.fit)[0]
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    series = np.concatenate([mask.sum(axis=1) for mask in case.fit.masks])
    rows = len(explainer.attribution.weight)
    found = intervals(
        e.jacobian[:rows] / (high - low),
        e.residual[:rows],
        e.theta,
        low,
        high,
        series=[int(s) for s in series],
    )
    return {
        p.name: Value(float(v), p.unit, float(lo), float(hi))
        for p, v, lo, hi in zip(model.parameters, e.theta, found.low, found.high, strict=True)
    }


def _steps(readings: Sequence[CoarseReading]) -> dict[str, Value]:
    """Return the steps of the encoders named."""
    effect = shown_by('reading_steps')
    if effect is None:
        return {}
    (step,) = effect.parameters
    return {
        f'{r.drive}.{effect.id}.{step.name}': Value(
            r.step, step.unit, r.step - r.error, r.step + r.error
        )
        for r in readings
    }


def _ranked(
    explainer: Explainer, base: Explanation, at: EffectAt, probability: float, e: Explanation
) -> Ranked:
    floor = explainer.attribution.floor
    gap = float(np.sqrt(np.mean(e.check / explainer.check_count * floor**2)))
    prefix = f'{at.effect}.' if at.where == 'all' else f'{at.where}.{at.effect}.'
    own = {name: v for name, v in _values(explainer, e).items() if name.startswith(prefix)}
    return Ranked(at, probability, gap, explainer.share(base, e), own)


def _per_drive(
    explainer: Explainer, found: Explained, blocks: Blocks, floor: Floor
) -> dict[str, DriveGap]:
    case = explainer.attribution.case
    models = case.models((), case.check)
    out = {}
    for d, name in enumerate(case.drives):
        torque = np.concatenate(
            [m.measured[d, mask[d]] for m, mask in zip(models, case.check.masks, strict=True)]
        )
        share = (
            blocks.share_closed(0, len(found.chain) - 1, floor, drive=d).value
            if len(found.chain) > 1
            else 0.0
        )
        out[name] = DriveGap(
            before=float(np.sqrt(blocks.squares[0, d])),
            after=float(np.sqrt(blocks.squares[-1, d])),
            noise_floor=float(floor.per_drive[d]),
            share_closed=share,
            torque_rms=float(np.sqrt(np.mean(torque**2))),
        )
    return out


def _sentence(
    verdict: Verdict, explainer: Explainer, found: Explained, floor: Floor, unit: str
) -> str:
    size = explainer.size(found.chain[0])
    level = f'{float(np.mean(floor.per_drive)):.4g} {unit}'
    if verdict.effect == NONE and size < explainer.rules.material:
        return (
            f'Nothing is missing: the largest gap of a drive is {size:.2f} times the noise floor '
            f'({level}), below the {explainer.rules.material:.2g} that counts.'
        )
    if verdict.effect == NONE:
        return (
            f'Nothing can be named: the largest gap of a drive is {size:.2f} times the floor '
            f'({level}), and no effect of the catalogue closes enough of it to count.'
        )
    if verdict.effect == UNKNOWN and not found.complete:
        return (
            f'The run was cut short: a gap of {size:.2f} times the noise floor ({level}) is '
            'there, and nothing was found yet that explains it.'
        )
    if verdict.effect == UNKNOWN:
        tried = len(found.rounds[0].gains) if found.rounds else 0
        best = max((explainer.share(found.chain[0], w.model) for w in verdict.ranking), default=0)
        closed = 100 * max(verdict.closed, best, 0)
        return (
            f'Something is missing that is not in the catalogue: the gap on '
            f'{", ".join(verdict.where)} is {size:.2f} times the noise floor, and the best of '
            f'{tried} candidates closes {closed:.0f} % of it.'
        )
    effect = get_effect(verdict.effect)
    steps = ''.join(
        f' {r.drive} reads its position in steps of {1e6 * r.step:.3g} um: what its controller '
        'commands beside the motion in the log has that period. Its course cannot be repeated by '
        'any simulation, so it does not count as closed.'
        for r in verdict.readings
    )
    more = ''.join(f', then {get_effect(a.effect).title} on {a.where}' for a in verdict.also)
    rest = ''
    if found.remaining >= explainer.rules.unknown:
        rest = f' What is left, {found.remaining:.2f} times the floor, is none of the catalogue.'
    return (
        f'{effect.title} on {", ".join(verdict.where)}{more}: closes {100 * verdict.closed:.0f} % '
        f'of a gap of {size:.2f} times the noise floor.{steps or rest}'
    )
