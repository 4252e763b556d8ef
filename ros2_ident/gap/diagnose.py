# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of one machine's recordings, from the nominal fit to the advice."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import hashlib
import math
from pathlib import Path
import time
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect, shown_by
from ros2_ident.errors import ErrorCode
from ros2_ident.gap.assemble import assemble, may_close_nothing
from ros2_ident.gap.contradictions import (
    of_events,
    of_gates,
    of_the_file,
    of_what_is_left,
    unexplained,
)
from ros2_ident.gap.coordinates import motion_of
from ros2_ident.gap.fitter import Fitter, visibility
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.noise_floor import predictability
from ros2_ident.gap.recordings import JointModel, Part, recordings_from, recordings_of, Split
from ros2_ident.gap.result import Diagnosis
from ros2_ident.gap.rules import Rules, TIE
from ros2_ident.gap.selection import Selector
from ros2_ident.gap.suspects.constants import factors_of_all_drives, fitted_constants
from ros2_ident.gap.suspects.encoder_steps import EncoderSteps, find_encoder_steps, made_by_steps
from ros2_ident.gap.suspects.payload import find_pick_ups
from ros2_ident.gap.verdict import judge, REFUSED, UNKNOWN, Verdict, WRONG_MODEL
from ros2_ident.gap.where.events import bursts, not_asked
from ros2_ident.gap.where.localise import Finding, localise
from ros2_ident.gates import GateReport
from ros2_ident.gates.examine import examine_models
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.problem import at_rest, sources
from ros2_ident.machine.machine import Machine
from ros2_ident.models import EffectAt, Model
from ros2_ident.recording import Dataset
from ros2_ident.search import GeneticSettings, Workers
from ros2_ident.search.fit import FitSettings
from ros2_ident.search.jacobian import diverged
from ros2_ident.search.journal import Journal
from ros2_ident.search.least_squares import least_squares

# The nominal search need not be sharp: joint fits follow.
SEARCH = FitSettings(
    genetic=GeneticSettings(initial_population=512, survivors=8, children=8, generations=8)
)
_RULES = Rules()

# Share of the work from which on the time to go is told; before, simulations may be compiled. By
# hand.
KNOWN = 0.05
# Rounds for each doubling of the gap over the noise floor, and the end as a share of a round: as
# timed on tripods, axes and arms.
_ROUNDS, _END = 1.2, 0.3


@dataclass(frozen=True)
class DiagnoseProgress:
    """How far a diagnosis is.

    Attributes:
        stage: What is being done.
        fraction: Share of the time that has gone, 0 to 1; never falls.
        best_so_far: The verdict if it ended now, as a sentence; empty for none yet.
        elapsed: Seconds since the start.
        eta: Seconds expected until the end, NaN where unknown.
    """

    stage: str
    fraction: float
    best_so_far: str
    elapsed: float
    eta: float


