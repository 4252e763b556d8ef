# SPDX-License-Identifier: Apache-2.0
"""Findings of the checks: values and the words for them."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Literal

from ros2_ident.gates.asked import Asked, Event
from ros2_ident.gates.law import Law
from ros2_ident.gates.scale import ANOTHER, near
from ros2_ident.recording.limits import likewise

Level = Literal['ok', 'warn', 'fail']
# The worst first.
LEVELS: tuple[Level, ...] = ('fail', 'warn', 'ok')
# Of findings that are as bad, one that others follow from comes first.
_CAUSES = (
    'names', 'limit', 'set_point', 'reach', 'tilt', 'weight', 'offset', 'sign', 'scale', 'law',
)  # fmt: skip


@dataclass(frozen=True)
class Gate:
    """Result of one check.

    Attributes:
        gate: `missing`, `jitter`, `sign`, `limit`, `law`, `law_noise`, `gains`, `set_point`,
            `offset`, `names`, `reach`, `tilt`, `weight`, `behind_gears`, `asked`, `not_asked`, or
            the id of the effect that a late set-point shows.
        drive: The drive, empty for the log as a whole.
        level: `ok`, `warn` (the verdict may suffer) or `fail` (no verdict should be trusted).
        contradicts: Whether log and machine file contradict each other, or the model cannot fit
            the log; such a finding comes first.
        key: The constant of the machine file that is to be changed, empty for none.
        cause: Which of several causes the check names, empty where it knows one.
    """

    gate: str
    drive: str
    level: Level
    number: float
    unit: str
    sentence: str
    contradicts: bool = False
    key: str = ''
    cause: str = ''


@dataclass(frozen=True)
class GateReport:
    """All checks, worst first.

    Attributes:
        asked: By recording, how its drives make the efforts that they are asked for.
    """

    gates: tuple[Gate, ...] = ()
    laws: tuple[Law, ...] = ()
    asked: tuple[tuple[Asked, ...], ...] = ()

    def __post_init__(self) -> None:
        def rank(gate: Gate) -> tuple[int, bool, int]:
            cause = _CAUSES.index(gate.gate) if gate.gate in _CAUSES else len(_CAUSES)
            return LEVELS.index(gate.level), not gate.contradicts, cause

        ordered = sorted(dict.fromkeys(self.gates), key=rank)
        object.__setattr__(self, 'gates', tuple(ordered))

    @property
    def pushes(self) -> tuple[Event, ...]:
        """Efforts that were not commanded, of all recordings and drives."""
        return tuple(e for drives in self.asked for asked in drives for e in asked.pushes)

    @property
    def contradictions(self) -> tuple[Gate, ...]:
        """Contradictions between log and machine file, the worst first."""
        return tuple(g for g in self.gates if g.contradicts)

    @property
    def blocked(self) -> bool:
        """Whether a contradiction is such that nothing physical can be said."""
        return any(g.level == 'fail' for g in self.contradictions)

    @property
    def unfit(self) -> bool:
        """Whether a contradiction is such that no effect can be fitted: a wrong gain can."""
        fails = (g for g in self.contradictions if g.level == 'fail')
        return any(not g.key or not near(g.number, ANOTHER) for g in fails)

    @property
    def headline(self) -> str:
        """The worst contradiction in words, empty for none."""
        found = self.contradictions
        if not found:
            return ''
        more = f' ({len(found) - 1} more like it below.)' if len(found) > 1 else ''
        return f'{found[0].sentence.rstrip(".")}.{more}'

    def without(self, gate: str, keep: Collection[str] = ()) -> 'GateReport':
        """Return the report without the findings of a check, but for some drives."""
        kept = [g for g in self.gates if g.gate != gate or g.drive in keep]
        return replace(self, gates=tuple(kept))

    def of(self, gate: str) -> tuple[Gate, ...]:
        """Return the findings of one check."""
        return tuple(g for g in self.gates if g.gate == gate)


def sentences(gates: Iterable[Gate]) -> list[str]:
    """Return findings in words, those of one cause on several drives as the first one's."""
    groups: dict[tuple[object, ...], list[Gate]] = {}
    for gate in gates:
        named = None if gate.drive else gate.sentence
        kind = gate.gate, gate.level, gate.contradicts, gate.unit, gate.key, gate.cause, named
        groups.setdefault(kind, []).append(gate)
    return [
        first.sentence + likewise(g.drive for g in others if g.drive != first.drive)
        for first, *others in groups.values()
    ]
