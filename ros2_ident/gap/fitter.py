# SPDX-License-Identifier: Apache-2.0
"""Which effect explains the gap: each at each place, fitted with the nominal parameters.

One round screens all candidates against the present residual, fits the promising ones jointly on
the fit part, and scores every fit on the part held out. `selection` runs rounds until nothing is
left or nothing gains.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.gap.fits import Fits, ITERATIONS, PROMISING, Start, Trials
from ros2_ident.gap.hypothesis import Hypothesis, Round
from ros2_ident.gap.recordings import Split
from ros2_ident.gates.law import Law
from ros2_ident.identify.hidden import MATERIAL, MOST, residuals_at, rows_of, slopes_of, whitening
from ros2_ident.identify.problem import Problem
from ros2_ident.models import EffectAt
from ros2_ident.models.trials import limits_shown, share_of_limit
from ros2_ident.search import Progress, Threads, Workers
from ros2_ident.search.evaluators import RunTasks
from ros2_ident.search.fit import fit, FitSettings
from ros2_ident.search.journal import Journal, Within

# Joint fits of one round: at most, and at least whatever the screen says of them. By hand.
_FITS = 12
_LEAST = 4
# Every start of a round that the screen chose gets so many iterations; what is far behind then
# gets no more. By hand.
_HEAT = 4


class Fitter:
    """Rounds of fits of one split.

    Args:
        split: The recordings.
        floor: (D,) noise floor of each drive, output unit.
        stopped: Asked often; True ends everything with the best so far.
        on_step: Told the share of the present round that is done and a sentence.
        workers: Who fits; threads of this process, one for each processor, where None.
        journal: Gets where every fit ended, and knows those of an earlier run.
        certain: As of `Fits`.

    Attributes:
        fits: The fits at the present noise floor.
        laws: The drives' control laws as the log shows them.
    """

    def __init__(
        self,
        split: Split,
        floor: Array,
        *,
        stopped: Callable[[], bool] = lambda: False,
        on_step: Callable[[float, str], None] = lambda share, text: None,
        workers: Workers | None = None,
        journal: Journal | None = None,
        certain: Array | None = None,
    ) -> None:
        self.journal = journal or Journal()
        self.split = split
        self.stopped = stopped
        self.on_step = on_step
        self.workers = workers or Threads()
        self.laws: Mapping[str, Law] = {}
        self.fits = Fits(split, floor, stopped, certain=certain)

    @property
    def limits(self) -> dict[str, float]:
        """Size of the effort at which control laws show drives to be limited."""
        shown = {drive: law.limit for drive, law in self.laws.items()}
        return {drive: limit for drive, limit in shown.items() if math.isfinite(limit)}

    def refit(self, effects: Sequence[EffectAt], theta: Array) -> Hypothesis:
        """Fit a set of effects jointly from a start (N,)."""
        task = self.fits.key(), tuple(effects), theta
        return self._known(*task) or self._noted(self.fits.refit(effects, theta), *task)

    def _known(self, fits: bytes, effects: Sequence[EffectAt], *more: object) -> Hypothesis | None:
        """Return a fit that an earlier run has ended, where its cost comes out again."""
        count = len(self.split.fit.with_effects(effects).low)
        wanted = {'unit': Within((count,), 0.0, 1.0), 'cost': Within()}
        kept = self.journal.get(wanted, fits, effects, *more)
        if kept is None:
            return None
        e = self.fits.ended_at(effects, kept['unit'])
        return e if e.cost == kept['cost'] else None

    def _noted(self, e: Hypothesis, *task: object) -> Hypothesis:
        """Write down where a fit ended, unless it was stopped on its way."""
        if not self.stopped():
            self.journal.put({'unit': e.unit, 'cost': e.cost}, *task)
        return e

    def _run(
        self, run: RunTasks, key: bytes, tasks: Sequence[tuple[Any, ...]]
    ) -> Iterator[Hypothesis | None]:
        """Run fits of `Trials.fit` on the workers; take finished ones from the journal."""
        kept = [self._known(key, *task) for task in tasks]
        told = run('fit', [t for t, k in zip(tasks, kept, strict=True) if k is None])
        for before, task in zip(kept, tasks, strict=True):
            e = before or next(told)
            yield e if before or e is None else self._noted(e, key, *task)

    def standing(self, before: Hypothesis, after: Hypothesis) -> float:
        """Return how many standard errors of coloured noise a step stands out, on all data.

        Fits weigh samples one by one. Slow noise drifts, and a constant, a spring or a slope then
        takes away much of its square without being there. So this is generalised least squares
        along the change, under noise of the colour of what is left; parameters may follow.

        Reference:
            Seber and Wild (2003), Nonlinear Regression, chapter 6.
        """
        first, second = (self.split.whole.with_effects(e.effects) for e in (before, after))
        rows = rows_of(second.models, MOST // len(after.theta))
        left, jacobian = slopes_of(second, after.theta, rows)
        change = residuals_at(first, rows)(before.theta[None])[0] - left
        whiten = whitening(left, rows, len(self.split.drives))
        basis = np.linalg.qr(whiten(jacobian[:, : len(before.theta)].T).T)[0]
        along, whole = whiten(change), whiten(change + left)
        along = along - basis @ (basis.T @ along)
        return float(along @ whole) / max(float(np.linalg.norm(along)), 1e-300)

    def renew(
        self,
        floor: Array,
        certain: Array,
        chain: Sequence[Hypothesis],
        rounds: Sequence[Round],
    ) -> tuple[list[Hypothesis], list[Round]]:
        """Go on at another noise floor; return the fits so far in units of it."""
        old = self.fits
        self.fits = Fits(self.split, floor, self.stopped, old.missed, certain)
        again = partial(self.fits.restated, old=old)
        renewed = []
        for r in rounds:
            fitted = sorted(map(again, r.fitted), key=lambda e: e.loss)
            renewed.append(replace(r, base=again(r.base), fitted=tuple(fitted)))
        return [again(e) for e in chain], renewed

    def limited(
        self, candidates: Sequence[EffectAt], settings: FitSettings, seed: int
    ) -> Hypothesis | None:
        """Return the fit with the limits that control laws show; None without any.

        A fit without them is bent by what a drive does while it is limited, so this is no step
        from there: the nominal parameters are searched again.
        """
        model = self.split.fit.models[0]
        shown = {
            c: share(self.limits[c.where])
            for c in candidates
            if c.where in self.limits and (share := share_of_limit(c, model)) is not None
        }
        return self.nominal(settings, seed, shown) if shown else None

    def nominal(
        self, settings: FitSettings, seed: int, known: Mapping[EffectAt, Array] | None = None
    ) -> Hypothesis:
        """Identify the nominal parameters on the fit part, as an identification does.

        Args:
            settings: Of the search.
            seed: Of the search.
            known: Effects that are there, each with its (P,) parameters, held by the search.
        """
        known = known or {}
        part = self.split.fit
        joint = part.with_effects([*known])
        own = np.concatenate([np.empty(0), *known.values()])
        names = [p.name for p in joint.parameters[len(joint.parameters) - own.size :]]
        compared = [m.restricted(there) for m, there in zip(joint.models, part.masks, strict=True)]

        def report(progress: Progress) -> None:
            share = progress.evaluations / max(progress.budget, 1)
            self.on_step(0.9 * share, 'identifying the nominal parameters')

        cancel: Any = SimpleNamespace(is_set=self.stopped)
        problem = Problem(
            compared, part.labels, part.conditions, fixed=dict(zip(names, own, strict=True))
        )
        found = fit(
            problem,
            settings,
            seed,
            cancel=cancel,
            on_progress=report,
            workers=self.workers,
            journal=self.journal,
            first=problem.suggested,
            known=problem.box.known,
        )
        theta = np.concatenate([found.theta, own])
        if not np.isfinite(theta).all():
            # Stopped before anything was simulated, or everything diverged.
            theta = 0.5 * (joint.low + joint.high)
        return self.refit([*known], theta)

    def _shown(
        self, base: Hypothesis, candidates: Sequence[EffectAt]
    ) -> list[tuple[EffectAt, Array]]:
        """Return effects whose size log or model show, each with where to start its fit.

        Such an effect biases its own drive's parameters, so that these start from what
        the other drives have.
        """
        missed = base.fit / base.samples.fit - 1.0
        worst = self.split.drives[int(missed.argmax())] if missed.max() >= MATERIAL**2 else ''
        joint = self.split.fit.with_effects(base.effects)
        seen = [
            (c, start)
            for c in candidates
            if c not in base.effects and c.where == worst
            for start in limits_shown(c, joint.each(base.theta))
        ]
        if not seen:
            return []
        nominal = len(self.split.fit.with_effects(()).parameters)
        places = [p.name.partition('.') for p in joint.parameters[:nominal]]
        out = []
        for candidate, own in seen:
            theta = base.theta.copy()
            for column, (place, _, bare) in enumerate(places):
                others = [i for i, (p, _, b) in enumerate(places) if b == bare and p != place]
                if bare and place == candidate.where and others:
                    theta[column] = base.theta[others].mean()
            out += [(candidate, np.concatenate([start, own])) for start in (theta, base.theta)]
        return out

    # ------------------------------------------------------------------ rounds

    def look(
        self, base: Hypothesis, candidates: Sequence[EffectAt], follow: bool = True
    ) -> dict[EffectAt, list[Start]]:
        """Screen every candidate on top of a base; arguments as of `Trials.starts`.

        Those already in it are left out.
        """
        with self.workers.tasks(Trials(self.fits, base)) as run:
            return self._screened(run, base, candidates, follow)

    def _screened(
        self, run: RunTasks, base: Hypothesis, candidates: Sequence[EffectAt], follow: bool = True
    ) -> dict[EffectAt, list[Start]]:
        new = [at for c in candidates if (at := _next(c, base.effects))]
        found: dict[EffectAt, list[Start]] = {}
        told = run('starts', [(c, follow) for c in new])
        for done, (candidate, starts) in enumerate(zip(new, told, strict=True), 1):
            if starts:
                found[candidate] = starts
            self.on_step(
                0.5 * done / len(new), f'looking at {candidate.effect} on {candidate.where}'
            )
        return found

    def round(self, base: Hypothesis, candidates: Sequence[EffectAt]) -> Round:
        """Try every candidate on top of a base.

        Args:
            base: What is explained so far.
            candidates: Effects at places; those already in the base are left out.

        Returns:
            The screened gains and the joint fits, the best on both parts first.
        """
        leaders: dict[tuple[EffectAt, ...], Hypothesis] = {}
        done: dict[tuple[EffectAt, ...], Hypothesis] = {}
        with self.workers.tasks(Trials(self.fits, base)) as run:
            screened = self._screened(run, base, candidates)
            promising = [*self._promising(screened), *self._alike(base, screened)]
            own, key = base.effects, self.fits.key(base)
            tasks: list[tuple[Any, ...]] = [
                ((*own, *start.effects), _HEAT, start.theta, start.phi) for start in promising
            ]
            # One that the log shows starts far from a fit that it bent.
            shown = self._shown(base, candidates)
            tasks += [((*own, at), ITERATIONS, x) for at, x in shown]
            for number, e in enumerate(self._run(run, key, tasks), 1):
                # Of several minima the one that the part held out bears, too.
                if e and e.loss < (leaders[e.effects].loss if e.effects in leaders else np.inf):
                    leaders[e.effects] = e
                share = 0.5 + 0.3 * number / len(tasks)
                self.on_step(share, f'fitted {_named(tasks[number - 1][0][len(own) :])}')
            best = [*leaders.values()]
            most = max((base.cost - e.cost for e in best), default=0.0)
            ahead = [e for e in best if base.cost - e.cost >= PROMISING * most]
            for e in self._run(run, key, [(e.effects, ITERATIONS, e.theta) for e in ahead]):
                if e is not None:
                    done[e.effects] = e
                    self.on_step(0.9, f'refining {_named(e.effects[len(own) :])}')
        fitted = sorted((done.get(e.effects, e) for e in best), key=lambda e: e.loss)
        return Round(base, visibility(screened), tuple(fitted))

    def _alike(self, base: Hypothesis, screened: dict[EffectAt, list[Start]]) -> list[Start]:
        """Return effects on all drives where each promises to count, if together they lead.

        Sizes and shapes are each drive's own; the strongest comes last.
        """
        least = dict(zip(self.split.drives, MATERIAL**2 * base.samples.fit, strict=True))
        by_name: dict[str, list[Start]] = {}
        for at, (best, *_) in screened.items():
            if best.gain >= least.get(at.where, np.inf):
                by_name.setdefault(at.effect, []).append(best)
        alone = max((s[0].gain for s in screened.values()), default=0.0)
        out = []
        for parts in by_name.values():
            parts.sort(key=lambda s: s.gain)
            together = Start(
                effects=tuple(at for s in parts for at in s.effects),
                theta=base.theta + sum(s.theta - base.theta for s in parts),
                phi=np.concatenate([s.phi for s in parts]),
                gain=sum(s.gain for s in parts),
                visible=max(s.visible for s in parts),
            )
            if len(parts) > 1 and together.gain > alone:
                out.append(together)
        most = max((s.gain for s in out), default=0.0)
        return [s for s in out if s.gain >= PROMISING * most]

    def _promising(self, screened: dict[EffectAt, list[Start]]) -> list[Start]:
        """Return the starts worth a joint fit: best candidates, relatives, second starts.

        A tenth of the best one's gain, two leaders and the second starts of three: by hand.
        """
        order = sorted(screened, key=lambda c: -screened[c][0].gain)
        worth = 0.1 * screened[order[0]][0].gain if order else 0.0
        chosen = [
            c
            for rank, c in enumerate(order[:_FITS])
            if rank < _LEAST or screened[c][0].gain > worth
        ]
        for leader in order[:2]:
            effect = get_effect(leader.effect)
            relatives = {*effect.confusable, *(p.limit for p in effect.parameters)}
            for c in order:
                related = c.effect in relatives or get_effect(c.effect).family == effect.family
                if c not in chosen and related and c.where in (leader.where, 'all'):
                    chosen.append(c)
        starts = []
        for rank, c in enumerate(chosen):
            several = screened[c][: 3 if rank < 3 else 1]
            least = PROMISING * several[0].gain
            starts += [s for s in several if s.gain > least or s is several[0]]
        return starts


def _next(candidate: EffectAt, effects: Sequence[EffectAt]) -> EffectAt | None:
    """Return a candidate or, where some of it are among the effects, the next; None for none."""
    at = candidate
    while at in effects:
        further = get_effect(at.effect).further
        if not further:
            return None
        at = replace(at, effect=further)
    return at


def visibility(screened: dict[EffectAt, list[Start]]) -> dict[EffectAt, float]:
    """Return every candidate's visibility in the log, see `fits.Start`."""
    return {c: max(one.visible for one in starts) for c, starts in screened.items()}


def _named(effects: Sequence[EffectAt]) -> str:
    """Return effects at their places in words."""
    return ' and '.join(f'{at.effect} on {at.where}' for at in effects)
