# SPDX-License-Identifier: Apache-2.0
"""Does each position follow its own set-point, in the same unit, direction and time?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ros2_ident.arrays import Array, highest
from ros2_ident.errors import IdentError
from ros2_ident.gates import scale
from ros2_ident.gates.finding import Gate, Level
from ros2_ident.gates.scale import near
from ros2_ident.recording import Dataset, smooth_motion
from ros2_ident.recording.motion import allowed_cutoff, correlation

# Motion faster than this is left out, Hz, and speeds are compared at about this rate, Hz. By hand.
_SLOW, _RATE = 15.0, 250.0


@dataclass(frozen=True)
class Tracking:
    """How the speeds of D drives follow D set-points.

    Attributes:
        share: (D, D) share of drive i's speed that set-point j's, at the best lag, explains.
        lag: (D, D) that lag, s; positive where the drive is late.
        slope: (D, D) drive's speed over the set-point's there, by least squares.
    """

    drives: tuple[str, ...]
    share: Array
    lag: Array
    slope: Array

    def late(self, drive: str) -> float:
        """Return how late a drive follows its own set-point, s; 0 where it does not follow."""
        d = self.drives.index(drive)
        return float(self.lag[d, d]) if self.share[d, d] >= scale.FOLLOWS else 0.0


def tracking_of(data: Dataset, drives: Sequence[str]) -> Tracking | None:
    """Compare positions with set-points; None where a log does not hold both, or nothing moves."""
    if data.command_position is None or data.position is None:
        return None
    rows = [data.names.index(name) for name in drives]
    position, command = data.position[rows], data.command_position[rows]
    there = np.flatnonzero(np.isfinite(position).any(axis=0))
    # Beyond its ends a log would seem to stand still, and a motor that is off follows nothing.
    span = slice(there[0], data.released or there[-1] + 1) if there.size else slice(0)
    position, command = position[:, span], command[:, span]
    few = (np.isfinite(position).sum(axis=1) < scale.FEWEST).any()
    if few or not np.ptp(command, axis=1).all():
        return None
    cutoff = allowed_cutoff(position, data.cycle, _SLOW)
    try:
        speeds = [smooth_motion(x, data.cycle, cutoff)[1] for x in (position, command)]
    except IdentError:
        return None
    stride = max(1, round(1.0 / (_RATE * data.cycle)))
    moved, wanted = (x[:, ::stride] for x in speeds)
    if not (np.ptp(moved, axis=1) > 0.0).all():
        return None
    found = np.array([[_follows(m, w, stride * data.cycle) for w in wanted] for m in moved])
    return Tracking(tuple(drives), *(np.ascontiguousarray(x) for x in found.transpose(2, 0, 1)))


def _follows(moved: Array, wanted: Array, period: float) -> tuple[float, float, float]:
    """Return share, lag [s] and slope of one speed on another one, both without a mean."""
    moved, wanted = moved - moved.mean(), wanted - wanted.mean()
    size = moved.size
    reach = min(round(scale.APART / period), size // 3)
    product = correlation(moved, wanted)[size - 1 - reach : size + reach]
    # Only where both are: a log may end in motion.
    lags = np.arange(-reach, reach + 1)
    squares = [np.concatenate([[0.0], np.cumsum(x**2)]) for x in (moved, wanted)]
    early, late = np.maximum(-lags, 0), np.maximum(lags, 0)
    of_moved = squares[0][size - early] - squares[0][late]
    of_wanted = squares[1][size - late] - squares[1][early]
    share = product**2 / np.maximum(of_moved * of_wanted, 1e-300)
    # Half a period late, a swing is its own reverse: the other sign has to explain far more.
    best, same = (int(np.argmax(x)) for x in (share, np.where(product > 0.0, share, 0.0)))
    if 1.0 - share[best] > scale.SWAPPED * (1.0 - share[same]):
        best = same
    fine = highest(share, best)
    slope = float(product[best]) / max(float(of_wanted[best]), 1e-300)
    return float(share[best]), float(lags[best] + fine) * period, slope


def check_tracking(tracking: Tracking, cycle: float, unit: str) -> list[Gate]:
    """Judge whether positions and set-points belong together.

    Args:
        cycle: The controller's cycle, s.
        unit: Unit of the positions, `m` or `rad`.
    """
    swapped = _mixed(tracking)
    if swapped:
        return swapped
    found = []
    for d, drive in enumerate(tracking.drives):
        of = tracking.share, tracking.lag, tracking.slope
        share, lag, slope = (float(x[d, d]) for x in of)
        if share < scale.STRAYS:
            text = (
                f'{drive}: the position does not follow its set-point, which explains '
                f'{100.0 * share:.0f} % of the speed; check that names and stamps of both topics '
                'belong together, or leave the command out'
            )
            # A drive at its limit does not follow either.
            found.append(Gate('set_point', drive, 'warn', share, '1', text, cause='strays'))
        elif share >= scale.FOLLOWS and not near(slope):
            found.append(_of_another_unit(drive, slope, unit))
        elif share >= scale.FOLLOWS and lag < -(scale.LATE + 2.0 * cycle):
            text = (
                f'{drive}: the position leads its set-point by {-1e3 * lag:.3g} ms, so the '
                'stamps of the command are late or those of the position early; stamp both with '
                'one clock where they are sampled, or leave the command out'
            )
            found.append(Gate('offset', drive, 'fail', lag, 's', text, True, cause='command late'))
        else:
            text = f'{drive}: the position follows its set-point, {1e3 * lag:.2g} ms behind'
            found.append(Gate('set_point', drive, 'ok', slope, '1', text))
    return found


def _of_another_unit(drive: str, slope: float, unit: str) -> Gate:
    """Return the finding of a position that moves farther, less or the other way."""
    if near(-slope, scale.ANOTHER):
        text = (
            f'{drive}: the position moves against its set-point; its sign is reversed in one of '
            'the two topics, negate it there'
        )
        return Gate('set_point', drive, 'fail', slope, '1', text, True, cause='sign')
    text = f'{drive}: the position moves {slope:.4g} times as far as its set-point'
    for factor, name in scale.UNITS.get(unit, ()):
        for ratio, topic in ((factor, 'position'), (1.0 / factor, 'set-point')):
            if near(slope / ratio):
                text += f', so the {topic} is logged in {name}; log {unit}'
                return Gate('set_point', drive, 'fail', slope, '1', text, True, cause=topic + name)
    text += f'; log both in {unit}, of the same side of the gear'
    # A force that the controller does not hold moves a drive, too.
    strange = not near(slope, scale.ANOTHER)
    level: Level = 'fail' if strange else 'warn'
    return Gate('set_point', drive, level, slope, '1', text, strange, cause='factor')


def _mixed(tracking: Tracking) -> list[Gate]:
    """Return the finding of drives that follow each other's set-points."""
    count = len(tracking.drives)
    # What a set-point leaves of a drive's speed, as it is and not scaled: drives on a straight
    # path all move alike, but for a factor.
    slope = np.where(tracking.slope == 0.0, np.inf, tracking.slope)
    left = 1.0 - tracking.share * (2.0 / slope - 1.0 / slope**2)
    if count < 2 or (np.diag(left) <= 1.0 - scale.OWN).all():
        return []
    best = scipy.optimize.linear_sum_assignment(left)[1].tolist()
    moved = [d for d in range(count) if best[d] != d]
    fits = all(tracking.share[d, best[d]] >= scale.FOLLOWS for d in moved)
    if not moved or not fits or any(left[d, best[d]] > scale.SWAPPED * left[d, d] for d in moved):
        return []
    pairs = ', '.join(f"{tracking.drives[d]} follows {tracking.drives[best[d]]}'s" for d in moved)
    text = (
        f'{pairs} set-point: the names are swapped between the topics of position and command; '
        'correct the names, or their order, where the two are published'
    )
    return [Gate('names', '', 'fail', float(len(moved)), '1', text, contradicts=True)]
