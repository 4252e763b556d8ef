# SPDX-License-Identifier: Apache-2.0
"""One vector of parameters for several recordings: shared ones, and those of each alone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_yaml
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.protocol import FullModel, Model
from ros2_ident.search.jacobian import Box, Known

T = TypeVar('T')


@dataclass(frozen=True)
class Conditions:
    """How recordings of one machine differ.

    Attributes:
        each: Parameters with a value of their own for every recording; `coulomb_torque` means
            that of every drive.
        known: What is known of a recording, by its label: how much more than the shared value a
            parameter is there, in its unit.
    """

    each: tuple[str, ...] = ()
    known: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.each or self.known)

    def plain(self) -> dict[str, object]:
        """Return the differences as plain data for files; nothing for none."""
        known = {label: dict(values) for label, values in self.known.items()}
        return {'each': list(self.each), 'differences': known} if self else {}

    def check(self, labels: Sequence[str]) -> None:
        """Hold them against the recordings that are there.

        Args:
            labels: (M,) the recording each model belongs to.

        Raises:
            IdentError: INVALID_GOAL where there is no such recording, or only one.
        """
        there = dict.fromkeys(labels)
        strange = [label for label in self.known if label not in there]
        if strange:
            raise ErrorCode.INVALID_GOAL.error(
                f'no recording is called {strange[0]!r}; there are {", ".join(there) or "none"}'
            )
        if self.each and len(there) < 2:
            raise ErrorCode.INVALID_GOAL.error(
                'there is one recording only, so no parameter can differ between recordings; '
                'give several bags, or leave this out'
            )


def read_conditions(each: Sequence[str], path: str | Path | None) -> Conditions:
    """Read the known differences between recordings.

    Args:
        each: Parameters with a value of their own for every recording.
        path: A YAML file, `{bag: {parameter: how much above the shared value}}`; None for none.

    Raises:
        IdentError: INVALID_GOAL where the file cannot be read or says something else.
    """
    if path is None:
        return Conditions(tuple(each))
    try:
        content = read_yaml(path)
        known = {
            str(label): {str(name): float(value) for name, value in values.items()}
            for label, values in content.items()
        }
    except (AttributeError, OverflowError, TypeError, ValueError) as error:
        unread = isinstance(error, AttributeError)
        raise ErrorCode.INVALID_GOAL.error(
            f'{path}: {"holds no parameters by bag" if unread else str(error)[:200]}; write what '
            'differs in each bag, as `with_load: {tool_mass: 0.5}`'
        ) from None
    return Conditions(tuple(each), known)


class Layout:
    """Models of several recordings as one fit: its parameters, and where each finds its own.

    Args:
        models: The models; a parameter of one name is one parameter.
        labels: (M,) the recording each model belongs to.
        held: Parameters that are not to be identified, and their values, by full name.
        box: (low, high) instead of the parameters' own, by full name.

    Attributes:
        parameters: (N,) all parameters in the models' order; where each recording has its own,
            `tool_mass@run_1` and `tool_mass@run_2`.
        low: (N,) lower ends of the box.
        high: (N,) upper ends.

    Raises:
        IdentError: UNKNOWN_PARAMETER or INVALID_GOAL where `conditions` names what is not there.
    """

    def __init__(
        self,
        models: Sequence[FullModel],
        labels: Sequence[str] = (),
        conditions: Conditions | None = None,
        held: Mapping[str, float] | None = None,
        box: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        conditions = conditions or Conditions()
        labels = tuple(labels) or ('',) * len(models)
        self.models = tuple(models)
        every = dict.fromkeys(p.name for m in models for p in m.parameters)
        each = 'have a value for each recording'
        alone = {full for name in conditions.each for full in _meant(every, name, each)}
        found: dict[str, Parameter] = {}
        for parameter in (p for m in models for p in m.parameters):
            names = [parameter.name]
            if parameter.name in alone:
                # Side by side, so that the parameters of effects stay the last ones.
                names = [
                    f'{parameter.name}@{label}'
                    for m, label in zip(models, labels, strict=True)
                    if any(p.name == parameter.name for p in m.parameters)
                ]
            for name in names:
                low, high = (box or {}).get(name, (parameter.low, parameter.high))
                found.setdefault(
                    name, replace(parameter, name=name, low=float(low), high=float(high))
                )
        values = dict(held or {})
        self.parameters: tuple[Parameter, ...] = tuple(
            p for name, p in found.items() if name not in values
        )
        self.names = tuple(p.name for p in self.parameters)
        self.low: Array = np.array([p.low for p in self.parameters])
        self.high: Array = np.array([p.high for p in self.parameters])
        self._held = np.array(list(values.values()))
        # Held values stand behind the free ones.
        at = {n: i for i, n in enumerate([*self.names, *values])}
        self._columns: list[npt.NDArray[np.intp] | None] = []
        self._more: list[Array | None] = []
        for model, label in zip(models, labels, strict=True):
            own = [p.name for p in model.parameters]
            columns = np.array(
                [at[f'{n}@{label}' if n in alone else n] for n in own], dtype=np.intp
            )
            same = not values and len(own) == len(at) and (columns == np.arange(len(at))).all()
            self._columns.append(None if same else columns)
            self._more.append(_more(own, every, label, conditions.known.get(label, {})))

    def own(self, number: int, theta: Array) -> Array:
        """Return (S, N') the parameters of one model among candidates (S, N)."""
        theta, columns, more = np.atleast_2d(theta), self._columns[number], self._more[number]
        if self._held.size:
            theta = np.hstack([theta, np.repeat(self._held[None], len(theta), axis=0)])
        if columns is not None:
            theta = theta[:, columns]
        return theta if more is None else theta + more

    def each(self, theta: Array) -> list[tuple[FullModel, Array]]:
        """Return every model with its own parameters (N') of one candidate (N,)."""
        return [(model, self.own(k, theta)[0]) for k, model in enumerate(self.models)]

    @functools.cached_property
    def box(self) -> Box:
        """The box, with what an earlier result knows of the parameters, by its noise alone."""
        return Box.of(self.low, self.high, self.known(noise=True))

    def known(self, *, noise: bool = False) -> Known | None:
        """Return what an earlier result knows of the parameters; None for nothing.

        Args:
            noise: Whether for noise alone; else with what its model may have lacked.
        """
        machine = self.models[0].machine
        if machine is None or machine.prior is None:
            return None
        rows, mean = machine.prior.rows(self.names, noise=noise)
        width = self.high - self.low
        unit = (mean - self.low) / width
        return Known(rows * width, np.where(np.isnan(unit), 0.5, unit))

    @functools.cached_property
    def suggested(self) -> Array | None:
        """(N,) parameters to begin with; None for none.

        Those that an earlier result knows, else the mean of what the recordings suggest.
        """
        told, known = self._told, self.box.known
        if known is None:
            return told
        seen = known.rows.any(axis=0)
        start = self.box.physical(np.clip(known.mean, 0.0, 1.0))
        return start if told is None else np.where(seen, start, told)

    @property
    def _told(self) -> Array | None:
        """(N,) parameters that the recordings suggest, the mean of all; None for none."""
        total, count = np.zeros(len(self.names)), np.zeros(len(self.names))
        for number, model in enumerate(self.models):
            told, more = model.suggested(), self._more[number]
            if told is None:
                return None
            columns = self._columns[number]
            columns = np.arange(len(told)) if columns is None else columns
            told = told if more is None else told - more
            free = columns < len(total)
            np.add.at(total, columns[free], told[free])
            np.add.at(count, columns[free], 1.0)
        return np.clip(total / np.maximum(count, 1.0), self.low, self.high)


def _meant(known: Iterable[str], name: str, what: str) -> list[str]:
    """Return the full names that a name means, or say what it cannot do: UNKNOWN_PARAMETER.

    `coulomb_torque` means that of every drive, and `tool_mass` that of every recording where each
    has its own.
    """
    found = [
        full
        for full in known
        if name in (full, bare := full.partition('@')[0]) or bare.endswith(f'.{name}')
    ]
    if not found:
        raise ErrorCode.UNKNOWN_PARAMETER.error(
            f'{name!r} cannot {what}: no such parameter is free; choose from {", ".join(known)}'
        )
    return found


def _more(
    own: Sequence[str], every: Iterable[str], label: str, known: Mapping[str, float]
) -> Array | None:
    """Return one recording's known parameter offsets (N'), or None."""
    if not known:
        return None
    more = np.zeros(len(own))
    for name, value in known.items():
        if not np.isfinite(value):
            raise ErrorCode.INVALID_GOAL.error(
                f'{label}: {name} is known to differ by {value}; give a finite number'
            )
        for full in _meant(every, name, 'differ between recordings'):
            if full in own:
                more[list(own).index(full)] += value
    return more


def held_of(
    machine: Machine, free: Model, drives: Sequence[str], given: Mapping[str, float]
) -> dict[str, float]:
    """Return the values held in a model, by full name.

    Args:
        free: Its model with nothing held.
        drives: The drives that are compared.
        given: Values by name; `gear_stiffness` means that of every drive.

    Raises:
        IdentError: UNKNOWN_PARAMETER where nothing is called so; INVALID_GOAL where the machine's
            prior is another one's.
    """
    from ros2_ident.models.drives.candidates import SLOTS

    # Drives that only follow have no free parameters; their gears may be known all the same.
    followers = [
        f'{drive}.{name}'
        for drive in machine.drives
        for name in machine.bounds
        if drive not in drives and name in SLOTS and not SLOTS[name].shared
    ]
    if machine.prior is not None:
        others = [drive for drive in machine.drives if drive not in drives]
        machine.prior.check({p.name: (p.low, p.high, p.unit) for p in free.parameters}, others)
    known = [*(p.name for p in free.parameters), *followers]
    return expanded(known, given, 'be fixed')


def expanded(known: Sequence[str], given: Mapping[str, T], what: str) -> dict[str, T]:
    """Return the entries by full name, see `_meant`; the more a name says, the later it counts."""
    out: dict[str, T] = {}
    for name, value in sorted(given.items(), key=lambda item: ('.' in item[0], '@' in item[0])):
        out.update(dict.fromkeys(_meant(known, name, what), value))
    return out


def check_overrides(fixed: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> None:
    """Refuse parameters fixed or bounded to no number, or both.

    Raises:
        IdentError: INVALID_GOAL, naming the parameter.
    """
    for name, value in fixed.items():
        if not np.isfinite(value):
            raise ErrorCode.INVALID_GOAL.error(
                f'{name} cannot be fixed at {value}; give a finite number'
            )
        if name in bounds:
            raise ErrorCode.INVALID_GOAL.error(
                f'{name} is both fixed and bounded; give one of the two'
            )
    for name, (low, high) in bounds.items():
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ErrorCode.INVALID_GOAL.error(
                f'{name} has the bounds {low:g} to {high:g}; '
                'give a finite lower bound below a finite upper one'
            )
