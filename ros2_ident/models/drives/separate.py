# SPDX-License-Identifier: Apache-2.0
"""Drives that do not know of each other: where they start, and their compiled simulation."""

import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.kernel.group import Group, Task
from ros2_ident.lanes import room
from ros2_ident.models.drives.kernel import room_for, simulate, state_for
from ros2_ident.models.drives.model import DriveModel

# A set-point slower than this share of its fastest at the log's start counts as rest.
_REST = 0.02
# Samples of the position that show how fast an axis starts.
_FIRST = 10
# Those that show how one starts that no set-point holds, and the first of them, that show where.
_BEGINNING, _STILL = 12, 3
# A speed counts where it is so many standard errors.
_SURE = 4.0


class SeparateDrives(DriveModel):
    """Each drive moves one carriage, through a gear that gives or rigid; see `DriveModel`."""

    @property
    def rigid(self) -> bool:
        """Whether motor and carriage are one mass: where no gear stiffness is to be found."""
        return 'gear_stiffness' not in self.machine.bounds

    def _inputs(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        command, motion, mode = super()._inputs()
        self._begin = self._start(command, motion)
        return command, motion, mode

    def _start(self, command: Array, motion: Array) -> Array:
        """Return (2 * D,) where the motors start and how fast.

        An axis starts at rest where its set-point is, unless the log shows that it moves already:
        its first measured positions then say where it is and how fast.
        """
        drives = len(self.machine.drives)
        first = (motion if self.data.command_position is None else command).reshape(-1)
        count = first.size // (drives * (3 if self.data.command_position is None else 2))
        begin = np.zeros(2 * drives)
        begin[:drives] = first[: drives * count : count]
        speed = self.data.command_velocity
        if self.data.position is None or speed is None:
            return begin
        for d, name in enumerate(self.machine.drives):
            row = self.data.names.index(name)
            if abs(speed[row, 0]) <= _REST * np.abs(speed[row]).max():
                continue
            there = np.flatnonzero(np.isfinite(self.data.position[row]))[:_FIRST]
            if len(there) < _FIRST:
                continue
            seen = self.data.position[row, there]
            _, slope, place = np.polyfit(there * self.cycle, seen, 2)
            begin[d], begin[drives + d] = place, slope
        return begin

    def _seen(self, begin: Array) -> Array:
        """Return starts (2 * D,) as the first measured positions say, where there are some."""
        drives = len(self.machine.drives)
        for d, name in enumerate(self.machine.drives if self.data.position is not None else ()):
            assert self.data.position is not None
            row = self.data.position[self.data.names.index(name)]
            there = np.flatnonzero(np.isfinite(row))[:_BEGINNING]
            if len(there) == _BEGINNING:
                begin[d], begin[drives + d] = _beginning(self.data.time[there], row[there])
        return begin

    @property
    def _supply(self) -> Array | None:
        """(D * K,) share of a servo's supply at every cycle; None where efforts are commanded."""
        return None

    @property
    def _state(self) -> int:
        return state_for(len(self.machine.drives))

    def _run(self, group: Group, begin: int, end: int, task: Task) -> None:
        simulate(
            group,
            room(room_for(len(self.machine.drives))),
            begin,
            end,
            self._command,
            self._motion,
            self._begin,
            self._mode,
            self.candidates.on,
            self._supply,
            self.candidates.delayed,
            self.stiff,
            self.cycle,
            self.law,
            task,
        )


def _beginning(time: Array, seen: Array) -> tuple[float, float]:
    """Return place and speed at time zero, by samples (T,); at rest unless they say otherwise."""
    terms = np.vander(time, 3)
    found = np.linalg.lstsq(terms, seen, rcond=None)[0]
    apart = np.diff(np.unique(seen))
    step = float(apart.min()) if apart.size else 0.0
    noise = math.hypot(float(np.std(seen - terms @ found)), step / math.sqrt(12.0))
    error = noise * math.sqrt(float(np.linalg.inv(terms.T @ terms)[1, 1]))
    if abs(found[1]) > _SURE * error:
        return float(found[2]), float(found[1])
    return float(np.mean(seen[:_STILL])), 0.0
