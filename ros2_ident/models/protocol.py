# SPDX-License-Identifier: Apache-2.0
"""Model, as the rest of the program has it: one recording, simulated for many candidates.

`Model` is what a model has to have. All else is optional: what the program can use beyond that, it
asks `FullModel` for, whose defaults say what happens without. `complete` turns the one into the
other.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import functools
import math
from typing import Any, NamedTuple, Protocol, runtime_checkable, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.machine.units import per_metre
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_gaps, fill_smoothly

if TYPE_CHECKING:  # with the effects comes what is compiled
    from ros2_ident.effects import EffectParameter

Mask = npt.NDArray[np.bool_]
Stop = Callable[[], bool]
# The effort before the first cycle is the mean of this much of the log, s.
_BEGINNING = 0.05
# What one sample in a thousand exceeds: a push of 10 ms counts in a log of 10 s, a spike does not.
_QUANTILE = 0.999
# Time over which a speed is a mean, s.
_SPAN = 0.05


@dataclass(frozen=True)
class EffectAt:
    """An effect and where it sits: an output's place (a drive), or `all`."""

    effect: str
    where: str

    @property
    def title(self) -> str:
        """The effect's title and its place."""
        from ros2_ident.effects import title_at

        return title_at(self.effect, [self.where])

    @property
    def prefix(self) -> str:
        """Beginning of its parameters' names: `payload_change.`, `drive_1.stribeck.`."""
        return f'{self.effect}.' if self.where == 'all' else f'{self.where}.{self.effect}.'


@dataclass(frozen=True)
class Output:
    """One signal that is compared with its measurement.

    Attributes:
        name: Unique in the model: `drive_1`, `drive_1.position`.
        weight: What its errors are multiplied with, so that outputs of several units can be
            summed (eq. 2 of Ludwig and Gerstmayr 2011).
        place: What it belongs to: the drive; the name itself where empty.
        quantity: `effort`, `position`, `velocity`, or a word of the model's own.
    """

    name: str
    unit: str
    weight: float = 1.0
    place: str = ''
    quantity: str = 'effort'


@dataclass(frozen=True)
class RecordedMotion:
    """Recorded motion at every controller cycle.

    Attributes:
        values: (2 * D * K,) positions of the drives, then their velocities.
        hold: (D,) effort at the log's start.
    """

    values: Array
    hold: Array


@runtime_checkable
class Model(Protocol):
    """Interface of a model. Shapes: S candidates, N parameters, O outputs, K instants."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The N parameters that can be identified, in the order of theta's columns."""

    @property
    @abstractmethod
    def outputs(self) -> tuple[Output, ...]:
        """The O signals compared."""

    @property
    @abstractmethod
    def cycle(self) -> float:
        """Seconds from one instant to the next."""

    @property
    @abstractmethod
    def measured(self) -> Array:
        """(O, K) measured outputs, NaN where there is no sample."""

    @abstractmethod
    def simulate(self, theta: Array) -> Array:
        """Return (S, O, K) outputs of candidates (S, N); inf where one diverged."""


