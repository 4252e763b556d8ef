# SPDX-License-Identifier: Apache-2.0
"""Effects in whose place something else does as much: parameters, the motion or its noise.

A log of one frequency, speed or direction hardly tells on what a force depends: there position,
speed and acceleration, or the way and the time since a reversal, are functions of one another. A
cause outside the catalogue then looks like an effect that is in it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.gap.coordinates import coordinates, direction, joined, motion_of
from ros2_ident.gap.fits import Fits
from ros2_ident.gap.hypothesis import Hypothesis
from ros2_ident.gap.result import PARAMETERS
from ros2_ident.identify.hidden import MOST, residuals_at, rows_of, slopes_of, whitening
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.model import SMOOTHING
from ros2_ident.recording.motion import fill_gaps, step_of
from ros2_ident.search.least_squares import Point

# What rows do not tell from other columns but for this share is rounding of derivatives.
_ROUNDED = 1e-6
# What laws depend on, and the coordinates and what laws read that follow from it.
_FOLLOW = {
    'position': ('carriage', 'motor angle'),
    'velocity': ('direction', 'coulomb', 'viscous', 'phase'),
    'acceleration': (
        'load', 'torque', 'torque rate', 'jerk', 'recent acceleration',
        'time since a jump of the acceleration', 'other drives',
    ),
    'distance since reversal': ('travel',),
    'time since reversal': ('lagging friction',),
    'time': (),
}  # fmt: skip
_OF = {name: of for of, names in _FOLLOW.items() for name in (of, *names)}


def in_place_of(
    fits: Fits, e: Hypothesis, at: EffectAt
) -> tuple[float, dict[str, tuple[Hypothesis, Hypothesis]]]:
    """Return what something else leaves in an effect's place, as straight lines lead.

    Args:
        fits: The fits that `e` is one of.
        e: The fit that holds it.
        at: The effect.

    Returns:
        The share, RMS, of its change that other values of the parameters do not make. And the fits
        with these (`PARAMETERS`), and with functions of each coordinate of its drives that its law
        does not read beside them, but for what functions of all have in common; each without and
        with the effect.
    """
    split, columns, count = fits.split, e.columns(e.effects.index(at)), len(fits.weight)
    fitted, held_out = (part.with_effects(e.effects) for part in (split.fit, split.check))
    box = fitted.box
    unit = box.inside(fitted.without(e.theta, [at]))
    points = (
        Point.at(fits.evaluate(fitted), box, unit),
        Point.at(lambda theta: held_out.residual(theta) * fits.check_weight, box, unit),
    )
    slopes = [np.delete(point.jacobian, columns, axis=1) for point in points]

    # No function of the motion changes what controllers do with it.
    law = ((0, len(slopes[0]) - count), (0, 0))
    changes = points[0].residual - e.residual, points[1].residual - e.check_residual

    def left(*added: Array) -> Hypothesis:
        one, two = (np.hstack(both) for both in zip(slopes, added, strict=True))
        size = np.linalg.norm(one, axis=0)
        # What only the part held out shows cannot be fitted.
        size = np.where(size > 0.0, size, np.inf)
        factor = np.linalg.lstsq(one / size, points[0].residual, rcond=_ROUNDED)[0] / size
        squares = (
            np.bincount(part.drive, rest[: part.drive.size] ** 2, len(split.drives)).astype(float)
            for part, rest in (
                (split.fit, points[0].residual - one @ factor),
                (split.check, points[1].residual - two @ factor),
            )
        )
        effects = tuple(x for x in e.effects if x != at)
        return replace(e, effects=effects, fit=next(squares), check=next(squares))

    found: dict[str, tuple[Hypothesis, Hypothesis]] = {}
    bends = get_effect(at.effect).bent and not e.limits(at)
    nothing = PARAMETERS, np.empty((count, 0)), slopes[1][:, :0]
    for name, fit, check in (nothing, *_functions(fits, e, at)):
        added = np.pad(fit, law), check
        both = left(*(np.column_stack(x) for x in zip(added, changes, strict=True)))
        less = left(*added)
        # A law that bends does more than a smooth function, unless it ended where it hardly does.
        worse = bends and name == 'position' and less.loss > e.loss
        if not worse and (name not in found or both.loss < found[name][1].loss):
            found[name] = less, both
    return _own_share(fits, e, at), found


def _own_share(fits: Fits, e: Hypothesis, at: EffectAt) -> float:
    """Return the share of an effect's change that other values of the parameters do not make.

    In units of coloured noise: what drifts may be large and tell nothing.
    """
    # Of whole logs: a block's first samples have no past, so that in blocks a drift would count.
    fitted = fits.split.fit.with_effects(e.effects)
    rows = rows_of(fitted.models, MOST // len(e.theta))
    left, jacobian = slopes_of(fitted, e.theta, rows)
    white = whitening(left, rows, len(fits.split.drives))
    change = white(residuals_at(fitted, rows)(fitted.without(e.theta, [at])[None])[0] - left)
    others = np.delete(jacobian, e.columns(e.effects.index(at)), axis=1)
    basis = np.linalg.qr(white(others.T).T)[0]
    own = np.linalg.norm(change - basis @ (basis.T @ change))
    # One that ends where it vanishes is another form of the nominal law.
    return float(own) / max(float(np.linalg.norm(change)), 1e-300)


def noise_does(fits: Fits, e: Hypothesis, at: EffectAt) -> bool:
    """Return whether noise of the recorded motion does as much as an effect that smooths efforts.

    What is simulated of a noisy motion, or with another friction, is too rough, and fits better
    where it is smoothed. But a log that was smoothed has lost its own noise, too.

    Args:
        fits: The fits that `e` is one of.
        e: The fit that holds it.
        at: The effect.
    """
    targets = [p.target for p in get_effect(at.effect).parameters]
    if 'log_smoothing' not in targets:
        return False
    # Effects come last in every recording's own parameters, too.
    column = e.columns(e.effects.index(at))[targets.index('log_smoothing')] - len(e.theta)
    return any(
        _is_noisy(model.data.effort[model.data.names.index(place)], model.cycle, theta[column])
        for model, theta in fits.split.whole.with_effects(e.effects).each(e.theta)
        if model.data.effort is not None
        for place in model.places
    )


def _is_noisy(effort: Array, cycle: float, period: float) -> bool:
    """Return whether an effort (K,) has noise that smoothing of the file would have taken.

    Above the cut-off, 1 / period, what passed has a power that falls with the frequency, forwards
    and backwards, by an order of four times the filter's. Noise that came later is rounding alone.
    """
    frequency = np.fft.rfftfreq(effort.size, cycle)
    # Ends of octaves: of the first above the cut-off, and of the last of all.
    near, far = 2.0 / max(period, cycle), float(frequency[-1])
    if far < 2.0 * near:
        return False
    whole = fill_gaps(effort)
    window = np.hanning(effort.size)
    power = np.abs(np.fft.rfft(window * (whole - whole.mean()))) ** 2
    least, most = (
        float(power[(frequency > 0.5 * end) & (frequency <= end)].mean()) for end in (near, far)
    )
    rounding = step_of(effort[np.isfinite(effort)]) ** 2 / 12.0 * float(np.sum(window**2))
    # Half way, in the order, to noise that is the same at all frequencies.
    return most > 2.0 * rounding and most > least * (near / far) ** (2 * SMOOTHING)


def _functions(fits: Fits, e: Hypothesis, at: EffectAt) -> Iterator[tuple[str, Array, Array]]:
    """Yield a coordinate, and functions of it on the fit part's rows and those held out."""
    split, effect = fits.split, get_effect(at.effect)
    read = {_OF[x] for x in effect.reads.union(p.role for p in effect.parameters) if x in _OF}
    fitted = list(split.whole.with_effects(e.effects).each(e.theta))
    whole = joined([motion_of(model, own) for model, own in fitted])
    ends = np.cumsum([mask.shape[1] for mask in split.whole.masks])
    cycles = np.arange(ends[-1])
    drives = [d for d, name in enumerate(split.drives) if at.where in (name, 'all')]
    # The part held out is every recording, or the last ones.
    sides = (split.fit, fits.weight, 0), (split.check, fits.check_weight, -len(split.check.models))

    def seen(each: list[Array]) -> list[Array]:
        """Return columns (K, B) of the drives as outputs are compared, on each part's rows."""
        columns = np.zeros((sum(x.shape[1] for x in each), len(split.drives), len(cycles)))
        first = 0
        for d, x in zip(drives, each, strict=True):
            columns[first : first + x.shape[1], d] = x.T
            first += x.shape[1]
        bands = [
            model.in_band(part)
            for (model, _), part in zip(fitted, np.split(columns, ends[:-1], axis=2), strict=True)
        ]
        out = []
        for part, weight, start in sides:
            own = zip(bands[start:], part.masks, strict=False)
            out.append(np.hstack([band[:, mask] for band, mask in own]).T * weight[:, None])
        return out

    ones = np.ones_like(cycles)
    common = seen([np.stack([ones, direction(whole.velocity[d])], axis=1) for d in drives])
    for each in zip(*(coordinates(whole, d, cycles) for d in drives), strict=False):
        name, own = _OF[each[0].name], [c.columns for c in each]
        if bent := effect.bent and each[0].name == 'position':
            own = [np.vander(row - row.mean(), 4) for row in whole.position[drives]]
        # What pushes a machine also accelerates it: that is no cause beside the push.
        if bent or name not in read | {'acceleration'}:
            columns = seen(own)
            factor = np.linalg.lstsq(common[0], columns[0], rcond=None)[0]
            fit, check = (x - y @ factor for x, y in zip(columns, common, strict=True))
            yield name, fit, check
