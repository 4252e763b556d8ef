# SPDX-License-Identifier: Apache-2.0
"""Fits of one case: nominal and extended models on the fit part, scored on the part held out.

Every fit is a task of its own, so that threads or workers elsewhere can do them side by side.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ros2_ident.gap.case import Case, Joint
from ros2_ident.gap.screen import screen, Start
from ros2_ident.models import EffectAt
from ros2_ident.search.levenberg import difference_jacobian, local_fit, LocalFit
from ros2_ident.search.noise import NoiseModel, Whitening

Array = npt.NDArray[np.float64]
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
        cost: Sum of squared whitened residuals of the outputs on the fit part.
        loss: The same on both parts.
        law: (D,) mean square, in units of the floor, by which the recorded effort misses what the
            controllers make of the recorded motion, on both parts; zeros where it is not known.
        jacobian: (R, N) of the whitened residual by the parameters' shares of their box.
        residual: (R,) whitened residual of the fit part: the outputs', then the controllers'.
        left: (R',) residual of the outputs on the fit part [output unit].
        check_left: (R'',) the same on the part held out.
    """

    effects: tuple[EffectAt, ...]
    theta: Array
    fit: Array
    check: Array
    cost: float
    loss: float
    law: Array
    jacobian: Array = field(repr=False)
    residual: Array = field(repr=False)
    left: Array = field(repr=False)
    check_left: Array = field(repr=False)


@dataclass(frozen=True)
class Left:
    """What a fit leaves: its residual (R,), a basis of its Jacobian (R, N), and its inverse."""

    residual: Array
    basis: Array
    inverse: Array

    @classmethod
    def of(cls, residual: Array, jacobian: Array) -> 'Left':
        """Return what a fit leaves by its residual (R,) and Jacobian (R, N)."""
        basis, triangle = np.linalg.qr(jacobian)
        return cls(residual, basis, np.linalg.pinv(triangle, rcond=1e-9) @ basis.T)


@dataclass(frozen=True)
class Base:
    """A fit that effects are tried on top of, and what of it every trial needs.

    Attributes:
        fit: The fit.
        left: What it leaves.
        outputs: (R', N) basis of the Jacobian's rows that are the outputs'.
    """

    fit: Explanation
    left: Left
    outputs: Array

    @classmethod
    def of(cls, fit: Explanation, rows: int) -> 'Base':
        """Return a base whose first `rows` rows are the outputs'."""
        left = Left.of(fit.residual, fit.jacobian)
        outputs = left.basis
        if len(fit.residual) > rows:
            outputs = np.linalg.qr(fit.jacobian[:rows])[0]
        return cls(fit, left, outputs)


