# SPDX-License-Identifier: Apache-2.0
"""From the selected effects to the diagnosis as a value."""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.gap.bootstrap import BlockBootstrap, Interval
from ros2_ident.gap.coordinates import motion_of
from ros2_ident.gap.fits import Fits
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.recordings import Split
from ros2_ident.gap.result import at_bound, Diagnosis, DriveGap, Facts, Ranked, Step, Trace, Value
from ros2_ident.gap.selection import Selector
from ros2_ident.gap.suspects.encoder_steps import EncoderSteps
from ros2_ident.gap.verdict import NONE, RankedFit, Verdict
from ros2_ident.gap.where.localise import Finding
from ros2_ident.gates import Gate
from ros2_ident.gates.scale import MORE
from ros2_ident.models import EffectAt
from ros2_ident.prediction import CHECK, IDENTIFIED, LOG, of_description, predicted, Prediction


def assemble(
    selector: Selector,
    found: Selection,
    verdict: Verdict,
    gates: Sequence[Gate],
    where: tuple[Finding, ...],
    hidden: tuple[EffectAt, ...],
    seconds: float,
    seed: int,
) -> Diagnosis:
    """Return the diagnosis.

    Args:
        selector: Who ran the rounds.
        found: What came of them.
        verdict: What follows from it.
        gates: Results of the checks before.
        where: Where the gap lies.
        hidden: Effects that the motion cannot show.
        seconds: Time taken, s.
        seed: Of the resampling.
    """
    floor, split = selector.floor, selector.split
    chain = found.chain if verdict.named else found.chain[:1]
    final = chain[-1]
    model = split.fit.with_effects(final.effects).models[0]
    blocks = _blocks(selector, found, seed)
    labels = ['nominal', *(at.title for at in found.chain[-1].effects)]
    steps = tuple(Step(label, blocks.rms(i)) for i, label in enumerate(labels))
    last = len(found.chain) - 1
    share = blocks.share_closed(0, last, floor) if last else Interval(0.0, math.nan, math.nan)
    # What was judged on blocks held out is reported from all samples, as by an identification.
    first, every = selector.on_all(found.chain[0])
    known = selector.on_all(final)[0] if final.effects else first
    evidence = selector.noise_of(known).evidence if found.complete else None
    per_drive, whole = _per_drive(selector, found, blocks)
    ends, correlation = selector.ends(known, evidence, every)
    values = _values(selector, known, ends) | _steps(verdict.encoders)
    values |= {
        c.key: Value(c.value, c.unit, c.low, c.high)
        for c in verdict.facts.constants
        if math.isfinite(c.stated)
    }
    nominal = dict(zip(split.fit.with_effects(()).names, first.theta, strict=True))
    moved = {
        name: (values[name].value - v) / v
        for name, v in nominal.items()
        if name in values and v != 0.0
    }
    return Diagnosis(
        effect=verdict.effect,
        where=verdict.where,
        probability=verdict.probability,
        also=verdict.also,
        confusable=tuple(_ranked(selector, found.chain[0], w) for w in verdict.confusable),
        ranking=tuple(_ranked(selector, found.chain[0], w) for w in verdict.ranking),
        unit=model.unit,
        steps=steps,
        floor=floor,
        share_closed=share,
        held_out=split.held_out,
        evidence={
            'size': found.chain[0].size,
            'remaining': found.remaining,
            'closed': verdict.closed,
            'material': selector.rules.material,
            'unexplained': selector.rules.unknown,
            'share_of_output': whole,
        },
        per_drive=per_drive,
        localisation=where,
        parameters=values,
        correlation=tuple(map(tuple, correlation.tolist())),
        moved=moved,
        nominal=nominal,
        gates=tuple(gates),
        not_testable=hidden,
        complete=found.complete,
        seconds=seconds,
        seed=seed,
        traces=_traces(split, found),
        facts=_facts(selector, found, verdict, gates),
        prediction=_predicted(selector, chain, verdict),
    )


