# SPDX-License-Identifier: Apache-2.0
"""Fits of one split: nominal and extended models on the fit part, scored on the part held out.

Every fit is a task of its own, so that threads or workers elsewhere can do them side by side.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gap.hypothesis import Hypothesis, Samples
from ros2_ident.gap.recordings import JointModel, Split
from ros2_ident.gates.scale import MORE
from ros2_ident.models import EffectAt
from ros2_ident.models.trials import LARGE, orders_shown, TRIAL, trials
from ros2_ident.search.jacobian import mean_squares, Slopes
from ros2_ident.search.journal import digest_of
from ros2_ident.search.least_squares import least_squares, Point, within_box

# What explains less than this share of what the best does is not followed. By hand.
PROMISING = 0.5
# Iterations of a fit, at most: it ends by itself in fewer. By hand.
ITERATIONS = 40
# Fits in which weights of the controllers' rows follow what these miss, at most, and what counts
# as no change of it. By hand.
_ROUNDS, _SETTLED = 10, 0.98
# Shares of the way to a screened start, which lies where straight lines lead. A grid.
_WAY = np.array([1.0, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02])


@dataclass(frozen=True)
class Start:
    """Start of a joint fit.

    Attributes:
        effects: The effect at its place; one of several drives at each.
        theta: (N,) parameters fitted so far, moved along with the effect.
        phi: (P,) the effects' own parameters.
        gain: Decrease of the sum of squared weighted residuals that the linearised fit promises.
        visible: RMS, in units of the floor, of what a large effect of this kind (a sixth of its
            range, or a start) leaves after the fitted parameters imitate it as far as they can,
            over the drives it sits on; well below 1 the log cannot show the effect.
    """

    effects: tuple[EffectAt, ...]
    theta: Array
    phi: Array
    gain: float
    visible: float


class Fits:
    """Fits of one split at one noise floor.

    Args:
        split: The recordings.
        floor: (D,) noise floor of each drive, output unit.
        stopped: Asked often; True ends a fit with the best so far.
        missed: (D,) mean square by which the controllers miss the log, output unit squared; None
            where their rows are not looked at, see `watch_law`.
        certain: (D,) square of the floor over the upper end of its 95 % interval; 1 where None.

    Attributes:
        samples: What every fit is judged on.
        weight: (R,) weights of the fit part's outputs.
        check_weight: (R',) weights of the held-out part's.
    """

    def __init__(
        self,
        split: Split,
        floor: Array,
        stopped: Callable[[], bool] = lambda: False,
        missed: Array | None = None,
        certain: Array | None = None,
    ) -> None:
        self.split = split
        self.floor = floor
        parts = (np.bincount(x.drive, minlength=floor.size) for x in (split.fit, split.check))
        fit, check = (count.astype(float) for count in parts)
        self.samples = Samples(fit, check, np.ones_like(floor) if certain is None else certain)
        self.stopped = stopped
        self.weight = 1.0 / floor[split.fit.drive]
        self.check_weight = 1.0 / floor[split.check.drive]
        self.missed = missed

    @property
    def law_weight(self) -> Array:
        """(L,) weights of the controllers' rows.

        They count less where the stated law is far from the log: there it may be another law, and
        must not drown the outputs.
        """
        if self.missed is None:
            return np.empty(0)
        weight: Array = 1.0 / np.sqrt(self.floor**2 + self.missed)[self.split.fit.law_drive]
        return weight

    def __getstate__(self) -> dict[str, object]:
        """Leave out `stopped`: only the process that asks knows when to stop."""
        return {k: v for k, v in self.__dict__.items() if k != 'stopped'}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore all but `stopped`."""
        self.__dict__.update(state, stopped=lambda: False)

    def watch_law(self, base: Hypothesis) -> Hypothesis:
        """From here on let fits also see the controllers' error on the recorded motion.

        No machine is in these rows, so they tell what sits in a controller or behind a sensor from
        what happens in the machine.

        Args:
            base: The fit without effects.

        Returns:
            The same fit with the controllers' rows.
        """
        if not self.split.fit.seen:
            return base
        split = self.split
        joint = split.fit.with_effects(base.effects)
        held_out = split.check.with_effects(base.effects)
        drive = np.concatenate([split.fit.law_drive, split.check.law_drive])
        count = len(split.drives)
        samples = np.maximum(np.bincount(drive, minlength=count), 1)

        def watched(theta: Array) -> Array:
            missed = np.concatenate([x.law_residual(theta)[0] for x in (joint, held_out)])
            out: Array = np.bincount(drive, missed**2, count) / samples
            return out

        self.missed = watched(base.theta)
        if split.fit.models[0].outputs[0].quantity != 'effort':
            # Gains that positions alone leave open are those that the logged efforts tell.
            for _ in range(_ROUNDS):
                base = self.refit(base.effects, base.theta)
                before, self.missed = self.missed, watched(base.theta)
                if (self.missed > _SETTLED * before).all():
                    break
        box = joint.box
        at = Point.at(self.evaluate(joint), box, box.inside(base.theta))
        return replace(base, residual=at.residual, jacobian=at.jacobian)

    def restated(self, e: Hypothesis, old: 'Fits') -> Hypothesis:
        """Return a fit made at another noise floor in units of this one."""
        square = (old.floor / self.floor) ** 2
        weight = np.concatenate([self.weight, self.law_weight])
        factor = (weight / np.concatenate([old.weight, old.law_weight]))[: len(e.residual)]
        return replace(
            e,
            fit=e.fit * square,
            check=e.check * square,
            samples=self.samples,
            jacobian=e.jacobian * factor[:, None],
            residual=e.residual * factor,
            check_residual=e.check_residual * (self.check_weight / old.check_weight),
        )

    def evaluate(self, joint: JointModel) -> Callable[[Array], Array]:
        """Return a fit's objective: (S, N) candidates to (S, R) weighted residuals."""
        law_weight = self.law_weight

        def outputs(theta: Array) -> Array:
            return joint.residual(np.atleast_2d(theta)) * self.weight[None]

        def both(theta: Array) -> Array:
            law = joint.law_residual(theta) * law_weight[None]
            return np.concatenate([outputs(theta), law], axis=1)

        return both if law_weight.size else outputs

    @cached_property
    def _near(self) -> Slopes | None:
        """Slopes of the nominal model; None where it is linear in no parameter."""
        plain = self.split.fit.with_effects(())
        if not all(model.thinned for model in plain.models):
            return None
        middle = Point.at(self.evaluate(plain), plain.box, np.full(len(plain.low), 0.5))
        # To the box's ends: of a line any step tells the slope, and the largest rounds least.
        slopes = replace(middle, step=0.5).jacobian
        return Slopes(slopes, np.ones(len(plain.low), dtype=bool))

    def refit(
        self, effects: Sequence[EffectAt], theta: Array, iterations: int = ITERATIONS
    ) -> Hypothesis:
        """Fit a set of effects jointly from a start (N,)."""
        joint = self.split.fit.with_effects(effects)
        found = least_squares(
            self.evaluate(joint), theta, joint.low, joint.high,
            iterations=iterations, stopped=self.stopped, known=joint.box.known, near=self._near,
        )  # fmt: skip
        return self.hypothesis(joint, found)

    def ended_at(self, effects: Sequence[EffectAt], unit: Array) -> Hypothesis:
        """Return the fit that ended at (N,) shares of the box."""
        joint = self.split.fit.with_effects(effects)
        return self.hypothesis(joint, Point.at(self.evaluate(joint), joint.box, unit))

    def key(self, base: Hypothesis | None = None) -> bytes:
        """Return a digest of a fit's inputs beside its effects and start.

        Args:
            base: What it is tried on top of.
        """
        split = self.split
        before = () if base is None else (base.effects, base.theta, base.residual)
        held_out = len(split.fit.models), len(split.check.models), split.held_out
        return digest_of(*held_out, self.floor, self.law_weight, *before)

    def hypothesis(self, joint: JointModel, found: Point) -> Hypothesis:
        """Return a fit of the models of the fit part, scored on the part held out as well."""
        split = self.split
        held_out = split.check.with_effects(joint.effects)
        check = held_out.residual(found.theta[None])[0] * self.check_weight
        check = np.where(np.isfinite(check), check, 1e6)
        count = len(split.drives)
        outputs = found.residual[: len(self.weight)]
        return Hypothesis(
            joint.effects,
            found.theta,
            np.bincount(split.fit.drive, outputs**2, count).astype(float),
            np.bincount(split.check.drive, check**2, count).astype(float),
            self.samples,
            found.jacobian,
            found.residual,
            check,
            found.unit,
        )


class Trials:
    """The tasks of one round: effects tried on top of a base. Other processes get it as a pickle.

    Args:
        fits: Who fits.
        base: The fit they are tried on top of.
    """

    def __init__(self, fits: Fits, base: Hypothesis) -> None:
        self.fits, self.base = fits, base
        # (R, N) orthonormal basis of the Jacobian, and (N, N) the rest of it.
        self.basis, self.triangle = np.linalg.qr(base.jacobian)
        # (R', N) basis of the Jacobian's rows that are the outputs'.
        self.outputs, rows = self.basis, len(fits.weight)
        if len(base.residual) > rows:
            self.outputs = np.linalg.qr(base.jacobian[:rows])[0]

    def prepare(self) -> None:
        """Compile the simulation of every fit, or read it from the cache."""
        joint = self.fits.split.fit.with_effects(())
        self.fits.evaluate(joint)(0.5 * (joint.low + joint.high))

    def starts(self, candidate: EffectAt, follow: bool = True) -> list[Start]:
        """Screen one candidate: one start for each group of its trials, the most promising first.

        How the output changes, less what the parameters fitted already can imitate, is compared
        with the residual; where nothing shall `follow`, only what is visible is told.
        """
        if self.fits.stopped():
            return []
        base, basis, outputs = self.base, self.basis, self.outputs
        joint = self.fits.split.fit.with_effects((*base.effects, candidate))
        model = joint.models[0]
        theta, residual, count = base.theta, base.residual, len(base.theta)
        low, high = joint.low[:count], joint.high[:count]
        groups = trials(candidate, model, self._orders_of(candidate, joint))
        if not groups:
            return []
        parameters = model.scaled(candidate)
        neutral = np.array([p.neutral for p in parameters])
        size = np.array([p.role == 'size' for p in parameters])
        points = np.array([point for group in groups for point in group])
        values = self.fits.evaluate(joint)(
            np.hstack([np.repeat(theta[None], len(points), axis=0), points])
        )
        changes = (residual[None] - values).T
        free = residual - basis @ (basis.T @ residual)
        nonlinear = any(p.role == 'size' and p.starts for p in parameters)
        enlarge = 1.0 if nonlinear else LARGE / TRIAL
        samples = len(outputs) / (1 if candidate.where == 'all' else len(model.places))
        starts = []
        ends = np.cumsum([len(group) for group in groups])[:-1]
        for columns, vectors in zip(
            np.split(changes, ends, axis=1), np.split(points, ends), strict=True
        ):
            if not np.isfinite(columns).all():
                continue
            rest = columns - basis @ (basis.T @ columns)
            if not (rest**2).sum() > 1e-9:
                continue
            left = columns[: len(outputs)]
            left = left - outputs @ (outputs.T @ left)
            visible = enlarge * float(np.sqrt((left**2).sum(axis=0).max() / samples))
            if not follow:
                starts.append(Start((candidate,), theta, vectors[0], 0.0, visible))
                continue
            factor = np.linalg.lstsq(rest, free, rcond=1e-9)[0]
            if len(vectors) == 1 and nonlinear:
                # A trial far from neutral stands for itself; the straight line through it is no
                # guide far away: by hand, beyond three times or a fiftieth.
                factor = np.clip(factor, 0.02, 3.0)
            phi = vectors[0].copy()
            phi[size] = neutral[size]
            phi = phi + factor @ np.where(size, vectors - neutral, 0.0)
            clipped = np.clip(phi, joint.low[count:], joint.high[count:])
            # What the bounds cut off is lost; with several sizes the largest cut counts.
            moved, kept = ((x - neutral)[size] for x in (phi, clipped))
            cuts = np.abs(kept) / np.maximum(np.abs(moved), 1e-300)
            ratio = float(np.min(cuts, where=moved != 0.0, initial=1.0))
            factor = factor * (ratio if np.sign(moved) @ np.sign(kept) > 0 else 0.0)
            gain = float(free @ free - ((free - rest @ factor) ** 2).sum())
            there = self._within(basis.T @ (residual - columns @ factor))
            moved_along = low + there * (high - low)
            own = np.where(size, clipped, phi)
            starts.append(Start((candidate,), moved_along, own, gain, visible))
        return sorted(starts, key=lambda s: -s.gain)

    def _within(self, left: Array) -> Array:
        """Return (N,) shares of the box that take a residual away, by its part (N,) in the basis.

        Within it: one that is cut off alone would leave those behind that trade with it.
        """
        unit = np.clip(self.base.unit[: len(left)], 0.0, 1.0)
        return within_box(self.triangle, -left, unit)[0]

    def _orders_of(self, candidate: EffectAt, joint: JointModel) -> tuple[float, ...]:
        """Return orders of a drive's turn to try, where something is left there."""
        drives, residual = self.fits.split.drives, self.base.residual
        if candidate.where not in drives:
            return ()
        own = self.fits.split.fit.drive == drives.index(candidate.where)
        if np.mean(residual[: own.size][own] ** 2) < MORE:
            return ()
        evaluate = self.fits.evaluate(joint)

        def change(points: Array) -> Array:
            base = np.repeat(self.base.theta[None], len(points), axis=0)
            return residual - evaluate(np.hstack([base, points]))

        free = residual - self.basis @ (self.basis.T @ residual)
        rows = np.full(free.size, True)
        return orders_shown(joint.models[0], [candidate], [rows], change, free, self.basis)[0]

    def fit(
        self,
        effects: tuple[EffectAt, ...],
        iterations: int,
        theta: Array,
        phi: Array | None = None,
    ) -> Hypothesis | None:
        """Fit effects jointly; None where time is up.

        Args:
            effects: All of them, those of the base first.
            iterations: At most.
            theta: (N,) start; where there is `phi`, of what is in the base.
            phi: (P,) screened start of the others.
        """
        if self.fits.stopped():
            return None
        start = theta if phi is None else self._better(effects, theta, phi)
        return self.fits.refit(effects, start, iterations)

    def _better(self, effects: tuple[EffectAt, ...], theta: Array, phi: Array) -> Array:
        """Return the best point on the way from the base to a screened start."""
        base, joint = self.base, self.fits.split.fit.with_effects(effects)
        begin, end = (np.concatenate([x, phi]) for x in (base.theta, theta))
        begin = joint.without(begin, effects[len(base.effects) :])
        points = np.clip(begin + _WAY[:, None] * (end - begin), joint.low, joint.high)
        best: Array = points[int(np.argmin(mean_squares(self.fits.evaluate(joint)(points))))]
        return best
