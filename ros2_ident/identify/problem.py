# SPDX-License-Identifier: Apache-2.0
"""Models of one machine on all recordings as one problem."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
import hashlib
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.compiled import result_digest
from ros2_ident.errors import ErrorCode
from ros2_ident.identify.data import chosen_drives, Data, undriven
from ros2_ident.identify.layout import check_overrides, Conditions, expanded, held_of, Layout
from ros2_ident.identify.outputs import checked, Outputs, weights_of
from ros2_ident.identify.result import DriveResidual, Quality
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.machine.machine import Machine
from ros2_ident.models import EffectAt, make_model
from ros2_ident.models.protocol import complete, Model
from ros2_ident.models.registry import compared_of, scales_of
from ros2_ident.recording import Dataset
from ros2_ident.recording.quality import standing
from ros2_ident.search.jacobian import diverged


class Problem(Layout):
    """Models of one machine on several recordings or segments, as one fit with its box.

    The cost of a candidate is the mean of the models' costs (eq. 2), weighted by their samples;
    the residuals of the models follow one another.

    Args:
        models: One for each recording or segment.
        labels: The recording each model belongs to.
        fixed: Parameters held at a value, by name: `coulomb_torque` means that of every drive,
            `tool_mass` that of every recording where each has its own.
        bounds: (low, high) instead of the parameters' own, by name.
        held: What the models hold already, by full name.
        setup: What the models were made from; None where they are a user's own.

    Attributes, beside those of `Layout`:
        name: Kind of model.
        unit: Unit of the cost.
        noise: Standard deviation of the outputs' noise as stated, `unit`; 0 where it is not.
        drives: What the outputs belong to.
        fixed: Values of the parameters that are held.
        series: Lengths of the residual's time series: output after output, model after model.
        outputs: How many outputs a model has.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER or NO_DATA with the remedy.
    """

    def __init__(
        self,
        models: Sequence[Model],
        labels: Sequence[str] = (),
        conditions: Conditions | None = None,
        *,
        fixed: Mapping[str, float] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        held: Mapping[str, float] | None = None,
        setup: 'Setup | None' = None,
    ) -> None:
        several = tuple(complete(m) for m in models)
        if not several:
            raise ErrorCode.NO_DATA.error('there is no recording; record a motion first')
        self.setup = setup
        self.drives = several[0].places
        self._own = labels, conditions, fixed, bounds
        names = Layout(several, labels, conditions).names
        found = expanded(names, fixed or {}, 'be fixed')
        self.fixed = {**(held or {}), **found}
        box = expanded([*names, *(held or {})], bounds or {}, 'be bounded')
        check_overrides(self.fixed, box)
        super().__init__(several, labels, conditions, found, box)
        if not self.parameters:
            raise ErrorCode.INVALID_GOAL.error(
                'every parameter is fixed; leave at least one to be identified'
            )
        self.name, self.unit = self.models[0].name, self.models[0].unit
        self.noise = self.models[0].noise
        counts = [(~np.isnan(m.measured)).sum(axis=1) for m in self.models]
        self.series: tuple[int, ...] = tuple(int(n) for c in counts for n in c)
        self.samples, self.outputs = sum(self.series), len(counts[0])
        left, faster = '', ''
        if self.models[0].thinned:
            left, faster = ' beside rest and turns', ', or log at a higher rate'
        if self.samples <= len(self.parameters):
            raise ErrorCode.NO_DATA.error(
                f'{self.samples} effort samples{left} cannot determine {len(self.parameters)} '
                f'parameters; record a longer motion{faster}'
            )
        if 0 in (each := [int(c.sum()) for c in counts]):
            raise ErrorCode.NO_DATA.error(
                f'recording {1 + each.index(0)} of {len(counts)} has no effort sample{left}; '
                f'leave it out{faster}'
            )
        self._weights = [c.sum() / self.samples for c in counts]

    @property
    def machine(self) -> Machine:
        """The machine; only where the problem was made from one."""
        assert self.setup is not None
        return self.setup.machine

    @property
    def data(self) -> Data:
        """The data; only where the problem was made from a machine."""
        assert self.setup is not None
        return self.setup.data

    @cached_property
    def key(self) -> str:
        """A digest of the fit's inputs: another one, another fit."""
        total = hashlib.sha256(sources().encode())
        total.update(repr((self.name, self.names, self.fixed, self.setup)).encode())
        total.update(np.concatenate([self.low, self.high]).tobytes())
        for data in () if self.setup is None else self.setup.data.datasets:
            total.update(data.digest)
        for model in self.models:
            total.update(repr(model.outputs).encode())
            total.update(np.ascontiguousarray(model.measured).tobytes())
        return total.hexdigest()

    def quality(self) -> Quality:
        """Return the quality of the data."""
        if self.setup is not None:
            return self.setup.data.quality(self.samples)
        seconds = sum(m.measured.shape[1] * m.cycle for m in self.models)
        return Quality(len(self.models), seconds, self.samples, {})

    def __reduce__(self) -> tuple[Callable[..., 'Problem'], tuple[object, ...]]:
        """Pickle machine and data; the models are made anew where they arrive."""
        if self.setup is None:
            labels, conditions, fixed, bounds = self._own
            again = partial(Problem, fixed=fixed, bounds=bounds)
            return again, (self.models, labels, conditions)
        # Without what only the process that reads the bag needs.
        lean = replace(self.setup.data, recordings=(), held_out=None)
        return _made_anew, (sources(), replace(self.setup, data=lean))

    def prepare(self) -> None:
        """Compile the simulation, or read it from the cache."""
        self.costs(0.5 * (self.low + self.high)[None, :])

    def work(self, points: Array) -> npt.NDArray[np.int64]:
        """Return (S,) how much work candidates (S, N) in the unit cube are."""
        theta = self.low + points * (self.high - self.low)
        return self.models[0].work(self.own(0, theta))

    def costs(
        self, theta: Array, limit: float = math.inf, stop: Callable[[], bool] | None = None
    ) -> Array:
        """Return the costs of candidates.

        Args:
            theta: (S, N) candidates.
            limit: Cost above which a candidate need not be simulated to the end.
            stop: Asked now and then; True where the result is not needed any more.

        Returns:
            (S,) costs, `unit`; inf where a candidate diverged. Where one is above `limit` it is a
            lower bound of the cost.
        """
        total = np.zeros(len(theta))
        below = np.arange(len(theta))
        for number, (weight, model) in enumerate(zip(self._weights, self.models, strict=True)):
            # A bit more than is left, so that the sum is above the limit in spite of rounding.
            left = (limit * (1.0 + 1e-12) - total[below]) / weight
            own = self.own(number, theta[below])
            total[below] += weight * model.costs(own, left, stop)
            below = below[(total[below] <= limit) & (total[below] < math.inf)]
            if not below.size:
                break
        return total

    def residuals(self, theta: Array) -> Array:
        """Return (S, R) measured less simulated outputs of (S, N) candidates, weighted.

        Rows of diverged candidates are inf.
        """
        return np.hstack([m.residuals(self.own(i, theta)) for i, m in enumerate(self.models)])

    def taken_from(self, other: 'Problem', theta: Array) -> Array:
        """Return (N,) another problem's candidate (N',) as this one's, by the names."""
        values = {p.name: v for p, v in zip(other.parameters, theta, strict=True)}
        return np.array([values[p.name] for p in self.parameters])

    def cost_of(self, residual: Array) -> float:
        """Return the cost that belongs to one residual vector (R,), `unit`; inf if it diverged."""
        if diverged(residual):
            return math.inf
        parts = iter(np.split(residual, np.cumsum(self.series)[:-1]))
        total = 0.0
        for weight, model in zip(self._weights, self.models, strict=True):
            rows = [next(parts) for _ in model.outputs]
            errors = [float(np.sqrt(np.mean(row**2))) for row in rows if row.size]
            total += float(weight) * (sum(errors) / len(errors) if errors else 0.0)
        return total

    def parts(
        self, residual: Array, masks: Sequence[npt.NDArray[np.bool_]] | None = None
    ) -> Iterator[tuple[int, Array, Array]]:
        """Yield outputs' numbers, the part of a residual that is theirs, and the measured values.

        Both in the output's own unit, model by model; arguments as for `left`.
        """
        start = 0
        for model, mask in zip(
            self.models, masks or [~np.isnan(m.measured) for m in self.models], strict=True
        ):
            rows = zip(model.outputs, model.measured, mask, strict=True)
            for o, (output, row, seen) in enumerate(rows):
                there = row[seen]
                yield o, residual[start : start + there.size] / output.weight, there
                start += there.size

    def left(
        self, residual: Array, masks: Sequence[npt.NDArray[np.bool_]] | None = None
    ) -> tuple[DriveResidual, ...]:
        """Return the residual of each output, in the output's own unit.

        Args:
            residual: (R,) weighted.
            masks: For each model (O, K) which samples it is of; all there are where None.
        """
        outputs = self.models[0].outputs
        # of joints that turn one may slide
        usual = 'effort', self.unit
        square, whole = np.zeros(len(outputs)), np.zeros(len(outputs))
        count = np.zeros(len(outputs), dtype=int)
        for o, left, there in self.parts(residual, masks):
            square[o] += float(np.sum(left**2))
            whole[o] += float(np.sum(there**2))
            count[o] += there.size
        return tuple(
            DriveResidual(
                output.name,
                float(np.sqrt(square[o] / max(1, count[o]))),
                float(np.sqrt(square[o] / whole[o])) if whole[o] > 0.0 else float('nan'),
                int(count[o]),
                '' if (output.quantity, output.unit) == usual else output.unit,
            )
            for o, output in enumerate(outputs)
        )