class FullModel(Model):
    """A model with everything that the program asks for; the defaults are plain and slow.

    Attributes:
        name: Kind of model, in results.
        noise: Standard deviation of the outputs' noise as it is stated, in their unit; 0 where it
            is not.
        machine: The machine file's content; None where the model was not made from one.
        effects: Those in the model beside its nominal physics; their parameters come last.
    """

    name = 'model'
    noise = 0.0
    machine: Machine | None = None
    effects: tuple[EffectAt, ...] = ()

    @functools.cached_property
    def data(self) -> Dataset:
        """The recording on the grid of the model's instants.

        Where the model does not tell more, its measured outputs as efforts.
        """
        none = (None,) * 4
        return Dataset(self.places, self.cycle, 0, *none, self.measured)

    @property
    def thinned(self) -> bool:
        """Whether a recorded motion drives the model: outputs are linear in most parameters.

        Then `measured` is what a low-pass left, as often as that needs.
        """
        return False

    def in_band(self, outputs: Array) -> Array:
        """Return (..., O, K) what that low-pass leaves."""
        return outputs

    @property
    def travel(self) -> tuple[str, float]:
        """Unit of the drives' positions, and how many of them stand for a metre."""
        unit = 'm' if self.machine is None else self.machine.travel_unit
        return unit, per_metre(unit)

    @property
    def places(self) -> tuple[str, ...]:
        """Places of the outputs, each once: the drives."""
        return tuple(dict.fromkeys(o.place or o.name for o in self.outputs))

    @property
    def unit(self) -> str:
        """Unit of costs: that of the first output."""
        return self.outputs[0].unit

    @property
    def effort_unit(self) -> str:
        """Unit of `simulated_effort`."""
        return self.unit

    # ------------------------------------------------------------------ numbers of a fit

    def simulate_at(self, theta: Array, there: Mask) -> Array:
        """Return (S, R) what `simulate` does where `there` (O, K) holds, output by output."""
        return np.asarray(self.simulate(np.atleast_2d(theta))[:, there])

    def residuals(self, theta: Array) -> Array:
        """Return (S, R) weighted measured less simulated outputs, output by output (eq. 1)."""
        measured = self.measured
        there = ~np.isnan(measured)
        out = self.simulate_at(theta, there)
        np.subtract(measured[there], out, out=out)
        weights = np.array([output.weight for output in self.outputs])
        if (weights != 1.0).any():
            out *= np.repeat(weights, there.sum(axis=1))
        return out

    def costs(
        self, theta: Array, limit: float | Array = math.inf, stop: Stop | None = None
    ) -> Array:
        """Return (S,) costs of candidates: eq. 2, the mean of the outputs' weighted RMS errors.

        Args:
            theta: (S, N) candidates.
            limit: Cost above which a lower bound will do, for all or (S,).
            stop: Asked now and then; True where the result is not needed any more.

        Returns:
            (S,) costs; inf where a candidate diverged, a lower bound where one is above `limit`.
        """
        theta = np.atleast_2d(theta)
        if stop is not None and stop():
            return np.full(len(theta), math.inf)
        lengths = (~np.isnan(self.measured)).sum(axis=1)
        ends = np.cumsum(lengths)[:-1]
        parts = np.split(self.residuals(theta), ends, axis=1)
        rms = [np.sqrt(np.mean(p**2, axis=1)) for p in parts if p.shape[1]]
        total: Array = np.mean(rms, axis=0) if rms else np.full(len(theta), math.inf)
        return np.where(np.isfinite(total), total, math.inf)

    def work(self, theta: Array) -> npt.NDArray[np.int64]:
        """Return (S,) how much work candidates (S, N) are; equals are best evaluated together."""
        return np.zeros(len(theta), dtype=np.int64)

    @property
    def described(self) -> tuple[str, ...]:
        """Names of what a description holds, as `as_described` takes them."""
        return ()

    def as_described(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return parameters that a description holds, by name, with what is given put in.

        Args:
            given: Values by name, of `described`, which need not be parameters.
        """
        return {}

    def bodies(self) -> Mapping[str, tuple[Mapping[str, str], tuple[str, ...], Array]]:
        """Return what a body that is fixed to a link adds to the parameters, by the link's joint.

        Returns:
            Units of the k inertials of the body that show, by name, names (E,) of parameters, and
            by how much (E, k) each is more.
        """
        return {}

    def suggested(self) -> Array | None:
        """Return (N,) parameters that the log suggests without a search; None for none."""
        return None

    # ------------------------------------------------------------------ what may be missing

    def extensions(self, *, changed: bool = False) -> tuple[EffectAt, ...]:
        """Return every effect of the catalogue at every place it can sit in this model.

        Args:
            changed: Whether for what two logs differ by: then also one that does what parameters
                do together.
        """
        return ()

    def restricted(self, there: Mask) -> 'FullModel':
        """Return the same model that compares its outputs only where `there` (O, K) holds."""
        return _Restricted(self, there)

    def free_run(self) -> 'FullModel | None':
        """Return the same model, comparing all that its log holds of its drives, run freely.

        None where it is not known to run by set-points alone.
        """
        return None

    # ------------------------------------------------------------------ what a log shows

    def recorded_motion(self) -> RecordedMotion | None:
        """Return the motion that the controllers saw, None where they cannot be replayed."""
        return None

    @property
    def replayed(self) -> Array:
        """(P, K) logged efforts that `replay_law` makes, one of each place; NaN for none."""
        return np.full_like(self.measured, np.nan)

    def replay_law(self, seen: RecordedMotion, theta: Array, there: Mask) -> Array:
        """Return (S, R) what the controllers alone make of the recorded motion.

        Args:
            seen: What `recorded_motion` returned.
            theta: (S, N) candidates.
            there: (O, K) where it is wanted.
        """
        raise NotImplementedError(f'a {self.name} has no controllers that could be replayed')

    def simulated_effort(self, theta: Array) -> Array:
        """Return (O, K) the effort behind each output, for one candidate (N,)."""
        return np.asarray(self.simulate(np.atleast_2d(theta))[0])

    def effort_delay(self, theta: Array) -> Array:
        """Return (O,) how late each output is logged [s], for one candidate (N,)."""
        return np.zeros(len(self.outputs))

    def motor_effort(self, theta: Array, velocity: Array, acceleration: Array) -> Array:
        """Return (O, K) what friction and motor inertia take of the effort.

        Args:
            theta: (N,) a candidate.
            velocity: (O, K) of the outputs' places.
            acceleration: (O, K).
        """
        return np.zeros_like(velocity)

    def effort_limit(self, place: str) -> float:
        """Return the effort that a share of a place's limit refers to; inf where there is none."""
        return math.inf

    def motor_turn(self, place: str) -> float:
        """Return the motor angle per travel of a place [rad/m]; 0 where it is not known."""
        return 0.0

    def highest_order(self, place: str) -> float:
        """Return how many periods a motor turn of a place has at most that outputs show."""
        return math.inf

    # ------------------------------------------------------------------ effects

    def scaled(self, at: EffectAt) -> tuple['EffectParameter', ...]:
        """Return an effect's parameters with the numbers they have at a place, in their units."""
        from ros2_ident.effects import get_effect

        return get_effect(at.effect).parameters

    def carrying(self, held: Array) -> 'FullModel':
        """Return the model that knows when a payload is carried; itself where it carries none.

        Args:
            held: (K,) share of the payload at each instant.
        """
        return self

    def decided(self, theta: Array, noise: Array) -> 'FullModel':
        """Return the model that compares only what the recorded motion decides; itself where all.

        Args:
            theta: (N,) parameters.
            noise: (O,) standard deviation of the outputs' noise.
        """
        return self

    def stating(self, name: str, value: float) -> 'FullModel':
        """Return the model whose machine file states another number; itself where it has none."""
        return self

    def extended(self, effects: Sequence[EffectAt]) -> 'FullModel':
        """Return the model with these effects and no others.

        Raises:
            IdentError: INVALID_GOAL where it cannot have one of them.
        """
        if not effects:
            return self
        raise ErrorCode.INVALID_GOAL.error(
            f'a {self.name} cannot be extended by {effects[0].effect}; its model offers no effects'
        )


class _Completed(FullModel):
    """A model that has the least, with the defaults for the rest."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self.name = str(getattr(model, 'name', type(model).__name__))
        self.noise = float(getattr(model, 'noise', 0.0))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(self._model.parameters)

    @property
    def outputs(self) -> tuple[Output, ...]:
        return tuple(self._model.outputs)

    @property
    def measured(self) -> Array:
        return np.asarray(self._model.measured, dtype=np.float64)

    @property
    def cycle(self) -> float:
        return float(self._model.cycle)

    def simulate(self, theta: Array) -> Array:
        theta = np.atleast_2d(theta)
        told = np.asarray(self._model.simulate(theta), dtype=np.float64)
        shape = (len(theta), *self.measured.shape)
        if told.shape != shape:
            raise ErrorCode.BAD_VALUES.error(
                f'{self.name}.simulate returned the shape {told.shape} for {len(theta)} '
                f'candidates; it has to return {shape}: candidates, outputs, instants'
            )
        return np.where(np.isnan(told), math.inf, told)


class _Restricted(_Completed):
    """A model of which only a part of the samples is compared."""

    def __init__(self, model: FullModel, there: Mask) -> None:
        super().__init__(model)
        self._whole, self.data = model, model.data
        self._measured = np.where(there, model.measured, np.nan)

    @property
    def measured(self) -> Array:
        return self._measured

    def suggested(self) -> Array | None:
        return self._whole.suggested()

    def simulate_at(self, theta: Array, there: Mask) -> Array:
        return self._whole.simulate_at(theta, there)

    def work(self, theta: Array) -> npt.NDArray[np.int64]:
        return self._whole.work(theta)


def complete(model: Any) -> FullModel:
    """Return a model with everything that the program asks for.

    Args:
        model: A `FullModel`, or any object that meets `Model`. For more than the
            defaults derives from `FullModel`.

    Raises:
        IdentError: INVALID_GOAL naming what the object lacks.
    """
    if isinstance(model, FullModel):
        return model
    needed = 'parameters', 'outputs', 'cycle', 'measured', 'simulate'
    if missing := [name for name in needed if not hasattr(model, name)]:
        raise ErrorCode.INVALID_GOAL.error(
            f'a {type(model).__name__} is no model: it has no {", ".join(missing)}; '
            'see ros2_ident.models.protocol.Model'
        )
    return _Completed(model)


def recorded_motion(data: Dataset, drives: Sequence[str]) -> RecordedMotion:
    """Return the motion of the drives, cycles without a sample filled smoothly.

    Args:
        data: The recording on the grid of controller cycles, with position and effort.
        drives: Names, in the order wanted.
    """
    rows = [data.names.index(name) for name in drives]
    assert data.position is not None and data.effort is not None
    positions = [fill_smoothly(data.position[row]) for row in rows]
    if data.velocity is None:
        velocities = [np.gradient(position, data.cycle) for position in positions]
    else:
        velocities = [fill_smoothly(data.velocity[row]) for row in rows]
    first = data.effort[rows, : max(1, int(_BEGINNING / data.cycle))]
    seen = np.isfinite(first)
    hold = np.where(seen, first, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return RecordedMotion(np.concatenate([*positions, *velocities]), hold)


class Scales(NamedTuple):
    """Sizes of what a machine's drives do in its logs: numbers of effects are shares of them.

    So a law is looked for in the same place whatever the units are. What acts on a drive in a
    closed loop has to be paid by its motor, so it shows in the log. A limit that the machine file
    states says less: drives seldom come near theirs, and a file may leave it out.

    Attributes:
        effort: (D,) size of the logged effort that one sample in a thousand exceeds [model's
            unit], at least the noise; a hundred times it for a drive that no recording shows.
        speed: (D,) highest speed over 50 ms [m/s or rad/s]; 1 at rest.
        stroke: (D,) way between the outermost positions [m or rad]; 1 at rest.
        lowest: (D,) the lower one of these [m or rad].
    """

    effort: Array
    speed: Array
    stroke: Array
    lowest: Array


def scales_of(machine: Machine, data: Sequence[Dataset]) -> Scales:
    """Return what the drives of a machine do in its recordings; the largest of them count."""
    count = len(machine.drives)
    effort, speed = np.full(count, 100.0 * machine.effort_noise), np.zeros(count)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    for one in data:
        moved = one.command_position if one.position is None else one.position
        span = max(1, round(_SPAN / one.cycle))
        for d, name in enumerate(machine.drives):
            row = one.names.index(name)
            if moved is not None and np.isfinite(moved[row]).any():
                way = fill_gaps(moved[row])
                fast = np.abs(way[span:] - way[:-span]).max(initial=0.0) / (span * one.cycle)
                speed[d] = max(speed[d], fast)
                low[d], high[d] = min(low[d], way.min()), max(high[d], way.max())
    for d, name in enumerate(machine.drives):
        rows = [one.effort[one.names.index(name)] for one in data if one.effort is not None]
        seen = [np.abs(row[np.isfinite(row)]) for row in rows if np.isfinite(row).any()]
        if seen:
            largest = max(float(np.quantile(size, _QUANTILE)) for size in seen)
            effort[d] = max(largest, machine.effort_noise, 1e-12)
    return Scales(
        effort,
        np.where(speed > 0.0, speed, 1.0),
        np.where(high > low, high - low, 1.0),
        np.where(high >= low, low, 0.0),
    )
