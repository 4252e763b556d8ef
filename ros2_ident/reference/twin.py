# SPDX-License-Identifier: Apache-2.0
"""The slow twin of each kind of machine: a module of this folder with `TWIN`, or from elsewhere.

Another package adds one by an entry point of the group `ros2_ident.twins`: its name is the
kind's, its object a `Twin`.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
import functools
import importlib
from importlib.metadata import entry_points
import pkgutil

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.reference.plant import Array, Log, Plant
from ros2_ident.reference.space import Space

ENTRY_POINTS = 'ros2_ident.twins'


def _as_they_are(points: Array, speeds: Array, machine: Machine) -> tuple[Array, Array]:
    return points, speeds


@dataclass(frozen=True)
class Twin:
    """The reference of a kind of machine.

    Attributes:
        kind: Name of the kind.
        plant: `plant(machine, parameters)`: the nominal machine, open to effects.
        simulate: `simulate(machine, parameters, position, velocity, effects, rtol, atol)`: one
            log from set-points (D, K) [m] and their derivatives [m/s].
        space: Where it moves by itself.
        set_points: `set_points(points, speeds, machine)`: set-points (D, K) and their derivatives
            of a way (M, K) through its space.
        platform: Whether its drives carry a platform on rods.
        described: Parameters that a description holds: true as described where nobody says
            otherwise.
    """

    kind: str
    plant: Callable[[Machine, Mapping[str, float]], Plant]
    simulate: Callable[..., Log]
    space: Callable[[Machine], Space]
    set_points: Callable[[Array, Array, Machine], tuple[Array, Array]] = _as_they_are
    platform: bool = False
    described: tuple[str, ...] = ()


@functools.cache
def own_twins() -> Mapping[str, Twin]:
    """Return the twins of this package by the name of their kind."""
    package = importlib.import_module('ros2_ident.reference')
    modules = (
        importlib.import_module(f'{package.__name__}.{name}')
        for _, name, _ in pkgutil.iter_modules(package.__path__)
    )
    found = (getattr(module, 'TWIN', None) for module in modules)
    return {twin.kind: twin for twin in found if isinstance(twin, Twin)}


def twin_of(machine: Machine) -> Twin:
    """Return the twin of a machine.

    Raises:
        IdentError: UNKNOWN_MODEL where its kind has none.
    """
    for twin in _twins(machine.kind):
        return twin
    raise IdentError(
        ErrorCode.UNKNOWN_MODEL,
        f'there is no reference of a {machine.kind} here; use {" or ".join(own_twins())}',
    )


def _twins(kind: str) -> Iterator[Twin]:
    if kind in own_twins():
        yield own_twins()[kind]
    for point in entry_points(group=ENTRY_POINTS, name=kind):
        twin = point.load()
        if isinstance(twin, Twin):
            yield twin
