# SPDX-License-Identifier: Apache-2.0
"""From named parameters to a compiled simulation: what the tripod and the linear axis share."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, KW_ONLY, replace
import functools
import math
from typing import Any, cast, ClassVar

import numpy as np
import numpy.typing as npt

from ros2_ident import lanes
from ros2_ident.arrays import Array
from ros2_ident.effects import CATALOGUE, Context
from ros2_ident.errors import ErrorCode
from ros2_ident.kernel import drive as drive_kernel
from ros2_ident.kernel import law as law_kernel
from ros2_ident.kernel import rows
from ros2_ident.kernel.group import Group, PART, Task
from ros2_ident.machine.keys import NEUTRAL
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.drives.band import firsts
from ros2_ident.models.drives.candidates import Candidates, SLOTS
from ros2_ident.models.drives.log import DriveLog
from ros2_ident.models.drives.outputs import chosen_outputs, logged_of, MachineModel, Outputs
from ros2_ident.models.protocol import EffectAt, recorded_motion, RecordedMotion, scales_of
from ros2_ident.recording.motion import low_pass

# Laws of the controllers by their names.
_LAWS = {
    'cascade_pi': drive_kernel.VELOCITY_FROM_STATE,
    'cascade_p': drive_kernel.VELOCITY_FROM_POSITIONS,
    'position': drive_kernel.POSITION,
    # What is asked for comes in as the set-point's rate, see `LinearAxis`.
    'effort': drive_kernel.POSITION,
}
# Order of the filter that smooths an effort, and candidates whose logs are kept whole at a time.
SMOOTHING, _WHOLE = 2, 64
# Bytes of a processor's cache: the second of most desktops'. By hand.
_CACHE = 1 << 20
# In place of no mass or width, where one is divided by: rotors weigh 1e-7 kg m^2 and less.
_NOTHING = 1e-100
# A controller's motion has to be in the log at this share of its cycles to be replayed.
SEEN = 0.3


# A simulation, the sizes of its state and room, and its arguments from the inputs to the law.
Compiled = tuple[Callable[..., None], tuple[int, int], tuple[Any, ...]]


@dataclass(eq=False, repr=False)
class DriveModel(MachineModel):
    """Drives under their controllers, simulated for many candidates at once.

    Without a command the recorded motion drives the model (inverse mode): motors follow it and the
    torque it takes is the output. Drives that are not compared follow their recorded motion, too;
    positions and velocities, those of the motors, are compared only where controllers follow a
    set-point.

    Attributes:
        held: (K,) share of a payload that is carried at each cycle; None where it is not known.
        compared: (O, K) where outputs are compared; everywhere where None.
        substeps: Integration steps in a controller cycle; None where each candidate's stiffness
            chooses them.
        log: What it reads of its log; None where that is to be done.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, MISSING_STREAM or BAD_MACHINE_FILE with the
        remedy.
    """

    # What the structure has that effects may need, see `effects.Context`.
    features: ClassVar[frozenset[str]] = frozenset()
    # Gains without which no set-point can be followed.
    gains: ClassVar[tuple[str, ...]] = ('position_gain', 'velocity_gain')
    # What reads its log.
    reads: ClassVar[type[DriveLog]] = DriveLog

    _: KW_ONLY
    held: Array | None = None
    compared: npt.NDArray[np.bool_] | None = None
    substeps: int | None = None
    log: DriveLog = field(default=cast(DriveLog, None))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.log is None:
            self.log = self.reads(
                self.machine, self.data, self.drives, self.cutoff, dict(self.fixed)
            )
        self._check_outputs()
        self.scales = self.scales or scales_of(self.machine, [self.data])
        machine, own = self._sought()
        self.candidates = Candidates(
            machine, self.drives, self.effects, self.fixed, self._constants(), self.rigid,
            self.scales, self.travels, own,
        )  # fmt: skip
        _ = self.log.command, self.log.followed  # raises where something is missing
        if self.log.band is not None:
            self.noise *= self.log.band.passes

    # ------------------------------------------------------------------ declaration

    @functools.cached_property
    def law(self) -> npt.NDArray[np.int64]:
        """(D,) the controllers' laws, as the kernels number them."""
        return np.array([_LAWS[law] for law in self.machine.texts('law')], dtype=np.int64)

    def _sought(self) -> tuple[Machine, Mapping[str, Sequence[Parameter]]]:
        """Return the machine with its boxes, and parameters that only its kind has, by key."""
        return self.machine, {}

    def _check_outputs(self) -> None:
        if self.signals.moving and not self.log.closed:
            raise ErrorCode.INVALID_GOAL.error(
                'without a command the recorded motion drives the model and cannot be compared '
                'with it; compare the effort alone, or record the command'
            )

    def extended(self, effects: Sequence[EffectAt]) -> 'DriveModel':
        """Return the model of the same recording with these effects and no others."""
        return replace(self, effects=tuple(effects), compared=None)

    def carrying(self, held: Array) -> 'DriveModel':
        """Return the model with a payload that is carried when `held` (K,) says so."""
        return replace(self, held=held, compared=None)

    def stating(self, name: str, value: float) -> 'DriveModel':
        """Return the model whose machine file states another number, alike for all drives."""
        other = self.machine.with_constants(**{name: value})
        return replace(self, machine=other, log=replace(self.log, machine=other), compared=None)

    def decided(self, theta: Array, noise: Array) -> 'DriveModel':
        """Return the model that leaves out where efforts depend on how the motion is smoothed.

        About a start from rest and a change of direction friction turns over faster than readings
        of a position show.
        """
        if not self.thinned:
            return self
        other = replace(self, log=replace(self.log, plain=self.log))
        apart = other.simulate(theta[None])[0] - self.simulate(theta[None])[0]
        doubtful = np.abs(apart) > noise[:, None]
        if not (doubtful & np.isfinite(self.measured)).any():
            return self
        return replace(self, log=replace(self.log, doubtful=doubtful), compared=None)

    def restricted(self, there: npt.NDArray[np.bool_]) -> 'DriveModel':
        """Return the same model that compares its outputs only where `there` (O, K) holds."""
        return replace(self, compared=there)

    def free_run(self) -> 'DriveModel | None':
        """Return the model that compares all that the log holds; None along a recorded motion."""
        if not self.log.closed:
            return None
        # A simulation of its own makes what it always makes.
        if type(self).simulate is not DriveModel.simulate:
            return replace(self, compared=None)
        logged = logged_of(self.data, self.drives)[int(self.log.pushed) :]
        return replace(self, quantities=logged, weights=None, compared=None)

    def effort_limit(self, place: str) -> float:
        """Return the effort that a share of a drive's limit refers to [`unit`]."""
        return self.candidates.full_effort(self.machine.drives.index(place))

    def motor_turn(self, place: str) -> float:
        """Return the motor angle per travel of a drive [rad/m]; 0 where it is not known."""
        turns = self.candidates.of(self.candidates.base[None], 'motor_turn')
        turn = float(turns[0, self.machine.drives.index(place)])
        return turn if turn != 1.0 else 0.0

    def highest_order(self, place: str) -> float:
        """Return how many periods a motor turn has at most that the band leaves.

        By hand: at a tenth of the drive's highest speed.
        """
        if self.log.band is None:
            return math.inf
        speed = 0.1 * float(self.candidates.scales.speed[self.machine.drives.index(place)])
        return 2.0 * math.pi * self.log.band.cutoff / (speed * (self.motor_turn(place) or 1.0))

    @property
    def effort_unit(self) -> str:
        """Unit of the effort that a log would hold."""
        return self.machine.model_unit

    @functools.cached_property
    def measured(self) -> Array:
        """(O, K) what was measured of `outputs`; NaN where none is compared."""
        band = self.log.band
        measured = self.signals.measured(self.data) if band is None else band.measured
        return measured if self.compared is None else np.where(self.compared, measured, np.nan)

    def in_band(self, outputs: Array) -> Array:
        """Return (..., O, K) what is below the band in which efforts are compared."""
        return outputs if self.log.band is None else self.log.band.low(outputs)

    @property
    def thinned(self) -> bool:
        """Whether the recorded motion drives the model: a band is compared, not the log."""
        return self.log.band is not None

    def recorded_motion(self) -> RecordedMotion | None:
        """Return the motion that the controllers saw, None where they cannot be replayed.

        That takes a set-point, a logged effort, and all drives' motion at a good part of the
        cycles.
        """
        data = self.data
        if not self.log.closed or data.position is None or data.effort is None:
            return None
        often = np.isfinite(data.position).sum(axis=1) > SEEN * data.cycles
        if not (often.all() and np.isfinite(self.replayed).any()):
            return None
        return recorded_motion(data, self.machine.drives)

    @property
    def replayed(self) -> Array:
        """(P, K) logged efforts that `replay_law` makes; NaN where efforts are not compared."""
        compared = self.outputs[0].quantity == 'effort'
        return self.measured if compared else super().replayed

    def extensions(self, *, changed: bool = False) -> tuple[EffectAt, ...]:
        """Return every effect at every place it can sit, see `FullModel.extensions`."""
        context = self.context
        if changed:
            # Each log has zeros of its own.
            known = context.identified | {'log_zero'}
            context = replace(context, combined=frozenset(), identified=known)
        return tuple(
            EffectAt(effect.id, where)
            for effect in CATALOGUE.values()
            if effect.applies(context)
            for where in (self.drives if effect.place == 'drive' else ('all',))
            # the errors of a speed add up on the way: its integral comes back to no place
            if not (effect.family == 'position' and where in self.data.integrated)
        )

    # ------------------------------------------------------------------ candidates to rows

    def _constants(self) -> Array:
        """Return (R,) rows of what the machine file knows, the rest neutral."""
        machine = self.machine
        for key in self.gains:
            if self.log.closed and not self.log.pushed and not machine.known(key):
                raise ErrorCode.BAD_MACHINE_FILE.error(
                    f'the log holds a set-point but the machine file no controller.{key}; add it, '
                    'or let the recorded motion drive the model: `--command-topic none`'
                )
        base = rows.neutral_rows(len(machine.drives))
        of = functools.partial(rows.of, base, drives=len(machine.drives))
        for name in dict.fromkeys((*NEUTRAL, *machine.constants)):
            if name in SLOTS and SLOTS[name].row in rows.MACHINE_ROWS:
                of(SLOTS[name].row)[:] = machine.number(name)
            elif name in SLOTS:
                # Without a set-point no gain is read.
                values = machine.numbers(name)
                of(SLOTS[name].row)[:] = np.where(np.isnan(values), 0.0, values)
        # Where effort is a force, the gear factor is 1 and says nothing of the motor's angle.
        of('motor_turn')[:] = 2.0 * math.pi / machine.numbers('travel_per_turn')
        integral = drive_kernel.VELOCITY_FROM_STATE, drive_kernel.PID
        of('integral_gain')[:, ~np.isin(self.law, integral)] = 0.0
        if not self.log.closed and not machine.stated('coulomb_regularisation'):
            # Nothing is integrated here: friction turns over as the speed is known to.
            of('regularisation')[:] = np.maximum(self.log.speed_errors, _NOTHING)
        return np.asarray(base[0])

    def _derive(self, block: Array) -> None:
        """Fill what follows from other rows of the drives, in every candidate of (S, R)."""

    def _row(self, theta: Array, name: str) -> Array:
        """Return (D,) a named number of the drives compared, of one candidate (N,)."""
        row: Array = self.candidates.of(self.rows(theta), name)[0]
        return np.asarray(row[list(self.signals.places)])

    def rows(self, theta: Array) -> Array:
        """Return (S, R) kernel rows of (S, N) candidates in physical units."""
        return self.candidates.rows(theta, self._derive)

    @property
    def context(self) -> Context:
        """Properties of machine and log that effects may need."""
        base = self.rows(np.array([[0.5 * (p.low + p.high) for p in self.parameters]]))
        return Context(
            drives=len(self.machine.drives),
            identified=frozenset(SLOTS[n].row for n in self.machine.bounds if n in SLOTS),
            closed_loop=self.log.closed and not self.log.pushed,
            elastic=not self.rigid,
            lifted=bool(self.candidates.of(base, 'gravity')),
            integral=bool(self.candidates.of(base, 'integral_gain').any()),
            features=self.features,
            effort='effort' in self.signals.quantities,
            turns=self.held is not None,
        )

    def effort_delay(self, theta: Array) -> Array:
        """Return (D,) how late each drive's effort is logged [s], for one candidate (N,)."""
        return self._row(theta, 'log_delay')

    def motor_effort(self, theta: Array, velocity: Array, acceleration: Array) -> Array:
        """Return (D, K) what friction and a motor's own inertia take of the effort [N m or N]."""
        coulomb, viscous, width, inertia, gear = (
            self._row(theta, name)[:, None]
            for name in ('coulomb', 'viscous', 'regularisation', 'drive_inertia', 'gear')
        )
        friction = coulomb * np.tanh(velocity / np.maximum(width, _NOTHING)) + viscous * velocity
        return np.asarray(friction + inertia * gear * acceleration)

    def work(self, theta: Array) -> npt.NDArray[np.int64]:
        """Return (S,) integration steps in a cycle that candidates (S, N) take near standstill.

        Candidates of the same number share a vector; batches sorted by it are simulated faster.
        """
        return self._steps(self.rows(theta))

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        """Return (S,) integration steps in a cycle, by the gear's and the friction's stiffness.

        The limits come from the convergence study in `docs/figures.md`. While all drives move
        `fast`, friction is as good as constant and the gear alone counts, as where the recorded
        motion tells the speeds.
        """
        if self.substeps is not None:
            return np.full(len(block), self.substeps, dtype=np.int64)
        of, stiff = functools.partial(self.candidates.of, block), self.stiff
        motor, rail = np.maximum(of('motor_mass'), _NOTHING), of('rail_mass')
        need = np.ones(motor.shape)
        if self.log.closed and not fast:
            eps = of('regularisation')
            # Friction that sticks is not stiff: it is solved for.
            slope = np.where(eps > 0.0, of('gear'), 0.0) * (
                self._dry(block)
                / (np.maximum(eps, _NOTHING) * (motor + np.where(stiff, rail, 0.0)))
            )
            need = np.maximum(need, self.cycle * slope / 1.5)
        if self.log.closed:
            # Beside its gear a carriage swings on what it touches, a rigid drive as one mass.
            touched = np.sqrt(self.candidates.contact(block) / np.where(stiff, motor + rail, rail))
            need = np.maximum(need, self.cycle * touched / 0.45)
        if not stiff.all():
            inverse = 1.0 / motor + 1.0 / np.maximum(rail, _NOTHING)
            with np.errstate(invalid='ignore'):  # below 0 it diverges
                omega = np.sqrt(of('gear_stiffness') * inverse)
            swing = self.cycle * np.maximum(omega / 0.45, of('gear_damping') * inverse / 0.9)
            need = np.where(stiff, need, np.maximum(need, swing))
        # A candidate that is no number diverges with any count.
        counts = np.nan_to_num(np.clip(np.ceil(need.max(axis=1)), 1, 64), nan=1.0)
        return np.asarray(counts.astype(np.int64))

    def _dry(self, block: Array) -> Array:
        """Return (S, D) friction that turns over with the direction."""
        return self.candidates.of(block, 'coulomb')

    @property
    def rigid(self) -> bool:
        """Whether nominally motor and carriage move as one mass."""
        return False

    @property
    def stiff(self) -> npt.NDArray[np.bool_]:
        """(D,) whether motor and carriage of a drive move as one mass, effects included."""
        return np.asarray(self.rigid & ~self.candidates.flexible)

    # ------------------------------------------------------------------ simulation

    @property
    def motion(self) -> Array:
        """(3, D, K) the recorded motion that drives the model."""
        return self.log.motion

    @property
    @abstractmethod
    def _kernel(self) -> Compiled:
        """The compiled simulation of a part of the log; see `tripod.kernel.simulate`."""

    def _simulated(
        self, theta: Array, task: Task, stop: Callable[[], bool] | None = None
    ) -> Array:
        """Simulate candidates (S, N), those of equal work side by side; return `task.out`."""
        block = self.rows(theta)
        steps = np.stack([self._steps(block, fast=True), self._steps(block)], axis=1)
        order = np.lexsort(steps.T)
        places, blocks, substeps = _in_lanes(order, block, steps.astype(float))
        run, (state, room), given = self._kernel
        group = Group(blocks, places, substeps, np.empty((len(places), state)))
        space = lanes.room(room)
        cycles = task.wanted.shape[2]
        whole = stop is None and not np.isfinite(task.limits).any()
        # In parts, too, where what all candidates read is more than a processor's cache holds.
        shared = sum(x.nbytes for x in given if isinstance(x, np.ndarray))
        part = cycles if whole and shared < _CACHE else PART
        for begin in range(0, cycles, part):
            if stop is not None and stop():
                task.out.fill(math.inf)
                break
            run(group, space, begin, min(begin + part, cycles), *given, task)
            if (group.rows < 0).all():
                break
            group = group.moved_together()
        return task.out

    def simulate(self, theta: Array) -> Array:
        """Return (S, O, K) outputs of candidates (S, N) at every cycle; inf where one diverged."""
        every = np.ones((len(self.signals), self.data.cycles), dtype=bool)
        return self.simulate_at(theta, every).reshape(-1, *every.shape)

    def simulate_at(self, theta: Array, there: npt.NDArray[np.bool_]) -> Array:
        """Return (S, R) what `simulate` does where `there` (O, K) holds, output by output."""
        theta = np.atleast_2d(np.asarray(theta, dtype=float))
        out = np.empty((len(theta), int(there.sum())))
        if not self._as_a_whole:
            return self._simulated(theta, self.signals.task(there, out))
        for first in range(0, len(theta), _WHOLE):
            part = slice(first, first + _WHOLE)
            out[part] = self._smoothed(theta[part], there)
        return out

    @property
    def _as_a_whole(self) -> bool:
        """Whether outputs are made of the log as a whole, which the kernels never have."""
        return self.thinned or bool(self.candidates.smoothed.any())

    def _smoothed(self, theta: Array, there: npt.NDArray[np.bool_]) -> Array:
        """Return (S, R) outputs of candidates (S, N) in a smoothed log, where `there` holds."""
        out = self._everything(theta, self.signals)
        smoothing = self.candidates.of(self.rows(theta), 'log_smoothing')
        periods = smoothing[:, list(self.signals.sources)]
        efforts = [output.quantity == 'effort' for output in self.outputs]
        finite = np.isfinite(out).all(axis=2)
        smooth, each = (periods > 0.0) & finite & efforts, out.reshape(-1, out.shape[2])
        for period in np.unique(periods[smooth]):
            at = np.flatnonzero(smooth & (periods == period))
            # Most candidates differ on one drive only.
            first = at[firsts([each[i] for i in at])]
            new, again = at[first == at], first != at
            each[new] = low_pass(each[new], self.cycle, 1.0 / period, SMOOTHING)
            each[at[again]] = each[first[again]]
        whole = np.all(finite, axis=1)
        if self.log.band is None or not whole.any():
            return out[:, there]
        if whole.all():
            return self.log.band.passed(out, there)
        told: Array = out[:, there]
        told[whole] = self.log.band.passed(out[whole], there)
        return told

    def simulated_effort(self, theta: Array) -> Array:
        """Return (D, K) the effort that a log of one candidate (N,) would hold."""
        return np.asarray(self._everything(np.atleast_2d(theta), self._efforts)[0])

    @property
    def _efforts(self) -> Outputs:
        return chosen_outputs(self.machine.drives, self.drives, ('effort',), None)

    def _everything(self, theta: Array, signals: Outputs) -> Array:
        """Return outputs (S, O, K) of candidates (S, N)."""
        every = np.ones((len(signals), self.data.cycles), dtype=bool)
        task = signals.task(every, np.empty((len(theta), every.size)))
        return np.asarray(self._simulated(theta, task).reshape(-1, *every.shape))

    def replay_law(
        self, seen: RecordedMotion, theta: Array, there: npt.NDArray[np.bool_]
    ) -> Array:
        """Return (S, R) what the controllers alone make of a motion; see `FullModel.replay_law`.

        No machine is simulated. Each drive's effort is known but for a constant: a log does not
        show what an integral part held before.
        """
        block = self.rows(theta)
        places, blocks = _in_lanes(np.arange(len(block)), block)
        effort, added = self._efforts, self.log.added
        task = effort.task(there, np.empty((len(block), int(there.sum()))))
        law_kernel.replay(
            blocks, places, np.empty(law_kernel.room(len(self.machine.drives))),
            self.log.command.ravel(), seen.values, seen.hold, self.candidates.on,
            self.candidates.delayed, None if added is None else added.ravel(), self.cycle,
            self.law, task,
        )  # fmt: skip
        return task.out

    def costs(
        self, theta: Array, limit: float | Array = math.inf, stop: Callable[[], bool] | None = None
    ) -> Array:
        """Return (S,) costs of candidates (S, N), eq. 2; arguments as of `FullModel.costs`."""
        theta = np.atleast_2d(np.asarray(theta, dtype=float))
        if self._as_a_whole:
            return super().costs(theta, limit, stop)
        limits = np.full(len(theta), limit)
        task = self._costing._replace(limits=limits, out=np.empty((len(theta), 1)))
        return self._simulated(theta, task, stop)[:, 0]

    @functools.cached_property
    def _costing(self) -> Task:
        return self.signals.costing(self.measured)


def _in_lanes(order: npt.NDArray[np.intp], *rows: Array) -> tuple[Any, ...]:
    """Return (G, W) rows in an order, -1 for none, and of each (S, ...) its vectors (G, ...)."""
    groups = -(-len(order) // lanes.WIDTH)
    places = np.full((groups, lanes.WIDTH), -1, dtype=np.int64)
    places.flat[: len(order)] = order
    return places, *(lanes.padded(x[order]).reshape(groups, -1) for x in rows)