def _blocks(selector: Selector, found: Selection, seed: int) -> BlockBootstrap:
    """Return what the fits of a chain leave on data held out, resampled."""
    part = selector.split.check
    rows = [part.rows(e.check_residual / selector.fits.check_weight) for e in found.chain]
    cycle = selector.split.fit.models[0].cycle
    return BlockBootstrap(rows, cycle, seed=seed, starts=part.starts)


def may_close_nothing(selector: Selector, found: Selection, seed: int) -> bool:
    """Whether the 95 % interval of the share that the effects found close reaches 0.

    On data held out; where these show no gap they cannot tell.
    """
    base, final, last = found.chain[0], found.chain[-1], len(found.chain) - 1
    drive = int((base.gap - final.gap).argmax())
    if not last or base.held_out[drive] < selector.rules.material**2:
        return False
    return _blocks(selector, found, seed).share_closed(0, last, selector.floor).low <= 0.0


def _facts(selector: Selector, found: Selection, verdict: Verdict, gates: Sequence[Gate]) -> Facts:
    split, floor, base = selector.split, selector.floor, found.chain[0]
    model = split.fit.models[0]
    slow_noise = {
        name: math.sqrt(value**2 - low**2)
        for name, value, low in zip(split.drives, floor.per_drive, floor.low, strict=True)
        if value > MORE * low and (verdict.named or verdict.effect == NONE)
    }
    best = max((w.model.closes(base) for w in verdict.ranking), default=0.0)
    return replace(
        verdict.facts,
        cause=verdict.cause(complete=found.complete),
        worst=split.drives[int(base.gap.argmax())],
        effort_unit=model.effort_unit,
        travel=model.travel,
        hidden=slow_noise,
        steps={r.drive: (r.step, r.unit) for r in verdict.encoders},
        contradictions=tuple(i for i, gate in enumerate(gates) if gate.contradicts),
        tried=len(found.rounds[0].visible) if found.rounds else 0,
        best=max(verdict.closed, best, 0.0),
        ties=found.ties,
    )


def _traces(split: Split, found: Selection) -> tuple[Trace, ...]:
    """Return every recording beside the nominal fit and the last one."""
    base, last = found.chain[0], found.chain[-1]
    parts = [split.fit, split.check] if split.check_bag else [split.fit]
    traces = []
    for part in parts:
        before, after = (part.with_effects(e.effects).each(e.theta) for e in (base, last))
        for nominal, (extended, own), mask in zip(before, after, part.masks, strict=True):
            traces.append(
                Trace(
                    held_out=part is split.check,
                    motion=motion_of(*nominal),
                    measured=extended.measured,
                    extended=extended.simulate(own[None])[0],
                    fitted=mask if part is split.fit else np.zeros_like(mask),
                )
            )
    return tuple(traces)


def _predicted(selector: Selector, chain: Sequence[Hypothesis], verdict: Verdict) -> Prediction:
    """Return how far free runs come from the recordings judged on, effect by effect.

    Where a number of the machine file is wrong, with what fits in its place.
    """
    split = selector.split
    models = [(e.effects[-1].title if e.effects else IDENTIFIED, split, e) for e in chain]
    machine, wrong = split.fit.models[0].machine, next(iter(verdict.facts.constants), None)
    one = wrong is not None and len(chain) == 1 and math.isfinite(wrong.stated)
    if wrong and one and machine and machine.stated(wrong.key):
        stated = split.stating(wrong.key, wrong.value)
        fit = Fits(stated, selector.floor.per_drive).refit((), chain[0].theta)
        models.append((f'{wrong.key} {wrong.value:.4g}', stated, fit))
    apart = split.held_out == CHECK
    stages = []
    for label, own, e in models:
        joint = (own.check if apart else own.fit).with_effects(e.effects)
        stages.append((label, joint.each(e.theta)))
    return predicted(CHECK if apart else LOG, [*of_description(stages[0][1]), *stages])


