# SPDX-License-Identifier: Apache-2.0
"""The catalogue: every module of this folder that defines EFFECT is one effect."""

from collections.abc import Mapping
import importlib
import pkgutil
from types import MappingProxyType

from ros2_ident.effects.effect import Context, Detector, DriveState, Effect, EffectParameter, Hook
from ros2_ident.errors import ErrorCode, IdentError


def _load() -> dict[str, Effect]:
    found = {}
    for module in sorted(name for _, name, _ in pkgutil.iter_modules(__path__)):
        effect = getattr(importlib.import_module(f'{__name__}.{module}'), 'EFFECT', None)
        if effect is not None:
            found[effect.id] = effect
    return found


CATALOGUE: Mapping[str, Effect] = MappingProxyType(_load())


def get_effect(name: str) -> Effect:
    """Return an effect by its id.

    Raises:
        IdentError: UNKNOWN_PARAMETER naming the known ids.
    """
    try:
        return CATALOGUE[name]
    except KeyError:
        raise IdentError(
            ErrorCode.UNKNOWN_PARAMETER,
            f'no effect is called {name!r}; choose from {", ".join(CATALOGUE)}',
        ) from None


def twins(name: str) -> frozenset[str]:
    """Return an id with those that are the same answer; alone where the catalogue lacks it."""
    return frozenset({name, *CATALOGUE[name].twins}) if name in CATALOGUE else frozenset({name})


def shown_by(detector: Detector) -> Effect | None:
    """Return the effect that something of a log shows by itself; None where there is none."""
    return next((e for e in CATALOGUE.values() if e.shown_by == detector), None)


__all__ = [
    'CATALOGUE',
    'Context',
    'DriveState',
    'Effect',
    'EffectParameter',
    'Hook',
    'get_effect',
    'shown_by',
    'twins',
]
