# SPDX-License-Identifier: Apache-2.0
"""The slow twin of each kind of machine: a module of this folder with `TWIN`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import functools
import importlib
import pkgutil

from checks.reference.plant import Log, Plant
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine


@dataclass(frozen=True)
class Twin:
    """The reference of a kind of machine.

    Attributes:
        plant: `plant(machine, parameters)`: the nominal machine, open to effects.
        simulate: `simulate(machine, parameters, position, velocity, effects, rtol, atol)`: one
            log from set-points (D, K) [m] and their derivatives [m/s].
    """

    kind: str
    plant: Callable[[Machine, Mapping[str, float]], Plant]
    simulate: Callable[..., Log]


@functools.cache
def _twins() -> Mapping[str, Twin]:
    """Return the twins by the name of their kind."""
    package = importlib.import_module('checks.reference')
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
    if machine.kind not in _twins():
        raise IdentError(
            ErrorCode.UNKNOWN_MODEL,
            f'there is no reference of a {machine.kind} here; use {" or ".join(_twins())}',
        )
    return _twins()[machine.kind]
