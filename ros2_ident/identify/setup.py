# SPDX-License-Identifier: Apache-2.0
"""From a machine and its data to a problem."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import chosen_drives, Data
from ros2_ident.identify.layout import Conditions, Layout
from ros2_ident.identify.outputs import checked, EFFORT, Outputs, weights_of
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.machine.machine import Machine
from ros2_ident.models import complete, EffectAt, make_model, Model
from ros2_ident.models.drives.candidates import SLOTS
from ros2_ident.models.registry import compared_of, efforts_of
from ros2_ident.recording import Dataset
from ros2_ident.recording.plausibility import standing

T = TypeVar('T')


@dataclass(frozen=True)
class Setup:
    """What a problem is made from, where that is a machine and its data.

    Attributes:
        machine: The machine.
        data: The segments.
        drives: Drives whose effort is compared; all where None.
        fixed: Parameters held at a value: by full name, or `gear_stiffness` for every drive's.
        bounds: (low, high) instead of the machine file's, by the same names.
        effects: Effects beside the nominal physics.
        cutoff: Low-pass of recorded motion where it drives the model [Hz].
        conditions: How the recordings differ.
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
    outputs: Outputs = field(default_factory=lambda: dict(EFFORT))

    def problem(self) -> Problem:
        """Return the machine's model on every segment, as one problem.

        Raises:
            IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, or as `make_model`.
        """
        machine, datasets = self.machine, self.data.datasets
        drives = chosen_drives(machine, self.drives)
        _check_names(machine, self.data, 'effort' in self.outputs)
        weights = self._weights()
        efforts = efforts_of(machine, datasets)
        make = partial(
            make_model, machine, drives=drives, effects=self.effects, cutoff=self.cutoff,
            efforts=efforts, quantities=tuple(self.outputs), weights=weights,
        )  # fmt: skip
        free = make(datasets[0])
        known = [p.name for p in free.parameters]
        everywhere, somewhere = self._held()
        fixed = held_of(machine, free, drives, everywhere)
        models = [make(d, fixed=fixed) for d in datasets]
        layout = Layout(models, self.data.labels, self.conditions)
        if somewhere:
            own = [p.name for p in layout.parameters]
            held = _expanded(own, machine, somewhere, 'fixed')
            layout = Layout(models, self.data.labels, self.conditions, held)
            fixed |= held
        names = dict.fromkeys([*(p.name for p in layout.parameters), *known])
        changed = _expanded(list(names), machine, dict(self.bounds or {}), 'bounded')
        _check_overrides(fixed, changed)
        return Problem(models, layout, bounds=changed, fixed=fixed, setup=self)

    def _held(self) -> tuple[dict[str, float], dict[str, float]]:
        """Return what is held in every recording, and what in one of these."""
        given = dict(self.fixed or {})
        somewhere = {name: value for name, value in given.items() if '@' in name}
        everywhere = {name: value for name, value in given.items() if '@' not in name}
        if self.data.held_out is not None or len(set(self.data.labels)) > 1:
            return everywhere, somewhere
        # A part of one recording knows nothing of the others' values.
        here = {
            name: value
            for name, value in somewhere.items()
            if name.partition('@')[2] in self.data.labels
        }
        return everywhere, here if self.data.labels else somewhere

    def lean(self) -> 'Setup':
        """Return it without what only the process that reads the bag needs."""
        return replace(self, data=replace(self.data, recordings=(), held_out=None))

    def held_out(self) -> Iterator[Problem]:
        """Make the problem of each part of a long log that is held out, one at a time."""
        for dataset, label in self.data.held_out or ():
            yield self._on(Data((dataset,), labels=(label,))).problem()

    def judged_on(self, data: Data) -> Problem:
        """Make the problem of recordings to judge on, for which all share every parameter."""
        shared = {n: value for n, value in (self.fixed or {}).items() if '@' not in n}
        return replace(self._on(data), fixed=shared, conditions=Conditions()).problem()

    def _on(self, data: Data) -> 'Setup':
        # With the weights of what was fitted, so that all of it is in one unit.
        outputs = dict(zip(self.outputs, self._weights(), strict=True))
        return replace(self, data=data, bounds=None, outputs=outputs)

    def _weights(self) -> tuple[float, ...]:
        drives = chosen_drives(self.machine, self.drives)
        return weights_of(self.outputs, self.data.datasets, drives, self.machine.effort_noise)


