# SPDX-License-Identifier: Apache-2.0
"""Which effect explains the gap: each at each place, fitted with the nominal parameters.

One round screens all candidates against the present residual, fits the promising ones jointly on
the fit part, and scores every fit on the part held out. `explain` runs rounds until nothing is
left or nothing gains.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import get_effect
from ros2_ident.gap.case import Case
from ros2_ident.gap.local_fit import difference_jacobian, local_fit, LocalFit
from ros2_ident.gap.screen import screen, seen_in_log, Start
from ros2_ident.models import DriveModel, EffectAt
from ros2_ident.search import GeneticSearch, GeneticSettings

Array = npt.NDArray[np.float64]
# Joint fits of one round: at most, and at least whatever the screen says of them.
_FITS = 12
_LEAST = 4
# Every start of a round gets so many iterations; who then explains less than this share of what
# the best does gets no more.
_HEAT, _BEHIND = 4, 0.5
_THREADS = 2
# Mean square, beyond the noise's, from which a controller misses the log.
_LAW_OFF = 0.05


@dataclass(frozen=True)
class Explanation:
    """A model fitted on the fit part, and what it leaves.

    Attributes:
        effects: Effects in the order they came in.
        theta: (N,) parameters, those of the effects last.
        fit: (D,) sum of squared residuals on the fit part, in units of the floor.
        check: (D,) the same on the part held out.
        law: (D,) mean square, in units of the floor, by which the recorded effort misses what the
            controllers make of the recorded motion, on both parts; zeros where it is not known.
        jacobian: (R, N) of the weighted residual by the parameters' shares of their box.
        residual: (R,) weighted residual of the fit part: the outputs', then the controllers'.
        check_residual: (R',) weighted residual of the outputs on the part held out.
    """

    effects: tuple[EffectAt, ...]
    theta: Array
    fit: Array
    check: Array
    law: Array
    jacobian: Array = field(repr=False)
    residual: Array = field(repr=False)
    check_residual: Array = field(repr=False)

    @property
    def loss(self) -> float:
        """Sum of squared weighted residuals of the outputs on both parts."""
        return float(self.fit.sum() + self.check.sum())

    @property
    def cost(self) -> float:
        """Sum of squared weighted residuals of the outputs on the fit part."""
        return float(self.fit.sum())


@dataclass(frozen=True)
class Round:
    """One round of the search for an effect.

    Attributes:
        base: What was there before.
        gains: Screened gain of every candidate, best start each.
        visible: For every candidate what the log would show of it, see `screen.Start`.
        fitted: The joint fits, the best first.
    """

    base: Explanation
    gains: dict[EffectAt, float]
    visible: dict[EffectAt, float]
    fitted: tuple[Explanation, ...]


@dataclass(frozen=True)
class _Left:
    """What a fit leaves: its residual (R,), a basis of its Jacobian (R, N), and its inverse."""

    residual: Array
    basis: Array
    inverse: Array

    @classmethod
    def of(cls, residual: Array, jacobian: Array) -> '_Left':
        basis, triangle = np.linalg.qr(jacobian)
        return cls(residual, basis, np.linalg.pinv(triangle, rcond=1e-9) @ basis.T)


class Attribution:
    """Fits of one case.

    Args:
        case: Machine and recordings.
        floor: (D,) noise floor of each drive, output unit.
        stopped: Asked often; True ends everything with the best so far.
        on_step: Told the share of the present round that is done and a sentence.
    """

    def __init__(
        self,
        case: Case,
        floor: Array,
        *,
        stopped: Callable[[], bool] = lambda: False,
        on_step: Callable[[float, str], None] = lambda share, text: None,
    ) -> None:
        self.case = case
        self.floor = floor
        self.stopped = stopped
        self.on_step = on_step
        self.weight = 1.0 / floor[case.fit.drive]
        self.check_weight = 1.0 / floor[case.check.drive]
        # (L,) weights of the controllers' rows; none until `watch_law`.
        self.law_weight = np.empty(0)

    def watch_law(self, base: Explanation) -> Explanation:
        """From here on let fits also see what the controllers make of the recorded motion.

        No machine is in these rows, so they tell what sits in a controller or behind a sensor from
        what happens in the machine. They count less where the stated law is far from the log:
        there it may be another law, and must not drown the outputs.

        Args:
            base: The fit without effects.

        Returns:
            The same fit with the controllers' rows. Its `law` is what they miss at best without
            effects, so what an effect mends is not what a parameter could.
        """
        if not self.case.fit.seen:
            return base
        models = self.case.models(base.effects, self.case.fit)
        low, high = self._box(models)
        law = self._least_law(models, base)
        scale = self.floor * np.sqrt(1.0 + law)
        self.law_weight = 1.0 / scale[self.case.fit.law_drive]
        unit = (base.theta - low) / (high - low)
        residual, jacobian = difference_jacobian(self._evaluate(models), unit, low, high - low)
        return replace(base, law=law, residual=residual, jacobian=jacobian)

    def _least_law(self, models: Sequence[DriveModel], base: Explanation) -> Array:
        """Return (D,) what each drive's controller misses at least, whatever the parameters."""
        law = base.law.copy()
        off = np.flatnonzero(law > 1.0 + _LAW_OFF)
        if not off.size:
            return law
        part, held_out = self.case.fit, self.case.models(base.effects, self.case.check)
        low, high = self._box(models)
        for d in off:
            own = part.law_drive == d

            def missed(theta: Array, own: npt.NDArray[np.bool_] = own) -> Array:
                return part.law_residual(models, np.atleast_2d(theta))[:, own]

            found = local_fit(missed, base.theta, low, high, stopped=self.stopped)
            law[d] = min(law[d], self._law(models, held_out, found.theta)[d])
        return law

    def _law(
        self, models: Sequence[DriveModel], held_out: Sequence[DriveModel], theta: Array
    ) -> Array:
        """Return (D,) mean square of what the controllers miss on both parts, floors squared."""
        case = self.case
        missed = np.concatenate(
            [
                case.fit.law_residual(models, theta[None])[0],
                case.check.law_residual(held_out, theta[None])[0],
            ]
        )
        drive = np.concatenate([case.fit.law_drive, case.check.law_drive])
        count = len(case.drives)
        samples = np.maximum(np.bincount(drive, minlength=count), 1)
        out: Array = np.bincount(drive, (missed / self.floor[drive]) ** 2, count) / samples
        return out

    # ------------------------------------------------------------------ fits

    def _evaluate(self, models: Sequence[DriveModel]) -> Callable[[Array], Array]:
        part = self.case.fit

        def outputs(theta: Array) -> Array:
            return part.residual(models, np.atleast_2d(theta)) * self.weight[None]

        def both(theta: Array) -> Array:
            law = part.law_residual(models, np.atleast_2d(theta)) * self.law_weight[None]
            return np.concatenate([outputs(theta), law], axis=1)

        return both if self.law_weight.size else outputs

    def _box(self, models: Sequence[DriveModel]) -> tuple[Array, Array]:
        low = np.array([p.low for p in models[0].parameters])
        high = np.array([p.high for p in models[0].parameters])
        return low, high

    def nominal(self, settings: GeneticSettings, seed: int) -> Explanation:
        """Identify the nominal parameters: genetic algorithm, then local fits from survivors."""
        models = self.case.models((), self.case.fit)
        low, high = self._box(models)
        evaluate = self._evaluate(models)
        search = GeneticSearch(len(low), settings, seed)

        def costs_of(points: Array) -> Array:
            if self.stopped():
                return np.full(len(points), np.inf)
            costs = np.mean(evaluate(low + (high - low) * points) ** 2, axis=1)
            return np.where(np.isfinite(costs), costs, np.inf)

        with ThreadPoolExecutor(_THREADS) as pool:
            while search.stop_reason is None and not self.stopped():
                asked = search.ask()
                slices = [asked[i : i + 16] for i in range(0, len(asked), 16)]
                search.tell(np.concatenate(list(pool.map(costs_of, slices))))
                share = 0.7 * search.generation / settings.generations
                self.on_step(share, 'identifying the nominal parameters')
            starts = self._distinct(search)
            fits = list(
                pool.map(
                    lambda x: local_fit(
                        evaluate, low + (high - low) * x, low, high, stopped=self.stopped
                    ),
                    starts,
                )
            )
        return self._explanation(models, min(fits, key=lambda f: f.loss))

    @staticmethod
    def _distinct(search: GeneticSearch, count: int = 4) -> list[Array]:
        survivors = np.asarray(search.survivors)
        if not len(survivors):
            # Stopped before anything was simulated, or everything diverged.
            return [np.full(search.dimension, 0.5)]
        chosen = [survivors[0]]
        for x in survivors[1:]:
            if len(chosen) < count and min(np.linalg.norm(x - c) for c in chosen) > 0.05:
                chosen.append(x)
        return chosen

    def refit(
        self, effects: Sequence[EffectAt], theta: Array, iterations: int = 12
    ) -> Explanation:
        """Fit a set of effects jointly from a start."""
        models = self.case.models(effects, self.case.fit)
        low, high = self._box(models)
        evaluate = self._evaluate(models)
        found = local_fit(evaluate, theta, low, high, iterations=iterations, stopped=self.stopped)
        return self._explanation(models, found)

    def _better(self, base: Explanation, start: Start) -> Array:
        """Return a screened start, or the base with a trace of the effect if that is better."""
        models = self.case.models((*base.effects, start.candidate), self.case.fit)
        low, high = self._box(models)
        neutral = start.phi.copy()
        for i, p in enumerate(get_effect(start.candidate.effect).parameters):
            if p.role == 'size':
                centre = p.neutral * models[0].effort_share(p.unit)
                neutral[i] = centre + 0.02 * (start.phi[i] - centre)
        points = np.array(
            [np.concatenate([start.theta, start.phi]), np.concatenate([base.theta, neutral])]
        )
        points = np.clip(points, low, high)
        losses = np.mean(self._evaluate(models)(points) ** 2, axis=1)
        best: Array = points[int(np.nanargmin(losses))]
        return best

    def _shown(
        self, base: Explanation, candidates: Sequence[EffectAt]
    ) -> list[tuple[EffectAt, Array]]:
        """Return effects whose size the log itself shows, each with where to start its fit.

        Such an effect bends its own drive's parameters out of all proportion: they start from what
        the other drives have.
        """
        model = self.case.models((), self.case.fit)[0]
        new = [c for c in candidates if c not in base.effects]
        seen = [(c, own) for c in new if (own := seen_in_log(c, model)) is not None]
        if not seen:
            return []
        names = [p.name for p in self.case.models(base.effects, self.case.fit)[0].parameters]
        out = []
        for candidate, own in seen:
            theta = base.theta.copy()
            for bare in self.case.machine.bounds:
                at = [i for i, name in enumerate(names) if name.endswith(f'.{bare}')]
                mine = [i for i in at if names[i] == f'{candidate.where}.{bare}']
                if mine and len(at) > 1:
                    theta[mine] = base.theta[[i for i in at if i not in mine]].mean()
            out.append((candidate, np.concatenate([theta, own])))
        return out

    def _explanation(self, models: Sequence[DriveModel], found: LocalFit) -> Explanation:
        """Return a fit of the models of the fit part, scored on the part held out as well."""
        case, effects = self.case, models[0].effects
        held_out = case.models(effects, case.check)
        theta = found.theta[None]
        check = case.check.residual(held_out, theta)[0] * self.check_weight
        check = np.where(np.isfinite(check), check, 1e6)
        count = len(case.drives)
        outputs = found.residual[: len(self.weight)]
        return Explanation(
            effects,
            found.theta,
            np.bincount(case.fit.drive, outputs**2, count).astype(float),
            np.bincount(case.check.drive, check**2, count).astype(float),
            self._law(models, held_out, found.theta),
            found.jacobian,
            found.residual,
            check,
        )

    # ------------------------------------------------------------------ rounds

    def starts(
        self,
        base: Explanation,
        candidate: EffectAt,
        left: _Left,
        outputs: Array,
    ) -> list[Start]:
        """Screen one candidate against what the base leaves; `outputs` is their rows' basis."""
        models = self.case.models((*base.effects, candidate), self.case.fit)
        low, high = self._box(models)
        count = len(base.theta)
        return screen(
            candidate,
            models,
            self._evaluate(models),
            base.theta,
            left.residual,
            left.basis,
            left.inverse,
            outputs,
            low[:count],
            high[:count],
        )

    def look(
        self, base: Explanation, candidates: Sequence[EffectAt]
    ) -> dict[EffectAt, list[Start]]:
        """Screen every candidate on top of a base; those already in it are left out."""
        new = [c for c in candidates if c not in base.effects]
        rows = len(self.weight)
        left = _Left.of(base.residual, base.jacobian)
        outputs = left.basis
        if len(base.residual) > rows:
            outputs = np.linalg.qr(base.jacobian[:rows])[0]
        done = 0

        def one(candidate: EffectAt) -> list[Start]:
            nonlocal done
            if self.stopped():
                return []
            found = self.starts(base, candidate, left, outputs)
            done += 1
            self.on_step(
                0.5 * done / len(new), f'looking at {candidate.effect} on {candidate.where}'
            )
            return found

        with ThreadPoolExecutor(_THREADS) as pool:
            return {c: s for c, s in zip(new, pool.map(one, new), strict=True) if s}

    def round(self, base: Explanation, candidates: Sequence[EffectAt], fits: int = _FITS) -> Round:
        """Try every candidate on top of a base.

        Args:
            base: What is explained so far.
            candidates: Effects at places; those already in the base are left out.
            fits: Joint fits to run.

        Returns:
            The screened gains and the joint fits, the best on both parts first.
        """
        screened = self.look(base, candidates)
        chosen: list[tuple[EffectAt, Start | Array]] = [
            (start.candidate, start) for start in self._promising(screened, fits)
        ]
        chosen += self._shown(base, candidates)
        finished = 0

        def heat(one: tuple[EffectAt, Start | Array]) -> Explanation | None:
            nonlocal finished
            if self.stopped():
                return None
            candidate, start = one
            theta = self._better(base, start) if isinstance(start, Start) else start
            found = self.refit((*base.effects, candidate), theta, _HEAT)
            finished += 1
            self.on_step(
                0.5 + 0.3 * finished / len(chosen),
                f'fitted {candidate.effect} on {candidate.where}',
            )
            return found

        def finish(e: Explanation) -> Explanation:
            return e if self.stopped() else self.refit(e.effects, e.theta)

        with ThreadPoolExecutor(_THREADS) as pool:
            begun = [e for e in pool.map(heat, chosen) if e is not None]
            best = self._leaders(begun)
            most = max((base.cost - e.cost for e in best), default=0.0)
            ahead = [e for e in best if base.cost - e.cost >= _BEHIND * most]
            done = {e.effects[-1]: e for e in pool.map(finish, ahead)}
        fitted = [done.get(e.effects[-1], e) for e in best]
        return Round(
            base,
            {c: s[0].gain for c, s in screened.items()},
            visibility(screened),
            tuple(sorted(fitted, key=lambda e: e.loss)),
        )

    @staticmethod
    def _leaders(fits: Sequence[Explanation]) -> list[Explanation]:
        """Return the best fit of each newest effect."""
        best: dict[EffectAt, Explanation] = {}
        for e in fits:
            key = e.effects[-1]
            if key not in best or e.cost < best[key].cost:
                best[key] = e
        return list(best.values())

    def _promising(self, screened: dict[EffectAt, list[Start]], fits: int) -> list[Start]:
        """Return the starts worth a joint fit: best candidates, relatives, second starts."""
        order = sorted(screened, key=lambda c: -screened[c][0].gain)
        worth = 0.1 * screened[order[0]][0].gain if order else 0.0
        chosen = [
            c
            for rank, c in enumerate(order[:fits])
            if rank < _LEAST or screened[c][0].gain > worth
        ]
        for leader in order[:2]:
            effect = get_effect(leader.effect)
            for c in order:
                other = get_effect(c.effect)
                related = c.effect in effect.confusable or other.family == effect.family
                if c not in chosen and related and c.where in (leader.where, 'all'):
                    chosen.append(c)
        starts = []
        for rank, c in enumerate(chosen):
            several = screened[c][: 3 if rank < 3 else 1]
            starts += [s for s in several if s.gain > 0.5 * several[0].gain or s is several[0]]
        return starts


def visibility(screened: dict[EffectAt, list[Start]]) -> dict[EffectAt, float]:
    """Return for every candidate what the log would show of it, see `screen.Start`."""
    return {c: max(one.visible for one in starts) for c, starts in screened.items()}
