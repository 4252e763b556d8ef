# SPDX-License-Identifier: Apache-2.0
"""Set-points, recorded motion and its band, read of a log once."""

from dataclasses import dataclass
import functools
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.kernel.drive import CLOSED_LOOP, PRESCRIBED
from ros2_ident.machine.machine import Machine
from ros2_ident.models.drives.band import Band, Mask
from ros2_ident.models.drives.outputs import chosen_outputs
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import settling, smooth_motion, speed_error, standing, told_band

# Middle of the time a commanded torque holds, in cycles.
_HOLD = 0.5
# The motion that drives a model is kept up to so many times the band in which efforts are
# compared, for friction turns over faster than efforts do; and at least up to so many times. No
# motion is told above this share of a log's rate.
_WIDER, _LEAST, _ROOM = 5.0, 2.5, 0.35
# Of a short log no more than this share is left out at either end.
_SHORTEST = 0.05


@dataclass(frozen=True, eq=False)
class DriveLog:
    """A log, as drives are simulated along it; siblings of a model share it.

    Attributes:
        machine, data, drives, cutoff, fixed: As of a `MachineModel`.
        doubtful: (P, K) where the motion does not decide an effort, nowhere where False.
        plain: The log whose motion is smoothed less by a factor of sqrt(2), and whose band is
            compared; None where that is this one.
    """

    machine: Machine
    data: Dataset
    drives: tuple[str, ...]
    cutoff: float
    fixed: dict[str, float]
    doubtful: Mask | bool = False
    plain: 'DriveLog | None' = None

    @functools.cached_property
    def order(self) -> list[int]:
        """Row in the recording of each of the machine's drives."""
        return [self.data.names.index(name) for name in self.machine.drives]

    @property
    def closed(self) -> bool:
        """Whether controllers follow a set-point."""
        return self.data.command_position is not None and self.data.command_velocity is not None

    @property
    def pushed(self) -> bool:
        """Whether logged efforts move the drives, and no controllers."""
        return False

    @functools.cached_property
    def mode(self) -> npt.NDArray[np.int64]:
        """(D,) CLOSED_LOOP or PRESCRIBED."""
        loop = [self.closed and name in self.drives for name in self.machine.drives]
        return np.where(loop, CLOSED_LOOP, PRESCRIBED).astype(np.int64)

    @functools.cached_property
    def command(self) -> Array:
        """(2, D, K) set-points of the drives, then their rates; zero where none is followed."""
        shape = 2, len(self.order), self.data.cycles
        return np.ascontiguousarray(self._set_points()) if self.closed else np.zeros(shape)

    def _set_points(self) -> Array:
        data = self.data
        assert data.command_position is not None and data.command_velocity is not None
        return np.stack([data.command_position[self.order], data.command_velocity[self.order]])

    @property
    def added(self) -> Array | None:
        """(D, K) effort that the controllers add to their law's, known along the log."""
        return None

    @functools.cached_property
    def followed(self) -> Array:
        """(3, D, K) recorded motion that drives the model, (3, D, 0) where none does.

        Raises:
            IdentError: MISSING_STREAM where there is no position either.
        """
        if (self.mode != PRESCRIBED).all():
            return np.zeros((3, len(self.order), 0))
        cutoff = self._motion_cutoff / (1.0 if self.plain is None else math.sqrt(2.0))
        return np.array(smooth_motion(self._position, self.data.cycle, cutoff, self.ahead))

    @property
    def motion(self) -> Array:
        """(3, D, K) that motion at the instants of the log."""
        return self.followed

    @property
    def _position(self) -> Array:
        """(D, K) measured positions."""
        if self.data.position is None:
            raise ErrorCode.MISSING_STREAM.error(
                'there is neither a command nor a measured position to drive the model; '
                'record joint_states with positions or joint_command'
            )
        return self.data.position[self.order]

    @property
    def ahead(self) -> float:
        """Cycles of the grid by which the motion that belongs to an effort is later.

        A commanded torque holds until the next cycle: what it caused is, on average, the motion
        half a cycle later.
        """
        hold = _HOLD * float(self.machine.number('cycle'))
        return 0.0 if self.closed else hold / self.data.cycle

    @functools.cached_property
    def _motion_cutoff(self) -> float:
        """Frequency up to which positions drive the model, Hz."""
        return min(_WIDER * self._limit, self._highest)

    @functools.cached_property
    def _highest(self) -> float:
        """Frequency up to which positions can drive a model, Hz."""
        # A slow log holds nothing above half its rate, and its smoothing needs some room.
        rate = np.isfinite(self._position).mean() / self.data.cycle
        return min(self.cutoff, (0.2 if self.closed else _ROOM) * float(rate))

    @functools.cached_property
    def _limit(self) -> float:
        """Frequency below which efforts are compared, Hz; inf where a set-point is followed.

        And for a motion that is planned: there is no log.
        """
        if self.closed or not np.isfinite(self.efforts).any():
            return math.inf
        stated = self.machine.stated('bandwidth')
        wanted = self.machine.number('bandwidth') if stated else told_band(self.data)
        return min(wanted, self._highest / _LEAST)

    @property
    def efforts(self) -> Array:
        """(P, K) logged efforts of the drives that are compared.

        Raises:
            IdentError: MISSING_STREAM where there are none.
        """
        signals = chosen_outputs(self.machine.drives, self.drives, ('effort',), None)
        return signals.measured(self.data)

    @functools.cached_property
    def band(self) -> Band | None:
        """Compared part of the efforts; None where controllers follow a set-point."""
        if self.plain is not None:
            return self.plain.band
        if self._limit == math.inf:
            return None
        data, machine, cutoff = self.data, self.machine, self._motion_cutoff
        least = machine.numbers('least_speed') if machine.stated('least_speed') else None
        still = standing(self._position, self.motion[1], data.cycle, cutoff, least)
        # A log may begin and end on the move: nothing tells the acceleration there.
        ends = min(settling(data.cycle, cutoff), int(_SHORTEST * data.cycles))
        still[:, :ends] = still[:, data.cycles - ends :] = True
        compared = [machine.drives.index(name) for name in self.drives]
        return Band(self._limit, cutoff, data.cycle, self.efforts, still[compared], self.doubtful)

    @functools.cached_property
    def speed_errors(self) -> Array:
        """(D,) standard deviation of the speeds that the motion tells; 0 where none is logged."""
        if self.band is None:
            return np.zeros(len(self.order))
        cutoff = self._motion_cutoff
        return np.array([speed_error(row, self.data.cycle, cutoff) for row in self._position])
