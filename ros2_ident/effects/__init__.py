# SPDX-License-Identifier: Apache-2.0
"""The catalogue: every effect that a module of this folder defines, by itself or in a tuple.

Other packages add theirs by entry points, users by files of their own. The kernels are composed of
all effects once, so these have to be known before; an environment variable tells the files to
processes that simulate for this one.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import hashlib
import importlib
from importlib.metadata import entry_points
import importlib.util
import os
from pathlib import Path
import pkgutil
import sys
from types import MappingProxyType, ModuleType
from typing import Any

from ros2_ident.effects.effect import Context as Context
from ros2_ident.effects.effect import Detector
from ros2_ident.effects.effect import DriveState as DriveState
from ros2_ident.effects.effect import Effect as Effect
from ros2_ident.effects.effect import EffectParameter as EffectParameter
from ros2_ident.effects.effect import Hook as Hook
from ros2_ident.errors import ErrorCode
from ros2_ident.files import unreadable

# Paths of files with effects, separated as in PATH.
VARIABLE = 'ROS2_IDENT_EFFECTS'
# Entry points of other packages: a module with EFFECT, or an `Effect`.
GROUP = 'ros2_ident.effects'
# Parameters that a kernel takes at most, and hooks that write memories.
_MOST, _REMEMBERING = 3, (Hook.SIGN, Hook.FRICTION, Hook.COMMAND)
# Which of several of an effect, in titles.
_WHICH = 'first', 'second', 'third'


class Catalogue:
    """All effects by id.

    Attributes:
        effects: By their ids.
        sources: Files outside this package that they were read from, each with its module's name.
        closed: Whether the kernels are composed, so that no other effect can come.
    """

    def __init__(self, package: str, folders: Sequence[str]) -> None:
        self.effects: dict[str, Effect] = {}
        self.sources: dict[Path, str] = {}
        self.closed = False
        names = [name for _, name, _ in pkgutil.iter_modules(folders)]
        modules = [vars(importlib.import_module(f'{package}.{name}')) for name in names]
        told = [e for x in modules for e in (*x.values(), *x.get('EFFECTS', ()))]
        own = (effect for effect in told if isinstance(effect, Effect))
        for effect in sorted(own, key=lambda effect: effect.id):
            self._add(effect, package)
        for effect, source, module in _of_packages():
            self._add(effect, source)
            self.sources[Path(str(module.__file__)).resolve()] = module.__name__
        self.add_files(filter(None, os.environ.get(VARIABLE, '').split(os.pathsep)))

    def add_files(self, paths: Iterable[str]) -> None:
        """Make effects known that lie in files of their own, one each.

        Processes that simulate for this one learn of them by an environment variable.

        Args:
            paths: Python files that define EFFECT.

        Raises:
            IdentError: INVALID_GOAL where a file holds no effect, its id is taken, or the
                simulations are composed already: effects come before anything else of the package
                is imported.
        """
        for path in (Path(given).expanduser().resolve() for given in paths):
            if path in self.sources:
                continue
            if self.closed:
                raise ErrorCode.INVALID_GOAL.error(
                    f'{path.name}: the simulations are compiled without it already; name the file '
                    f'in the environment variable {VARIABLE}, or call add_effect_files before '
                    'anything else of ros2_ident is imported'
                )
            found = _imported(path)
            self._add(getattr(found, 'EFFECT', None), path.name)
            self.sources[path] = found.__name__
            told = [*filter(None, os.environ.get(VARIABLE, '').split(os.pathsep)), str(path)]
            os.environ[VARIABLE] = os.pathsep.join(dict.fromkeys(told))

    def close(self) -> tuple[Effect, ...]:
        """Freeze the catalogue and return it; the kernels are compiled from it."""
        self.closed = True
        return tuple(self.effects.values())

    def _add(self, effect: Any, source: str) -> None:
        wrong = _wrong(effect)
        if not wrong and effect.id in self.effects:
            wrong = f'the catalogue has an effect {effect.id} already; give it another id'
        if wrong:
            raise ErrorCode.INVALID_GOAL.error(f'{source}: {wrong}')
        self.effects[effect.id] = effect
        for number, which in list(enumerate(_WHICH, 1))[1 : effect.most]:
            own = {'id': f'{effect.id}_{number}', 'title': f'{which} {effect.title}'}
            again = replace(effect, **own, number=number, variant_of=effect.id)
            self.effects[again.id] = again


def _wrong(effect: Any) -> str:
    """Return what is wrong with what should be an effect; empty for nothing."""
    if not isinstance(effect, Effect):
        return 'it defines no EFFECT; write EFFECT = Effect(...), see docs/extend.md'
    if not effect.id.isidentifier() or not effect.id.islower():
        return f'{effect.id!r} is no id; write it like rubber_buffer'
    if effect.kernel is not None and not 1 <= len(effect.parameters) <= _MOST:
        return f'{effect.id} has {len(effect.parameters)} parameters; give it one to {_MOST}'
    if effect.keeps is not None and effect.hook not in _REMEMBERING:
        return (
            f'{effect.id} is an effect of {effect.hook.name}, which has no memory; leave `keeps` '
            f'out, or choose from {", ".join(hook.name for hook in _REMEMBERING)}'
        )
    return ''


def _imported(path: Path) -> ModuleType:
    """Import a file under a name that its content gives it, wherever it lies.

    What numba keeps of a kernel says where its parts came from by the names of their modules.
    """
    if not path.is_file():
        text = f'{path}: {unreadable(path) or "is a folder"}; name the file that defines EFFECT'
        raise ErrorCode.INVALID_GOAL.error(text)
    name = f'ros2_ident_effect_{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}'
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ErrorCode.INVALID_GOAL.error(
            f'{path.name} is no Python file; name one that ends with .py'
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ErrorCode.INVALID_GOAL.error(
            f'{path.name} cannot be imported, {type(error).__name__}: {error}; correct the file'
        ) from error
    return module


def _of_packages() -> Iterator[tuple[Any, str, ModuleType]]:
    """Yield effects of other packages, each with its name and its module."""
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        found = point.load()
        yield getattr(found, 'EFFECT', found), point.value, sys.modules[point.module]


_KNOWN = Catalogue(__name__, __path__)
CATALOGUE: Mapping[str, Effect] = MappingProxyType(_KNOWN.effects)
SOURCES: Mapping[Path, str] = MappingProxyType(_KNOWN.sources)
add_effect_files, composed = _KNOWN.add_files, _KNOWN.close


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
        raise ErrorCode.UNKNOWN_PARAMETER.error(
            f'no effect is called {name!r}; choose from {", ".join(CATALOGUE)}'
        ) from None


def shown_by(detector: Detector) -> Effect | None:
    """Return the effect that something of a log shows by itself; None where there is none."""
    return next((e for e in CATALOGUE.values() if e.shown_by == detector), None)