class Fits:
    """Fits of one case at one noise floor.

    Args:
        case: The recordings.
        noise: The noise of each drive, output unit: what residuals are whitened by.
        stopped: Asked often; True ends a fit with the best so far.

    Attributes:
        floor: (D,) standard deviation of the noise.
        rows: Rows of the fit part's outputs; those of the controllers follow them.
    """

    def __init__(
        self,
        case: Case,
        noise: Sequence[NoiseModel],
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self.case = case
        self.stopped = stopped
        self.floor: Array = np.sqrt([m.variance for m in noise])
        self.rows = len(case.fit.drive)
        self._noise = tuple(noise)
        self._whiten = Whitening(case.fit.runs, noise)
        self._whiten_check = Whitening(case.check.runs, noise)
        # What controllers miss of the log without effects, output unit squared; None until
        # `watch_law`.
        self._unlawful: Array | None = None
        self._whiten_law: Whitening | None = None

    def __getstate__(self) -> dict[str, object]:
        """Leave out what cannot travel: only the process that asks knows when to stop."""
        return {k: v for k, v in self.__dict__.items() if k != 'stopped'}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Take up what travelled."""
        self.__dict__.update(state, stopped=lambda: False)

    # ------------------------------------------------------------------ controllers

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
        joint = self.case.fit.with_effects(base.effects)
        span = joint.high - joint.low
        law = self._least_law(joint, base)
        self._weigh_law(law * self.floor**2)
        unit = (base.theta - joint.low) / span
        residual, jacobian = difference_jacobian(self.evaluate(joint), unit, joint.low, span)
        return replace(base, law=law, residual=residual, jacobian=jacobian)

    def _weigh_law(self, unlawful: Array) -> None:
        self._unlawful = unlawful
        factor = np.sqrt(1.0 + unlawful / self.floor**2)
        noise = [m.scaled(float(f)) for m, f in zip(self._noise, factor, strict=True)]
        self._whiten_law = Whitening(self.case.fit.law_runs, noise)

    def renewed(self, noise: Sequence[NoiseModel]) -> 'Fits':
        """Return the same fits under other noise."""
        new = Fits(self.case, noise, self.stopped)
        if self._unlawful is not None:
            new._weigh_law(self._unlawful)
        return new

    def restated(self, e: Explanation) -> Explanation:
        """Return a fit of other noise in terms of this one, without fitting it again."""
        joint = self.case.fit.with_effects(e.effects)
        span = joint.high - joint.low
        unit = (e.theta - joint.low) / span
        residual, jacobian = difference_jacobian(self.evaluate(joint), unit, joint.low, span)
        found = LocalFit(e.theta, residual, jacobian, float(np.mean(residual**2)), 0)
        stated = self.explanation(joint, found)
        if e.effects or self._unlawful is None:
            return stated
        # What controllers miss at best without effects.
        return replace(stated, law=np.minimum(stated.law, self._unlawful / self.floor**2))

    def _least_law(self, joint: Joint, base: Explanation) -> Array:
        """Return (D,) what each drive's controller misses at least, whatever the parameters."""
        law = base.law.copy()
        held_out = self.case.check.with_effects(base.effects)
        for d in np.flatnonzero(law > 1.0 + _LAW_OFF):
            own = self.case.fit.law_drive == d

            def missed(theta: Array, own: npt.NDArray[np.bool_] = own) -> Array:
                return joint.law_residual(theta)[:, own]

            found = local_fit(missed, base.theta, joint.low, joint.high, stopped=self.stopped)
            law[d] = min(law[d], self._law(joint, held_out, found.theta)[d])
        return law

    def _law(self, joint: Joint, held_out: Joint, theta: Array) -> Array:
        """Return (D,) mean square of what the controllers miss on both parts, floors squared."""
        case = self.case
        missed = np.concatenate([joint.law_residual(theta)[0], held_out.law_residual(theta)[0]])
        drive = np.concatenate([case.fit.law_drive, case.check.law_drive])
        count = len(case.drives)
        samples = np.maximum(np.bincount(drive, minlength=count), 1)
        out: Array = np.bincount(drive, (missed / self.floor[drive]) ** 2, count) / samples
        return out

    # ------------------------------------------------------------------ fits

    def evaluate(self, joint: Joint) -> Callable[[Array], Array]:
        """Return what a fit minimises: (S, N) candidates to (S, R) weighted residuals."""
        whiten_law = self._whiten_law

        def outputs(theta: Array) -> Array:
            return self._whiten(joint.residual(np.atleast_2d(theta)))

        if whiten_law is None:
            return outputs

        def both(theta: Array) -> Array:
            return np.concatenate(
                [outputs(theta), whiten_law(joint.law_residual(theta))], axis=1
            )

        return both

    def refit(
        self, effects: Sequence[EffectAt], theta: Array, iterations: int = 12
    ) -> Explanation:
        """Fit a set of effects jointly from a start (N,)."""
        joint = self.case.fit.with_effects(effects)
        found = local_fit(
            self.evaluate(joint),
            theta,
            joint.low,
            joint.high,
            iterations=iterations,
            stopped=self.stopped,
        )
        return self.explanation(joint, found)

    def explanation(self, joint: Joint, found: LocalFit) -> Explanation:
        """Return a fit of the models of the fit part, scored on the part held out as well."""
        case = self.case
        held_out = case.check.with_effects(joint.effects)
        left = joint.residual(found.theta[None])[0]
        check = held_out.residual(found.theta[None])[0]
        check = np.where(np.isfinite(check), check, 1e6 * self.floor[case.check.drive])
        cost = float(np.sum(found.residual[: self.rows] ** 2))
        return Explanation(
            joint.effects,
            found.theta,
            self._squares(case.fit.drive, left),
            self._squares(case.check.drive, check),
            cost,
            cost + float(np.sum(self._whiten_check(check) ** 2)),
            self._law(joint, held_out, found.theta),
            found.jacobian,
            found.residual,
            left,
            check,
        )

    def _squares(self, drive: npt.NDArray[np.int64], left: Array) -> Array:
        """Return (D,) sums of squares of a residual in units of the floor."""
        return np.bincount(drive, (left / self.floor[drive]) ** 2, len(self.floor)).astype(float)


class Trials:
    """The tasks of one round: effects tried on top of a base. Other processes get it as a pickle.

    Args:
        fits: Who fits.
        base: The fit they are tried on top of.
    """

    def __init__(self, fits: Fits, base: Explanation) -> None:
        self.fits = fits
        self.base = Base.of(base, fits.rows)

    def prepare(self) -> None:
        """Compile, or read from the cache, what every fit needs."""
        joint = self.fits.case.fit.with_effects(())
        self.fits.evaluate(joint)(0.5 * (joint.low + joint.high))

    def starts(self, candidate: EffectAt) -> list[Start]:
        """Screen one candidate against what the base leaves."""
        if self.fits.stopped():
            return []
        base = self.base
        joint = self.fits.case.fit.with_effects((*base.fit.effects, candidate))
        count = len(base.fit.theta)
        return screen(
            candidate,
            joint.models,
            self.fits.evaluate(joint),
            base.fit.theta,
            base.left.residual,
            base.left.basis,
            base.left.inverse,
            base.outputs,
            joint.low[:count],
            joint.high[:count],
        )

    def begin(
        self, candidate: EffectAt, start: Start | Array, iterations: int
    ) -> Explanation | None:
        """Begin the joint fit of one more effect; None where time is up."""
        if self.fits.stopped():
            return None
        theta = self._better(start) if isinstance(start, Start) else start
        return self.fits.refit((*self.base.fit.effects, candidate), theta, iterations)

    def finish(self, begun: Explanation) -> Explanation:
        """Go on with a joint fit to its end."""
        return begun if self.fits.stopped() else self.fits.refit(begun.effects, begun.theta)

    def _better(self, start: Start) -> Array:
        """Return a screened start, or the base with a trace of the effect if that is better."""
        base = self.base.fit
        joint = self.fits.case.fit.with_effects((*base.effects, start.candidate))
        neutral = start.phi.copy()
        for i, p in enumerate(joint.models[0].scaled(start.candidate)):
            if p.role == 'size':
                neutral[i] = p.neutral + 0.02 * (start.phi[i] - p.neutral)
        points = np.array(
            [np.concatenate([start.theta, start.phi]), np.concatenate([base.theta, neutral])]
        )
        points = np.clip(points, joint.low, joint.high)
        losses = np.mean(self.fits.evaluate(joint)(points) ** 2, axis=1)
        best: Array = points[int(np.nanargmin(losses))]
        return best