def problem_of(
    machine: Machine,
    data: Data,
    *,
    drives: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    effects: Sequence[EffectAt] = (),
    cutoff: float = IdentifySettings.cutoff,
    conditions: Conditions | None = None,
    outputs: Outputs | None = None,
) -> Problem:
    """Return a machine's model on every segment, as one problem; arguments as for `Setup`.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, or as `make_model`.
    """
    differ = conditions or Conditions()
    differ.check(data.labels)
    compared = checked(outputs, compared_of(machine))
    machine, moving = at_rest(machine, data.datasets, drives)
    if machine.stands and moving != drives:
        names = ', '.join(machine.stands)
        said = f'{names} stood still: nothing is found of their friction and rotors; their links '
        data = replace(data, warnings=(*data.warnings, f'{said}count as they stood'))
    drives = moving
    return Setup(
        machine, data, drives, fixed, bounds, effects, cutoff, differ, compared
    ).problem()


def at_rest(
    machine: Machine, datasets: Sequence[Dataset], drives: Sequence[str] | None = None
) -> tuple[Machine, tuple[str, ...]]:
    """Return a machine that knows where drives stand in all data, and the drives to compare.

    What a drive's effort is at rest, friction decides: where no drive is chosen, or all are, those
    that stand are not compared.
    """
    chosen = chosen_drives(machine, drives)
    rows = {}
    for name in machine.drives:
        here = [d.position[d.names.index(name)] for d in datasets
                if d.position is not None and name in d.names]  # fmt: skip
        if here and np.isfinite(here[0]).any():
            rows[name] = np.concatenate(here)
    strokes = {name: float(np.nanmax(x) - np.nanmin(x)) for name, x in rows.items()}
    still = standing(strokes)
    if chosen == machine.drives:
        chosen = tuple(name for name in chosen if name not in still)
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
    several = [complete(m) for m in (models if isinstance(models, Sequence) else [models])]
    labels = [str(number) for number in range(1, len(several) + 1)]
    differ = conditions or Conditions()
    differ.check(labels)
    held, box = dict(fixed or {}), dict(bounds or {})
    layout = Layout(several, labels, differ, held)
    known = [*(p.name for p in layout.parameters), *held]
    for name in box:
        if name not in known:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'{name!r} cannot be bounded: no such parameter; choose from {", ".join(known)}',
            )
    _check_overrides(held, box)
    return Problem(several, layout, bounds=box, fixed=held)


def _check_names(machine: Machine, data: Data, effort: bool) -> None:
    if not data.datasets:
        raise IdentError(
            ErrorCode.NO_DATA, 'there is no segment to identify from; record a motion first'
        )
    for dataset in data.datasets:
        missing = [name for name in machine.drives if name not in dataset.names]
        if missing:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                f'the data hold {", ".join(dataset.names)} and not {", ".join(missing)}; '
                "align them with the machine's drives",
            )
        if effort and dataset.effort is None:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                'the data hold no effort; record it, or name the topic that carries it',
            )


def held_of(
    machine: Machine, free: Model, drives: Sequence[str], given: Mapping[str, float]
) -> dict[str, float]:
    """Return what is held in a model, by full name.

    Args:
        machine: The machine.
        free: Its model with nothing held.
        drives: The drives that are compared.
        given: Values by name; `gear_stiffness` means that of every drive.

    Raises:
        IdentError: UNKNOWN_PARAMETER where nothing is called so.
    """
    # Drives that only follow have no free parameters; their gears may be known all the same.
    followers = [
        f'{drive}.{name}'
        for drive in machine.drives
        for name in machine.bounds
        if drive not in drives and name in SLOTS and not SLOTS[name].shared
    ]
    return _expanded([*(p.name for p in free.parameters), *followers], machine, given, 'fixed')


def _expanded(
    known: Sequence[str], machine: Machine, given: Mapping[str, T], what: str
) -> dict[str, T]:
    """Return the entries by full name; the more a name says, the later it counts.

    `coulomb_torque` means that of every drive, and `tool_mass` that of every recording where each
    has its own.
    """
    out: dict[str, T] = {}
    for name, value in sorted(given.items(), key=lambda item: ('.' in item[0], '@' in item[0])):
        names = {name, *(f'{drive}.{name}' for drive in machine.drives)}
        meant = [full for full in known if full in names or full.partition('@')[0] in names]
        if not meant:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'{name!r} cannot be {what}: no such parameter; choose from {", ".join(known)}',
            )
        out.update(dict.fromkeys(meant, value))
    return out


def _check_overrides(
    fixed: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> None:
    for name, value in fixed.items():
        if not np.isfinite(value):
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'{name} cannot be fixed at {value}; give a finite number'
            )
        if name in bounds:
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'{name} is both fixed and bounded; give one of the two'
            )
    for name, (low, high) in bounds.items():
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{name} has the bounds {low:g} to {high:g}; '
                'give a finite lower bound below a finite upper one',
            )
