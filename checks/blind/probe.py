# SPDX-License-Identifier: Apache-2.0
"""What effects leave on one machine and its motions, without noise.

The linearised answer scales effects while cases are drawn. The true one refits the nominal
parameters to the generator's noise-free logs; it goes into the label.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from checks.reference.plant import Log, Unmodelled
from checks.reference.twin import twin_of
from ros2_ident.models import DriveModel, Machine, make_model
from ros2_ident.recording import Dataset
from ros2_ident.search import refine
from ros2_ident.simulate.motions import Motion

Array = npt.NDArray[np.float64]

# Changes the effort by some 1e-7 of its size: far below any noise, and several times as fast.
QUICK = (1e-6, 1e-7)
# What is compared: a sample a millisecond, without the log's start, as a diagnosis does.
PERIOD, SETTLE = 1e-3, 0.1


@dataclass(frozen=True)
class Left:
    """What the nominal parameters cannot imitate, without noise.

    Attributes:
        fit: (D,) mean square on the recording fitted on, in units of the noise squared.
        check: (D,) the same on the recording held out.
        per_drive: (D,) RMS over both recordings, in units of the noise.
    """

    fit: Array
    check: Array
    per_drive: Array

    @property
    def size(self) -> float:
        """The worst drive's RMS."""
        return float(self.per_drive.max())


class Probe:
    """One machine with its parameters on two motions.

    Args:
        motions: Of the recording to fit on and of the one held out.
        noise: Standard deviation of the effort's noise.
    """

    def __init__(
        self,
        machine: Machine,
        parameters: Mapping[str, float],
        motions: Sequence[Motion],
        noise: float,
    ) -> None:
        self.machine = machine
        self.parameters = dict(parameters)
        self.motions = tuple(motions)
        self.noise = noise
        self._models: dict[int, DriveModel] = {}
        self._kept: dict[tuple[int, str], Log] = {}

    def log(self, which: int, effects: Sequence[Unmodelled]) -> Log:
        """Return what the machine does on one of the motions; the last few are kept."""
        key = which, repr(effects)
        if key not in self._kept:
            while len(self._kept) >= 6:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self._simulate(self.motions[which], effects)
        return self._kept[key]

    def _simulate(self, motion: Motion, effects: Sequence[Unmodelled]) -> Log:
        course = motion.position, motion.velocity
        twin = twin_of(self.machine)
        return twin.simulate(self.machine, self.parameters, *course, effects, *QUICK)

    def effort(self, which: int, effects: Sequence[Unmodelled]) -> Array:
        """Return (D, K) the logged effort before noise, on one of the motions."""
        return np.asarray(self.log(which, effects).effort)

    def model(self, which: int) -> DriveModel:
        """Return the nominal model along one of the motions."""
        if which not in self._models:
            motion = self.motions[which]
            course, none = (motion.position, motion.velocity), np.zeros(motion.position.shape)
            data = Dataset(self.machine.drives, motion.cycle, 0, *course, None, None, none)
            self._models[which] = make_model(self.machine, data)
        return self._models[which]

    @cached_property
    def theta(self) -> Array:
        """(N,) the true parameters in the model's order."""
        known = self.parameters
        values = [
            known[p.name] if p.name in known else known[p.name.rpartition('.')[2]]
            for p in self.model(0).parameters
        ]
        return np.array(values)

    def compared(self, which: int, effort: Array) -> Array:
        """Return those of (..., K) efforts that are compared."""
        cycle = self.motions[which].cycle
        return effort[..., round(SETTLE / cycle) :: max(1, round(PERIOD / cycle))]

    def simulated(self, which: int, theta: Array) -> Array:
        """Return (S, D, T) the nominal model's effort of (S, N) candidates."""
        return self.compared(which, self.model(which).simulate(np.atleast_2d(theta)))

    @cached_property
    def _jacobian(self) -> Array:
        model = self.model(0)
        low = np.array([p.low for p in model.parameters])
        high = np.array([p.high for p in model.parameters])
        step = 1e-3 * (high - low) * np.where(self.theta > 0.5 * (low + high), -1.0, 1.0)
        outputs = self.simulated(0, self.theta + np.vstack([np.zeros(len(step)), np.diag(step)]))
        return (outputs[1:] - outputs[:1]).reshape(len(step), -1).T

    @cached_property
    def _base(self) -> Array:
        """(D, T) the first log without effects."""
        return self.compared(0, self.effort(0, ()))

    def linear(self, effects: Sequence[Unmodelled]) -> float:
        """Return the size on the first motion by the linearised fit, in units of the noise."""
        change = self.compared(0, self.effort(0, effects)) - self._base
        x = np.linalg.lstsq(self._jacobian, change.ravel(), rcond=1e-9)[0]
        rest = (change.ravel() - self._jacobian @ x).reshape(change.shape)
        return float(np.sqrt(np.mean(rest**2, axis=1)).max() / self.noise)

    def truth(self, effects: Sequence[Unmodelled]) -> Left:
        """Refit the nominal parameters to the first noise-free log; return what both leave."""
        wanted = [self.compared(i, self.effort(i, effects)) for i in range(2)]
        model = self.model(0)
        found = refine(
            lambda theta: (wanted[0] - self.simulated(0, theta)).reshape(len(theta), -1),
            self.theta,
            [p.low for p in model.parameters],
            [p.high for p in model.parameters],
            max_evaluations=30 * (1 + len(self.theta)),
            tolerance=1e-6,
        )
        theta = found.theta if np.isfinite(found.theta).all() else self.theta
        rest = [wanted[i] - self.simulated(i, theta)[0] for i in range(2)]
        fit, check = (np.mean(r**2, axis=1) / self.noise**2 for r in rest)
        both = np.mean(np.hstack(rest) ** 2, axis=1) / self.noise**2
        return Left(fit, check, np.sqrt(both))