def _values(selector: Selector, e: Hypothesis, ends: Array) -> dict[str, Value]:
    """Return the parameters of a fit; `ends` (4, N) as of `Selector.ends`."""
    joint = selector.split.fit.with_effects(e.effects)
    # What the log does not say the box does: an interval ends where its parameter was searched.
    rows = np.clip(ends, joint.low, joint.high).T.tolist()
    # Those of the effects come last. A bound of the machine file counts where, to first order and
    # beside the other bounds, it keeps more of the gap open than forms of a law differ by; below
    # nothing there is nothing.
    sizes = [p for at in e.effects for p in joint.models[0].scaled(at)]
    unit = np.round(e.unit, 3)
    edge = (unit == 1.0) | ((unit == 0.0) & (joint.low != 0.0))
    inverse = np.linalg.pinv(e.jacobian.T @ e.jacobian, hermitian=True)
    beyond = (inverse @ (e.jacobian.T @ e.residual)) ** 2
    gap = max(e.cost - float(e.samples.fit.sum()), 0.0)
    counts = beyond > selector.rules.alike * gap * np.diag(inverse)
    held = edge & counts & selector.rules.open(e)
    nominal = len(rows) - len(sizes)
    own = zip(sizes, e.theta[nominal:].tolist(), strict=True)
    ended = [*held[:nominal].tolist(), *(at_bound(*x) for x in own)]
    return {
        p.name: Value(v, p.unit, low, high, at, less, more, p.low, p.high, p.kind)
        for p, v, at, (low, high, less, more) in zip(
            joint.parameters, e.theta.tolist(), ended, rows, strict=True
        )
    }


def _steps(encoders: Sequence[EncoderSteps]) -> dict[str, Value]:
    out = {}
    for r in encoders:
        (step,) = get_effect(r.at.effect).parameters
        out[r.name] = Value(
            r.step, r.unit, r.step - r.error, r.step + r.error,
            lower_bound=step.low, upper_bound=step.high,
        )  # fmt: skip
    return out


def _ranked(selector: Selector, base: Hypothesis, one: RankedFit) -> Ranked:
    at, e = one.at, one.model
    gap = float(np.sqrt(np.mean(e.check / e.samples.check * selector.fits.floor**2)))
    values = _values(selector, e, selector.ends(e, None)[0])
    own = {name: v for name, v in values.items() if name.startswith(at.prefix)}
    return Ranked(at, one.probability, gap, e.closes(base), own)


def _per_drive(
    selector: Selector, found: Selection, blocks: BlockBootstrap
) -> tuple[dict[str, DriveGap], float]:
    """Return each drive's gap, and the nominal one over the measured output of all, RMS."""
    split, floor, last = selector.split, selector.floor, len(found.chain) - 1
    gap = np.maximum(found.chain[0].gap, 0.0) * floor.per_drive**2
    output = np.empty(len(split.drives))
    counted = blocks.above(floor, 0, last)
    out = {}
    for d, name in enumerate(split.drives):
        held_out = split.check.measured(d)
        measured = np.concatenate([*split.fit.measured(d), *held_out])
        output[d] = max(float(np.mean(measured**2)), 1e-300)
        change = max(float(np.var(measured)), 1e-300)
        out[name] = DriveGap(
            before=float(np.sqrt(blocks.squares[0, d])),
            after=float(np.sqrt(blocks.squares[last, d])),
            noise_floor=float(floor.per_drive[d]),
            share_closed=blocks.share_closed(0, last, floor, drive=d).value if last else 0.0,
            torque_rms=float(np.sqrt(np.mean(np.concatenate(held_out) ** 2))),
            share_of_output=float(np.sqrt(gap[d] / output[d])),
            counted=bool(counted[d]),
            share_of_change=float(np.sqrt(gap[d] / change)),
        )
    return out, float(np.sqrt(gap.sum() / output.sum()))
