# SPDX-License-Identifier: Apache-2.0
"""What effects leave on one machine and its motions, without noise.

The linearised answer scales effects while cases are drawn. The true one refits the nominal
parameters to the reference's noise-free log and is what the scores use.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ros2_ident.gap.attribute import Attribution
from ros2_ident.gap.case import Case, recordings_of
from ros2_ident.gap.fits import Explanation
from ros2_ident.identify.hidden import SETTLE
from ros2_ident.models import DriveModel, Machine, make_model
from ros2_ident.recording import Dataset
from ros2_ident.reference.motions import Motion
from ros2_ident.reference.plant import Unmodelled
from ros2_ident.reference.twin import twin_of

Array = npt.NDArray[np.float64]

# Changes the effort by some 1e-8 of its size: far below any noise, and four times as fast.
QUICK = (1e-7, 1e-8)
# Every second cycle is logged.
PERIOD = 1e-3


@dataclass(frozen=True)
class Left:
    """What the nominal parameters cannot imitate, without noise.

    Attributes:
        per_drive: (D,) RMS over both recordings, in units of the noise.
        check: (D,) mean square on the recording held out, in units of the noise squared.
    """

    per_drive: Array
    check: Array

    @property
    def size(self) -> float:
        """The worst drive's RMS."""
        return float(self.per_drive.max())


class Probe:
    """One machine with its parameters on two motions.

    Args:
        machine: The machine.
        parameters: Its true nominal parameters.
        motions: Of the recording to fit on and of the one held out.
    """

    def __init__(
        self, machine: Machine, parameters: Mapping[str, float], motions: Sequence[Motion]
    ) -> None:
        self.machine = machine
        self.parameters = dict(parameters)
        self.motions = tuple(motions)
        self.floor = np.full(len(machine.drives), machine.effort_noise)
        self._bases: dict[int, Array] = {}
        self._models: dict[int, DriveModel] = {}
        self._jacobians: dict[int, Array] = {}

    def effort(self, which: int, effects: Sequence[Unmodelled]) -> Array:
        """Return (D, K) the logged effort before noise, on one of the motions."""
        motion = self.motions[which]
        log = twin_of(self.machine).simulate(
            self.machine,
            self.parameters,
            motion.position,
            motion.velocity,
            effects,
            rtol=QUICK[0],
            atol=QUICK[1],
        )
        return np.asarray(log.effort)

    def dataset(self, which: int, effort: Array) -> Dataset:
        """Return a noise-free recording."""
        motion = self.motions[which]
        logged = np.full(effort.shape, np.nan)
        every = max(1, round(PERIOD / motion.cycle))
        logged[:, ::every] = effort[:, ::every]
        return Dataset(
            self.machine.drives,
            motion.cycle,
            0,
            motion.position,
            motion.velocity,
            None,
            None,
            logged,
        )

    @cached_property
    def theta(self) -> Array:
        """(N,) the true parameters in the model's order."""
        known = self.parameters
        values = [
            known[p.name] if p.name in known else known[p.name.rpartition('.')[2]]
            for p in self._model(0).parameters
        ]
        return np.array(values)

    def _model(self, which: int) -> DriveModel:
        if which not in self._models:
            data = self.dataset(which, np.zeros(self.motions[which].position.shape))
            self._models[which] = make_model(self.machine, data)
        return self._models[which]

    def _rows(self, which: int, effort: Array) -> Array:
        cycle = self.motions[which].cycle
        return effort[..., int(round(SETTLE / cycle)) :: max(1, round(PERIOD / cycle))]

    def _jacobian(self, which: int) -> Array:
        if which not in self._jacobians:
            model = self._model(which)
            low = np.array([p.low for p in model.parameters])
            high = np.array([p.high for p in model.parameters])
            step = 1e-3 * (high - low) * np.where(self.theta > 0.5 * (low + high), -1.0, 1.0)
            points = self.theta + np.vstack([np.zeros(len(step)), np.diag(step)])
            outputs = model.simulate(points)
            change = self._rows(which, outputs[1:] - outputs[:1])
            self._jacobians[which] = change.reshape(len(step), -1).T
        return self._jacobians[which]

    def linear(self, effects: Sequence[Unmodelled]) -> float:
        """Return the size on the first motion by the linearised fit, in units of the noise."""
        if 0 not in self._bases:
            self._bases[0] = self.effort(0, ())
        change = self._rows(0, self.effort(0, effects) - self._bases[0])
        jacobian = self._jacobian(0)
        x = np.linalg.lstsq(jacobian, change.ravel(), rcond=1e-9)[0]
        rest = (change.ravel() - jacobian @ x).reshape(change.shape)
        return float((np.sqrt(np.mean(rest**2, axis=1)) / self.floor).max())

    def truth(self, effects: Sequence[Unmodelled], start: Array | None = None) -> Left:
        """Refit the nominal parameters to a noise-free log and return what is left."""
        efforts = [self.effort(i, effects) for i in range(2)]
        return self.left(*self._refit(efforts, start))

    def _refit(self, efforts: Sequence[Array], start: Array | None) -> tuple[Case, Explanation]:
        data = [self.dataset(i, effort) for i, effort in enumerate(efforts)]
        case = Case(recordings_of(self.machine, data[:1]), recordings_of(self.machine, data[1:]))
        attribution = Attribution(case, self.floor)
        starts = [self.theta] if start is None else [self.theta, start]
        found = [attribution.refit((), x, 20) for x in starts]
        return case, min(found, key=lambda e: float(e.fit.sum()))

    def left(self, case: Case, found: Explanation) -> Left:
        """Return what a fit leaves."""
        drives = len(self.machine.drives)
        fit_count = np.bincount(case.fit.drive, minlength=drives)
        check_count = np.bincount(case.check.drive, minlength=drives)
        both = (found.fit + found.check) / (fit_count + check_count)
        return Left(np.sqrt(both), found.check / check_count)