@dataclass(frozen=True)
class Setup:
    """Machine and data that a problem is made from.

    Attributes:
        drives: Drives whose effort is compared, in the machine's order.
        fixed: Parameters held at a value: by full name, or `gear_stiffness` for every drive's.
        bounds: (low, high) instead of the machine file's, by the same names.
        cutoff: Low-pass of recorded motion where it drives the model [Hz].
        outputs: What is compared, and its weight; see `outputs.weights_of`.
    """

    machine: Machine
    data: Data = field(repr=False)
    drives: Sequence[str] | None = None
    fixed: Mapping[str, float] | None = None
    bounds: Mapping[str, tuple[float, float]] | None = None
    effects: Sequence[EffectAt] = ()
    cutoff: float = IdentifySettings.cutoff
    conditions: Conditions = Conditions()
    outputs: Outputs = field(default_factory=dict)

    def problem(self) -> Problem:
        """Return the machine's model on every segment, as one problem.

        Raises:
            IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, or as `make_model`.
        """
        machine, datasets = self.machine, self.data.datasets
        drives = chosen_drives(machine, self.drives)
        if not datasets:
            raise ErrorCode.NO_DATA.error(
                'there is no segment to identify from; record a motion first'
            )
        for dataset in datasets:
            missing = [name for name in machine.drives if name not in dataset.names]
            if missing:
                raise ErrorCode.MISSING_STREAM.error(
                    f'the data hold {", ".join(dataset.names)} and not {", ".join(missing)}; '
                    "align them with the machine's drives"
                )
        make = partial(
            make_model, machine, drives=drives, effects=self.effects, cutoff=self.cutoff,
            scales=scales_of(machine, datasets), quantities=tuple(self.outputs),
            weights=self._weights(),
        )  # fmt: skip
        given = self.fixed or {}
        somewhere = {name: value for name, value in given.items() if '@' in name}
        everywhere = {name: value for name, value in given.items() if '@' not in name}
        held = held_of(machine, make(datasets[0]), drives, everywhere)
        return Problem(
            [make(d, fixed=held) for d in datasets],
            self.data.labels,
            self.conditions,
            fixed=somewhere,
            bounds=self.bounds,
            held=held,
            setup=self,
        )

    def held_out(self) -> Problem | None:
        """Make the problem of the parts held out of a long log, None where there are none."""
        data = self.data.held_out() if self.data.held_out else None
        return self._on(data).problem() if data and data.datasets else None

    def judged_on(self, data: Data) -> Problem:
        """Make the problem of recordings to judge on, for which all share every parameter."""
        return replace(self._on(replace(data, labels=())), conditions=Conditions()).problem()

    def _on(self, data: Data) -> 'Setup':
        # A part knows nothing of other recordings' values.
        fixed = {
            name: value
            for name, value in (self.fixed or {}).items()
            if '@' not in name or name.partition('@')[2] in data.labels
        }
        # With the weights of what was fitted, so that all of it is in one unit.
        outputs = dict(zip(self.outputs, self._weights(), strict=True))
        return replace(self, data=data, bounds=None, outputs=outputs, fixed=fixed)

    def _weights(self) -> tuple[float, ...]:
        drives = chosen_drives(self.machine, self.drives)
        noise = self.machine.effort_noise
        return weights_of(self.outputs, self.data.datasets, drives, noise)


