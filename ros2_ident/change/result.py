# SPDX-License-Identifier: Apache-2.0
"""Changes between two sets of logs, as a value."""

from dataclasses import dataclass
from typing import Literal

from ros2_ident.gap.rules import Rules

Kind = Literal['parameter', 'constant', 'effect', 'load']


@dataclass(frozen=True)
class Size:
    """A number of a change with its 95 % interval.

    Attributes:
        name: The parameter, the constant, or the effect's parameter.
        value: By how much it is more after than before; of an effect its value on its side.
        low: Lower end of the interval.
        high: Upper end.
        unit: Unit of all.
        before: Value of one fit of all logs, or as stated; NaN of an effect.
        signed: Whether that may be of either sign, so that shares of it say nothing.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    before: float
    signed: bool = False


@dataclass(frozen=True)
class Suspect:
    """Suspect of a change.

    Attributes:
        kind: What it is.
        name: Parameter or constant; of an effect its id, of a load the joint of its link.
        where: Place of an effect, else empty.
        side: Side on which an effect is there, `after` or `before`.
    """

    kind: Kind
    name: str
    where: str = ''
    side: Literal['after', 'before'] = 'after'


@dataclass(frozen=True)
class Change:
    """A change that was found.

    Attributes:
        suspect: What changed.
        sizes: By how much.
        evidence: Logarithm of the evidence for it over that for nothing.
        ties: What explains as much.
    """

    suspect: Suspect
    sizes: tuple[Size, ...]
    evidence: float
    ties: tuple[Suspect, ...]


@dataclass(frozen=True)
class Visible:
    """The smallest change of a kind that would have shown.

    Attributes:
        suspect: What might have changed.
        name: Its number.
        size: By how much, `unit`; inf where the largest that is looked for would not.
        unit: Unit.
        value: Value of a parameter or constant before; NaN of an effect.
        signed: As of `Size`.
    """

    suspect: Suspect
    name: str
    size: float
    unit: str
    value: float
    signed: bool = False


ApartKind = Literal['check', 'timing', 'zero', 'friction', 'scatter', 'noise', 'motion']


@dataclass(frozen=True)
class Apart:
    """How the sides differ beside what changed in the machine.

    Attributes:
        kind: `check` of log and machine file that holds on one side only, `timing`, `zero` of an
            encoder, `friction` in its form, `scatter` of what fits best and differs by as much
            within a side, `noise` of an output, its standard deviation, or `motion`.
        text: The check's sentence, or the quantity.
        before: Value before; NaN where there is none.
        after: Value after.
        unit: Unit.
    """

    kind: ApartKind
    text: str
    before: float
    after: float
    unit: str


@dataclass(frozen=True)
class Comparison:
    """Result of a comparison of two sides.

    Attributes:
        changes: What changed, the surest first; none where nothing shows.
        explained: Share of the difference that they explain on logs that were not fitted, or on
            parts of them where a side has one log; where encoder steps are all, of the power of
            what is left on one side; NaN where nothing changed.
        smallest: The smallest change of each kind that would have shown, beside those found.
        apart: How the sides differ otherwise; this comes first.
        logs: Number of logs before and after.
        paired: Whether logs were compared in pairs.
        price: Evidence that a change needs beside all that might have changed.
        complete: Whether nothing cut it short.
        pushed: Whether others than the drives made efforts in these logs that no change explains;
            no fit tells what they did from a change.
        friction: Of drives with several changes of friction all of them together, those of `apart`
            too, as the change of their Coulomb friction that does the same along these motions.
    """

    changes: tuple[Change, ...]
    explained: float
    smallest: tuple[Visible, ...]
    apart: tuple[Apart, ...]
    logs: tuple[int, int]
    paired: bool
    price: float
    complete: bool
    pushed: bool = False
    friction: tuple[Size, ...] = ()

    @property
    def believed(self) -> bool:
        """Whether most of the difference is theirs, so that the names of the changes count."""
        return self.explained >= Rules.closed and not self.pushed


@dataclass(frozen=True)
class Between:
    """A comparison of two bags of a fleet.

    Attributes:
        kind: `drift` of one machine, or of one `machine` with another.
        machine: The machine of the bag after.
        before: Name of the bag before.
        after: Name of the bag after.
        found: What was found.
    """

    kind: Literal['drift', 'machine']
    machine: str
    before: str
    after: str
    found: Comparison