class Clock:
    """Time, cancel and progress of a diagnosis, and how long it will still take.

    The nominal fit and the noise take shares of the time that are known roughly. Each round that
    follows is taken to be as long as all that stood before the first; how many there will be is
    guessed from the size of the gap.

    Args:
        seconds: What it may take; 0 for no limit.
        cancelled: Whether it shall end.
        on_progress: Told how far it is.
        now: Seconds that never step back.
    """

    def __init__(
        self,
        seconds: float,
        cancelled: Callable[[], bool],
        on_progress: Callable[[DiagnoseProgress], None] | None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.begin = now()
        self.seconds = seconds
        self.cancelled = cancelled
        self.on_progress = on_progress
        self.best = ''
        self.stage = 0.0, 1.0  # begin and end, as shares of the time
        self._now = now
        self._done = 0.0
        self._past = 0

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._now() - self.begin

    def stopped(self) -> bool:
        """Whether it shall end."""
        return self.cancelled() or 0.0 < self.seconds < self.elapsed

    def rounds(self, size: float) -> None:
        """Begin a round, or the end.

        Args:
            size: The gap that is left, in units of the noise floor; 0 for the end.
        """
        self._past += 1
        left = max(1.0, _ROUNDS * math.log2(max(1.0, size))) if size else 0.0
        total = self._past + left + _END
        self.stage = self._past / total, min(self._past + 1.0, total) / total

    def step(self, share: float, text: str) -> None:
        """Report a share of the present stage."""
        if self.on_progress is None:
            return
        low, high = self.stage
        fraction = low + (high - low) * share
        eta = self.elapsed * (1.0 - fraction) / fraction if fraction > KNOWN else math.nan
        if self.seconds:
            eta = min(eta, max(0.0, self.seconds - self.elapsed))
        if not math.isnan(eta):
            self._done = max(self._done, self.elapsed / max(self.elapsed + eta, 1e-9))
        self.on_progress(DiagnoseProgress(text, self._done, self.best, self.elapsed, eta))

    def ended(self) -> None:
        """Report the end."""
        if self.on_progress is not None:
            self.on_progress(DiagnoseProgress('done', 1.0, self.best, self.elapsed, 0.0))


def diagnose(
    machine: Machine | None = None,
    fit: Sequence[Dataset] = (),
    check: Sequence[Dataset] = (),
    *,
    model: Model | Sequence[Model] | None = None,
    check_model: Model | Sequence[Model] = (),
    drives: Sequence[str] | None = None,
    without: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    effects: Sequence[EffectAt] = (),
    output: str | None = None,
    labels: Sequence[str] = (),
    check_labels: Sequence[str] = (),
    conditions: Conditions | None = None,
    seed: int = 1,
    seconds: float = 0.0,
    cancelled: Callable[[], bool] = lambda: False,
    on_progress: Callable[[DiagnoseProgress], None] | None = None,
    workers: Workers | None = None,
    checkpoint: str | Path | None = None,
) -> Diagnosis:
    """Say where the gap lies, which effect causes it, and how far it closes with it.

    Args:
        fit: Part to fit on.
        check: Part held out; without them every second block of the fit recordings is held
            out.
        model: Instead of machine and recordings: a model of the recording to fit on, or one for
            each of several; see `models.protocol`.
        check_model: The same for recordings held out.
        drives: Drives to look at; all by default.
        without: Ids of effects to leave out of the catalogue.
        fixed: Parameters not to be identified.
        effects: Effects that are known to be there: part of the nominal model.
        output: Quantity whose gap is looked at: `effort`, `position` or `velocity`; what the
            machine's kind compares where None.
        labels: For each recording in `fit`, the bag it came from.
        check_labels: For each recording in `check`, likewise.
        conditions: How the recordings differ.
        seed: Of the search and of the resampling.
        seconds: Time budget; 0 for none. At its end the best so far is the answer.
        cancelled: Asked often; True ends with the best so far.
        on_progress: Told how far it is.
        workers: Who simulates; threads of this process, one for each processor, where None.
        checkpoint: File that is written on the way, and from which the same diagnosis goes on
            where it was cut off, with the same result. It stays: delete it once the result is
            safe.

    Returns:
        The diagnosis.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DIVERGED, INVALID_GOAL, UNKNOWN_PARAMETER or, where
            the checkpoint is another one's, BAD_VALUES, with the remedy.
    """
    for name in without:
        get_effect(name)
    clock = Clock(seconds, cancelled, on_progress)
    if model is not None:
        first, second = recordings_from(model), recordings_from(check_model)
    elif machine is None or not fit:
        raise ErrorCode.NO_DATA.error(
            'there is no recording to fit on; give a bag with drive data'
        )
    else:
        machine, drives = at_rest(machine, fit, drives)
        first, second = (
            recordings_of(
                machine,
                data,
                drives=drives,
                fixed=fixed,
                effects=effects,
                output=output,
                labels=names,
                beside=beside,
            )
            for data, names, beside in ((fit, labels, check), (check, check_labels, fit))
        )
    if conditions is not None:
        conditions.check([*first.labels, *second.labels])
        if conditions.each and second.models:
            raise ErrorCode.INVALID_GOAL.error(
                'a parameter with a value of its own in every bag has none in a bag held out; '
                'leave the bag to judge on out, or give it with the others: blocks of each are '
                'held out then'
            )
    key = ''
    if checkpoint is not None:
        asked = machine, drives, tuple(without), fixed, effects, conditions, seed, SEARCH
        key = _key(asked, first, second)
    with Journal(checkpoint, key) as journal:
        passes = _Passes(conditions, without, seed, clock, workers, journal)
        found = passes.run(first, second)
    clock.ended()
    return found


def _key(asked: object, first: Part, second: Part) -> str:
    """Return a digest of all that a diagnosis depends on."""
    total = hashlib.sha256(f'{sources()}{asked!r}'.encode())
    for part in (first, second):
        total.update(repr(part.labels).encode())
        for model in part.models:
            data = getattr(model, 'data', None)
            total.update(data.digest if isinstance(data, Dataset) else b'')
            total.update(repr((model.parameters, model.outputs)).encode())
            total.update(np.ascontiguousarray(model.measured).data)
    return total.hexdigest()


@dataclass(frozen=True)
class _Pass:
    """State of one pass over the recordings."""

    selector: Selector
    base: Hypothesis
    report: GateReport
    encoders: tuple[EncoderSteps, ...]

    @property
    def material(self) -> bool:
        """Whether the nominal fit leaves something that counts."""
        return _RULES.open(self.base)


@dataclass(frozen=True)
class _Passes:
    """A pass over the recordings; a second one where the first was fitted to chance."""

    conditions: Conditions | None
    without: Sequence[str]
    seed: int
    clock: Clock
    workers: Workers | None
    journal: Journal

    def run(self, fit: Part, check: Part) -> Diagnosis:
        """Diagnose; where both recordings have to take turns, block by block, once more so."""
        split = Split(fit, check, self.conditions)
        begun = self._begin(split)
        # Without a gap no effect can stand for a number that the controllers' log contradicts.
        if begun.report.unfit or (begun.report.blocked and not begun.material):
            found, verdict = of_gates(begun.selector.split.drives, begun.base, begun.report)
            return self._composed(begun, *self._of_the_file(begun, found, verdict))
        if begun.material and not self.clock.stopped():
            # What the part fitted on does not show of a parameter is chance, and wrong on the
            # other: a fit to all tells whether anything is missing.
            whole = self._fitted_to_all(begun)
            left = _left_anywhere(begun.selector, whole)
            much = _RULES.closed * begun.base.size
            if begun.selector.split.check_bag and left < max(much, _RULES.material):
                begun = self._begin(split.by_blocks())
            elif left < _RULES.material:
                begun = replace(begun, base=whole)
        watched = begun.selector.fits.missed is not None
        if watched and begun.material and not self.clock.stopped():
            # What effects are compared with is fitted to what they are fitted to, rows of the
            # controllers among it. Whether anything is missing, outputs alone tell.
            begun = replace(begun, base=begun.selector.refit((), begun.base.theta))
        return self._composed(begun, *self._selected(begun))

    def _begin(self, split: Split) -> _Pass:
        """Fit the nominal parameters, estimate the floor, ask the gates."""
        clock = self.clock
        clock.stage = 0.0, 0.2
        clock.step(0.0, 'identifying the nominal parameters')
        guess = np.full(len(split.drives), split.noise or 1.0)
        base = Fitter(split, guess, **self._told()).nominal(SEARCH, self.seed)
        joint = split.whole.with_effects(())
        if diverged(joint.residual(base.theta[None])[0]):
            if split.check_bag:
                # As in a second pass, see `run`.
                return self._begin(split.by_blocks())
            remedy = examine_models(joint.models).headline
            raise ErrorCode.DIVERGED.error(
                'every candidate diverges on this log; '
                + (remedy or 'check units, gains and geometry in the machine file')
            )
        clock.stage = 0.2, 0.35
        clock.step(0.0, 'telling noise from what the motion predicts')
        known, encoders = shown_by('reading_steps'), tuple[EncoderSteps, ...]()
        if known and known.id in {at.effect for at in split.candidates(self.without)}:
            encoders = () if clock.stopped() else find_encoder_steps(split, base.theta)
        steps = made_by_steps(encoders, split, base.theta)
        first, floor = base, predictability(joint, base.theta, clock.stopped, steps)
        decided = split.decided(base.theta, floor.per_drive)
        if decided is not split and not clock.stopped():
            split, joint = decided, decided.whole.with_effects(())
            base = Fitter(split, floor.per_drive, **self._told()).refit((), base.theta)
            first, floor = base, predictability(joint, base.theta, clock.stopped, steps)
        split = self._carrying(split, joint, base.theta, floor.per_drive)
        selector = Selector(split, floor, steps=steps, **self._told())
        base = selector.fits.watch_law(selector.refit((), base.theta))
        report = GateReport()
        if not clock.stopped():
            joint = split.fit.with_effects(())
            report = examine_models(joint.models, joint.own(0, base.theta)[0], floor.per_drive)
        selector.laws = {law.drive: law for law in report.laws}
        selector.knows(first, floor)
        return _Pass(selector, base, report, encoders)

    def _carrying(self, split: Split, joint: JointModel, theta: Array, floor: Array) -> Split:
        """Return the split that knows when a payload is carried, where the log shows that.

        The nominal fit has part of the payload in its masses; without it the instants are sharper.
        """
        held = find_pick_ups(joint, theta, floor)
        if not held or self.clock.stopped():
            return split
        # The tool's mass in the machine file may be with the load or without: its bounds tell.
        comes, goes = (self._loaded(split, h, theta, floor) for h in (held, _away(held)))
        turned = goes.loss + TIE < comes.loss
        best = goes if turned else comes
        sharper = find_pick_ups(joint, best.theta[: theta.size], floor)
        if sharper:
            sharper = _away(sharper) if turned else sharper
            if self._loaded(split, sharper, best.theta[: theta.size], floor).loss < best.loss:
                return split.carrying(sharper)
        return split.carrying(_away(held) if turned else held)

    def _loaded(
        self, split: Split, held: tuple[Array, ...], theta: Array, floor: Array
    ) -> Hypothesis:
        """Return the fit with a load that is carried when each recording (K,) says so."""
        there = split.carrying(held)
        (load,) = (at for at in there.candidates() if get_effect(at.effect).shown_by == 'load')
        return Fitter(there, floor, **self._told()).refit((load,), np.append(theta, 0.0))

    def _told(self) -> dict[str, Any]:
        """Return the arguments that all fits share: workers, journal, cancel, progress."""
        return {
            'stopped': self.clock.stopped,
            'on_step': self.clock.step,
            'workers': self.workers,
            'journal': self.journal,
        }

    def _fitted_to_all(self, begun: _Pass) -> Hypothesis:
        """Return the nominal fit to all blocks, those held out among them."""
        fits, whole = begun.selector.fits, begun.selector.split.whole.with_effects(())
        weight = 1.0 / fits.floor[begun.selector.split.whole.drive]

        def weighted(theta: Array) -> Array:
            return whole.residual(np.atleast_2d(theta)) * weight

        found = least_squares(
            weighted, begun.base.theta, whole.low, whole.high, stopped=self.clock.stopped,
            known=whole.box.known,
        )  # fmt: skip
        return fits.ended_at((), found.unit)

    def _selected(self, begun: _Pass) -> tuple[Selection, Verdict]:
        """Select the effects and turn them into a verdict."""
        clock, selector = self.clock, begun.selector
        clock.rounds(begun.base.size if begun.material else 0.0)

        def note(base: Hypothesis, e: Hypothesis) -> None:
            names = ', '.join(at.title for at in e.effects)
            share = 100 * e.closes(base)
            clock.best = f'{names}: closes {share:.0f} % of the explainable gap'
            clock.rounds(e.size if _RULES.open(e) else 0.0)

        candidates = selector.split.candidates(self.without)
        limited = selector.limited(candidates, SEARCH, self.seed)
        found = selector.select(begun.base, candidates, note, limited)
        verdict = judge(found, begun.encoders)
        # A limit that the controllers' log shows is there, whatever a constant one closes.
        if not found.limits and may_close_nothing(selector, found, self.seed):
            found = found.nominal()
            verdict = judge(found, begun.encoders)
        if not clock.stopped():
            found, verdict = of_what_is_left(
                selector.split, selector.fits.floor, found, verdict, begun.report, _RULES
            )
            found, verdict = self._of_the_file(begun, found, verdict)
        return found, verdict

    def _of_the_file(
        self, begun: _Pass, found: Selection, verdict: Verdict
    ) -> tuple[Selection, Verdict]:
        """Ask whether a number of the machine file explains as much, where there is a gap."""
        known = verdict.effect == WRONG_MODEL or verdict.facts.limits
        if known or self.clock.stopped() or not begun.base.certain_size:
            return found, verdict
        selector = begun.selector
        constants = fitted_constants(selector.fits, found.chain[0])
        factors = factors_of_all_drives(selector, found) if verdict.named else {}
        return of_the_file(found, verdict, begun.report, constants, factors, _RULES)

    def _composed(self, begun: _Pass, found: Selection, verdict: Verdict) -> Diagnosis:
        """Say where the gap lies, and put everything together."""
        clock, base = self.clock, found.chain[0]
        # Where nothing is missing nothing was tried; what the motion could not have shown is said
        # all the same.
        visible = {}
        if found.rounds:
            visible = found.rounds[0].visible
        elif verdict.effect not in REFUSED:
            candidates = begun.selector.split.candidates(self.without)
            visible = visibility(begun.selector.look(base, candidates, follow=False))
        clock.rounds(0.0)
        clock.step(0.0, 'saying where')
        where: tuple[Finding, ...] = ()
        model = begun.selector.split.fit.models[0]
        if verdict.named and not clock.stopped():
            whole = begun.selector.split.whole
            fits = [whole.with_effects(x.effects).each(x.theta) for x in (base, found.chain[-1])]
            begun = replace(begun, report=unexplained(begun.report, *fits))
        verdict = of_events(verdict, begun.report)
        if verdict.facts.events:
            # What a fit makes of efforts that others added is no finding.
            found = found.nominal()
            where = not_asked(begun.report.asked, begun.selector.floor, model)
        if not clock.stopped():
            if verdict.effect == UNKNOWN and not where:
                joint = begun.selector.split.fit.with_effects(())
                low, high, at = (joint.own(0, x)[0] for x in (joint.low, joint.high, base.theta))
                where = tuple(bursts(joint.models[0], low, high, at, begun.selector.floor))
            where = (*where, *_located(begun, base, self.seed))
        # A large one that leaves less than the first has to take away cannot be found; what was
        # found was seen.
        hidden = tuple(
            at for at, seen in visible.items() if seen < _RULES.step and at not in verdict.named
        )
        return assemble(
            begun.selector,
            found,
            verdict,
            begun.report.gates,
            where,
            hidden,
            clock.elapsed,
            self.seed,
        )


def _away(held: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return for each recording (K,) the share of a load that is away."""
    return tuple(1.0 - share for share in held)


def _located(begun: _Pass, base: Hypothesis, seed: int) -> tuple[Finding, ...]:
    """Return where the gap of the first recording lies; nothing where its motion is unknown."""
    split, fits = begun.selector.split, begun.selector.fits
    joint = split.fit.with_effects(())
    model = joint.models[0]
    if model.data.position is None and model.data.command_position is None:
        return ()
    rows = split.fit.rows(base.residual[: len(fits.weight)] / fits.weight)
    rows = rows[:, : model.measured.shape[1]]
    motion = motion_of(model, joint.own(0, base.theta)[0])
    return localise(motion, rows, begun.selector.floor, seed=seed)


def _left_anywhere(selector: Selector, e: Hypothesis) -> float:
    """Return the size of a nominal fit's gap, where it is judged and on all samples.

    Between blocks that take turns some samples are in neither part, and what happens for a moment
    may happen there.
    """
    whole = selector.split.whole
    rest = whole.rows(whole.with_effects(()).residual(e.theta[None])[0])
    square = np.nanmean(rest**2, axis=1) / selector.floor.per_drive**2
    return max(e.size, float(np.sqrt(max(0.0, square.max() - 1.0))))