def problem_of(
    machine: Machine,
    data: Data,
    *,
    conditions: Conditions | None = None,
    outputs: Outputs | None = None,
    **asked: Any,
) -> Problem:
    """Return a machine's model on every segment, as one problem.

    Args:
        outputs: What is compared; what the kind of machine compares where None.
        asked: Other attributes of `Setup`.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, or as `at_rest` and `make_model`.
    """
    differ, compared = conditions or Conditions(), checked(outputs, compared_of(machine))
    differ.check(data.labels)
    setup = Setup(machine, data, conditions=differ, outputs=compared, **asked)
    machine, drives = at_rest(machine, data.datasets, setup.drives)
    left = [x for x in chosen_drives(machine, setup.drives) if x not in drives]
    for still, why, links in (
        (True, 'stood still', 'stood'),
        (False, 'had no effort', 'moved'),
    ):
        if names := ', '.join(x for x in left if (x in machine.stands) == still):
            said = f'{names} {why}: nothing is found of their friction and rotors; their links '
            data = replace(data, warnings=(*data.warnings, f'{said}count as they {links}'))
    return replace(setup, machine=machine, data=data, drives=drives).problem()


def at_rest(
    machine: Machine, datasets: Sequence[Dataset], drives: Sequence[str] | None = None
) -> tuple[Machine, tuple[str, ...]]:
    """Return a machine that knows where drives stand in all data, and the drives to compare.

    What a drive's effort is at rest, friction decides, and where it is 0 throughout, or missing,
    nothing drives it, or it was not measured: where no drive is chosen, or all are, these are not
    compared.

    Raises:
        IdentError: INVALID_GOAL as `chosen_drives`, BAD_VALUES where no drive is left.
    """
    chosen = chosen_drives(machine, drives)
    rows = {}
    for name in machine.drives:
        here = [d.position[d.names.index(name)] for d in datasets
                if d.position is not None and name in d.names]  # fmt: skip
        if here and np.isfinite(here[0]).any():
            rows[name] = np.concatenate(here)
    judged = datasets if compared_of(machine) == ('effort',) else ()
    idle = {name for d in judged for name in undriven(d)}
    strokes = {name: float(np.nanmax(x) - np.nanmin(x)) for name, x in rows.items()}
    still = standing(strokes, idle)
    if chosen == machine.drives:
        chosen = tuple(name for name in chosen if name not in {*still, *idle})
    if not chosen:
        raise ErrorCode.BAD_VALUES.error(
            'no drive has an effort other than 0 in every log; leave out the logs that lack it'
        )
    stands = {n: float(np.nanmedian(rows[n])) for n in still if n not in chosen}
    return replace(machine, stands=stands), chosen


