# SPDX-License-Identifier: Apache-2.0
"""An effect: data, and a small kernel that fills one hook of a simulation step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import enum
from typing import Any, Literal, NamedTuple

Group = Literal['structure', 'drive', 'controller', 'measurement']
# What of a log can show an effect by itself, before any fit: the logged effort does not go beyond
# a size; what the controllers miss has the period of an encoder's steps over the position; they
# take up their set-points late; the mass that is missing jumps, for a load comes and goes.
Detector = Literal['flat_top', 'reading_steps', 'late_set_point', 'load']


@dataclass(frozen=True)
class Context:
    """Properties of a machine and its log that an effect may need.

    Attributes:
        drives: Number of drives.
        identified: Rows of the kernel (see `kernel.rows`) that parameters of the machine file
            fill: what is nominal here is no effect.
        closed_loop: Whether controllers follow a set-point; else the recorded motion drives.
        elastic: Whether motor and carriage are joined by a gear that gives.
        lifted: Whether gravity acts along the drives.
        integral: Whether a controller has an integral part.
        features: What the structure has, such as `platform`.
        effort: Whether logged efforts are compared.
        turns: Whether the log shows when a payload is carried.
        combined: Rows that parameters of the machine file make up together: nothing is missing
            there, though between two logs it may change as one.
    """

    drives: int = 1
    identified: frozenset[str] = frozenset()
    closed_loop: bool = True
    elastic: bool = False
    lifted: bool = False
    integral: bool = False
    features: frozenset[str] = frozenset()
    effort: bool = True
    turns: bool = False
    combined: frozenset[str] = frozenset()


def anywhere(context: Context) -> bool:
    """Need nothing of a machine."""
    return True


def closed_loop(context: Context) -> bool:
    """Need controllers that follow a set-point."""
    return context.closed_loop


def elastic_gear(context: Context) -> bool:
    """Need a gear that gives."""
    return context.elastic


def platform(context: Context) -> bool:
    """Need rods and a platform."""
    return 'platform' in context.features


def turns(context: Context) -> bool:
    """Whether payload pick-ups can be seen: a platform, and a log that shows them."""
    return platform(context) and context.turns


def motor_torque(context: Context) -> bool:
    """Need motors whose torque is simulated apart from the load's."""
    return 'motor_torque' in context.features


class Hook(enum.Enum):
    """Place of an effect in a simulation step, and the quantity that its kernel changes.

    A kernel of a per-drive hook is `kernel(value, drive, p) -> value`: `value` is what the step
    would use without the effect, `drive` a `DriveState`, `p` the tuple of the effect's parameters;
    all are `Lanes`, but DEFLECTION's value, which is a pair of them.
    PARAMETER effects have no kernel: each of their parameters names what it is added to or
    multiplied with. So may a parameter of another effect, which its kernel then leaves alone.
    """

    SIGN = 'direction of friction, -1..1: nominally tanh(v / regularisation)'
    FRICTION = 'friction torque at the motor [N m]'
    TORQUE = 'torque the motor makes at its present place [N m]'
    DEFLECTION = 'deflection of the gear that makes force [m], and its slope over the motor'
    STIFFNESS = 'stiffness of the gear [N/m]'
    CARRIAGE_FORCE = 'force on the carriage besides gear, gravity and rod [N]'
    READING = 'motor position as the controller reads it [m]'
    COMMAND = 'torque asked of the motor, mean of a cycle, nominally the logged one [N m]'
    PARAMETER = 'a parameter that the step or the log has anyway, at its neutral value'


class DriveState(NamedTuple):
    """Arguments of a per-drive kernel; every field is a `Lanes` value.

    Attributes:
        position: Motor position referred to the rail [m].
        velocity: Its rate [m/s].
        carriage: Carriage position [m].
        load: Force the gear carries [N].
        direction: Direction of motion for friction, -1..1.
        coulomb: Nominal Coulomb friction [N m] (N on an axis with force as effort).
        viscous: Nominal viscous friction [N m s/m].
        gear: Force per torque [1/m]; 1 on an axis with force as effort.
        turn: Motor angle per travel [rad/m].
        time: Time since the start of the log [s].
        elapsed: Time since the present torque was commanded [s]; for COMMAND, and where `keeps` of
            FRICTION is asked, the cycle.
        travel: Way gone since SIGN effects with a memory wrote theirs [m].
        torque: Torque the motor makes [N m], but for effects of TORQUE.
        memory: What the effect's own `Effect.keeps` returned last; 0 where it has none.
    """

    position: Any
    velocity: Any
    carriage: Any
    load: Any
    direction: Any
    coulomb: Any
    viscous: Any
    gear: Any
    turn: Any
    time: Any
    elapsed: Any
    travel: Any
    torque: Any
    memory: Any


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    Attributes:
        name: Short name, unique within the effect.
        unit: SI unit as text, of a carriage. Its numbers are shares of what the drive does in
            the log, see `models.protocol.Scales`: `effort` (N m or N, whichever the machine logs)
            of the size of the logged effort, `force` of that effort at the load (N, or N m of a
            joint), `load` (kg) of the mass that this holds, a metre away where joints turn, m of
            the stroke, m/s of the highest speed, W of force times speed. What else is of the
            machine and not of a drive (see `kernel.rows`) is in SI units.
        low: Lower bound of the search, physical sign included.
        high: Upper bound of the search.
        neutral: Value at which the effect vanishes, or that means nothing while another parameter
            is neutral.
        starts: Values to start a local search from, where one start would be caught in a local
            minimum.
        role: `size` switches the effect off at its neutral value; `shape` only shapes it;
            `position` and `time` are shapes whose starts follow the log: places the drive visits,
            its numbers being strokes from the lowest one, and instants of the log. A position
            with `starts` has those.
        target: The kernel's row (see `kernel.rows`) it acts on; empty where the effect's kernel
            does.
        how: With a target: whether it is added to the row, multiplied with it, or replaces it.
        limit: Id of what the law comes to beyond the parameter's bounds; empty for none.
        symbol: Its sign in the effect's equation; empty where it has none there.
        meaning: What it is, in words, where its name alone does not say it.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    starts: tuple[float, ...] = ()
    role: Literal['size', 'shape', 'position', 'time', 'order'] = 'size'
    target: str = ''
    how: Literal['add', 'scale', 'set'] = 'add'
    limit: str = ''
    symbol: str = ''
    meaning: str = ''


