# SPDX-License-Identifier: Apache-2.0
"""The catalogue: every module of this folder that defines EFFECT is one effect.

Other packages add theirs by entry points, users by files of their own; see `loading`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ros2_ident.effects.effect import Context, Detector, DriveState, Effect, EffectParameter, Hook
from ros2_ident.effects.loading import Catalogue
from ros2_ident.errors import ErrorCode, IdentError

_KNOWN = Catalogue(__name__, __path__)
CATALOGUE: Mapping[str, Effect] = MappingProxyType(_KNOWN.effects)


def add_effect_files(paths: Sequence[str]) -> None:
    """Make effects known that lie in files of their own, one each.

    Processes that simulate for this one learn of them by an environment variable.

    Args:
        paths: Python files that define EFFECT.

    Raises:
        IdentError: INVALID_GOAL where a file holds no effect, its id is taken, or the simulations
            are composed already: effects come before anything else of the package is imported.
    """
    _KNOWN.add_files(paths)


def composed() -> tuple[Effect, ...]:
    """Return all effects for good: for those who compose the simulations of them."""
    return _KNOWN.close()


def sources() -> Mapping[Path, str]:
    """Return files outside this package that effects were read from, and their modules' names."""
    return MappingProxyType(_KNOWN.sources)


def title_at(effect_id: str, where: Iterable[str] = ()) -> str:
    """Return an effect's title at its places, its id where the catalogue lacks it.

    Args:
        effect_id: Its id.
        where: Drives; none or `all` for the machine as a whole.
    """
    effect = CATALOGUE.get(effect_id)
    title = effect.title if effect else effect_id
    drives = ', '.join(name for name in where if name != 'all')
    return f'{title} on {drives}' if drives else title


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
    'add_effect_files',
    'composed',
    'get_effect',
    'shown_by',
    'sources',
]