def problem_of_models(
    models: Model | Sequence[Model],
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    conditions: Conditions | None = None,
) -> Problem:
    """Return a user's own models as one problem.

    Args:
        models: One, or one for each recording; a parameter of one name is one parameter.
        fixed: Parameters held at a value, by name.
        bounds: (low, high) instead of the parameters' own, by name.
        conditions: What differs between the recordings, which are called `1`, `2` and so on.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER or NO_DATA with the remedy.
    """
    several = models if isinstance(models, Sequence) else [models]
    labels = [str(number) for number in range(1, len(several) + 1)]
    differ = conditions or Conditions()
    differ.check(labels)
    return Problem(several, labels, differ, fixed=fixed, bounds=bounds)


def sources() -> str:
    """Return a digest of all that a result depends on beside the machine and its data.

    The kernels' own covers effects and machines of other packages, too.
    """
    return f'{result_digest()}{sources_digest()}'


def require_sources(digest: str) -> None:
    """Refuse to work for a process whose sources differ: it would get other numbers.

    Args:
        digest: What `sources` returns there.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    if digest != sources():
        raise ErrorCode.INVALID_GOAL.error(
            'a worker has other sources of ros2_ident, or another NumPy, SciPy or Numba, than '
            'this process; install the same version on all of them'
        )


def _made_anew(digest: str, setup: Setup) -> Problem:
    """Return a pickled problem, or refuse to where it would give other numbers."""
    require_sources(digest)
    return setup.problem()