def pressing(unit: str, high: float, sign: str) -> tuple[EffectParameter, ...]:
    """Return coefficients of the motor's torque and of the load, which press a gear together."""
    each = ('motor', 'M', 'the motor torque'), ('load', 'F', 'the load')
    box = unit, 0.0, high, 0.0, (0.1,)
    return tuple(
        EffectParameter(name, *box, symbol=f'{sign}_{of}', meaning=f'coefficient of {what}')
        for name, of, what in each
    )


def fading() -> EffectParameter:
    """Return the speed over which friction fades, of Stribeck."""
    return EffectParameter(
        'velocity', 'm/s', 0.005, 1.0, 0.03, (0.03, 0.1, 0.3), 'shape', symbol='v_S',
        meaning='speed over which it fades',
    )  # fmt: skip


def along_rail(name: str, symbol: str, meaning: str, limit: str = '') -> EffectParameter:
    """Return a parameter that is a position on a rail."""
    return EffectParameter(
        name, 'm', -1.0, 2.0, 0.5, role='position', limit=limit, symbol=symbol, meaning=meaning
    )


@dataclass(frozen=True)
class Effect:
    """One deviation of a real machine from its nominal model.

    Attributes:
        id: Name in results.
        title: Name in sentences.
        equation: The law, in plain text.
        source: Reference of the law.
        parameters: Its parameters; all at their neutral values switch it off.
        family: Structural class: effects of one family look alike on ordinary motions.
        confusable: Ids of effects that one log may not tell apart from this one.
        separated_by: The motion that would, as an instruction with `{drive}` for the place.
        group: What the effect sits on.
        hook: Where it acts.
        kernel: The hook's kernel, compiled by numba; None for PARAMETER.
        place: `drive` where each drive can have its own, `all` where the machine has one.
        keeps: For SIGN, FRICTION and COMMAND effects with a memory of their own: asked as the
            kernel, returns what to remember. COMMAND and FRICTION effects are asked once a cycle,
            SIGN effects after each integration step; `value` is the nominal one as the effects
            with a memory before it in the chain leave it. The first memory is the starting torque
            for COMMAND, else zero.
        needs: Whether a machine has what the effect acts on; see `applies`.
        twins: Ids of effects that no log tells from this one: one answer under several names.
        holds: Ids of effects that this one is, to any log, where some of its sizes vanish.
        variant_of: Id of an effect that has the same cause and another course.
        shown_by: What of a log shows the effect by itself; `gap` looks for it.
        bent: Whether it bends along the way: it has to do more than a smooth function of that.
        most: How many of it one place may have, as several orders of a ripple.
        number: Which of these it is; the catalogue makes those behind the first.
        about: What it is, in a sentence, where its module does not begin with that.
    """

    id: str
    title: str
    equation: str
    source: str
    parameters: tuple[EffectParameter, ...]
    family: str
    confusable: tuple[str, ...]
    separated_by: str
    group: Group = 'drive'
    hook: Hook = Hook.PARAMETER
    kernel: Callable[..., Any] | None = None
    place: Literal['drive', 'all'] = 'drive'
    keeps: Callable[..., Any] | None = None
    needs: Callable[[Context], bool] = anywhere
    twins: tuple[str, ...] = ()
    holds: tuple[str, ...] = ()
    variant_of: str = ''
    shown_by: Detector | None = None
    bent: bool = False
    most: int = 1
    number: int = 1
    about: str = ''

    @property
    def further(self) -> str:
        """Id of the next of several, looked for beside this one; empty for none."""
        return f'{self.variant_of or self.id}_{self.number + 1}' if self.number < self.most else ''

    @property
    def reads(self) -> frozenset[str]:
        """Fields of `DriveState` that its law reads; none for some that act on a parameter."""
        law = getattr(self.kernel, 'py_func', self.kernel)
        names = law.__code__.co_names if law else (p.target for p in self.parameters)
        return frozenset(DriveState._fields).intersection(names)

    def ended(self, shares: Sequence[float]) -> list[EffectParameter]:
        """Return parameters that ended at bounds, but for nothing, by all as shares of boxes."""
        return [
            p
            for p, x in zip(self.parameters, shares, strict=True)
            if round(x, 3) in (0.0, 1.0) and p.neutral != (p.low, p.high)[round(x)]
        ]

    def applies(self, context: Context) -> bool:
        """Whether a machine can have the effect.

        It has what the effect needs, and does not identify all the sizes anyway: a parameter of
        the machine file is no deviation from it. What sits in the measurement of an effort does
        not show where none is compared. One of several is looked for beside those before it only.
        """
        if self.number > 1:
            return False
        if self.group == 'measurement' and not context.effort:
            return False
        sizes = {p.target for p in self.parameters if p.role == 'size'}
        known = context.identified | context.combined
        return not sizes <= known and self.needs(context)
