# SPDX-License-Identifier: Apache-2.0
"""The catalogue: every module of this folder that defines EFFECT is one effect."""

from collections.abc import Mapping
import importlib
import pkgutil
from types import MappingProxyType

from ros2_ident.effects.effect import DriveState, Effect, EffectParameter, Hook
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


__all__ = ['CATALOGUE', 'DriveState', 'Effect', 'EffectParameter', 'Hook', 'get_effect']
