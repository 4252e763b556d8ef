# SPDX-License-Identifier: Apache-2.0
"""The hooks of a simulation step: for each, one function that runs the effects that are on.

Which effects are on is the same for all candidates of a batch, so the branch on it costs next to
nothing and nothing is compiled again when another effect is tried.
"""
# mypy: ignore-errors

from collections import namedtuple
import functools
import hashlib
import itertools
from pathlib import Path

from ros2_ident.compiled import digest_of
from ros2_ident.effects import DriveState, Hook, SOURCES
from ros2_ident.kernel.rows import bit, effect_row, KEEPING_EFFECTS, KERNEL_EFFECTS, memory_row
from ros2_ident.lanes import inlined, load, load_three, store, where, WIDTH

W = WIDTH


@inlined
def _gather1(par, row):
    return (load(par, row * W),)


@inlined
def _gather2(par, row):
    return (load(par, row * W), load(par, (row + 1) * W))


_GATHER = {1: _gather1, 2: _gather2, 3: load_three}


def _of(effect):
    """Return what gathers an effect's parameters, its flag and its first row."""
    return _GATHER[len(effect.parameters)], bit(effect.id), effect_row(effect.id)


@inlined
def _remembering(drive, memory):
    """Return the state with an effect's own memory in it."""
    return DriveState(*(drive[:-1] + (memory,)))


@inlined
def _unchanged(value, drive, on, par, first, mem, own):
    return value


@inlined
def _unkept(value, drive, on, par, first, mem, own, active):
    return value


@inlined
def _unbegun(mem, own, value):
    pass


def _link(before, effect):
    """Return the chain `before` with an effect behind it."""
    gather, mask, row = _of(effect)
    kernel = effect.kernel
    kept = None if effect.keeps is None else memory_row(effect.id)

    @inlined
    def after(value, drive, on, par, first, mem, own):
        value = before(value, drive, on, par, first, mem, own)
        if on & mask:
            if kept is not None:
                drive = _remembering(drive, load(mem, (own + kept) * W))
            value = kernel(value, drive, gather(par, first + row))
        return value

    return after


def _link_keeping(before, effect):
    """Return what `before` writes and an effect's memory behind it, in the active lanes.

    What goes on to the next is what the effect makes of the value with the memory it had.
    """
    gather, mask, row = _of(effect)
    kernel, keeps, kept = effect.kernel, effect.keeps, memory_row(effect.id)

    @inlined
    def after(value, drive, on, par, first, mem, own, active):
        value = before(value, drive, on, par, first, mem, own, active)
        if on & mask:
            old = load(mem, (own + kept) * W)
            state = _remembering(drive, old)
            p = gather(par, first + row)
            new = keeps(value, state, p)
            if active is not None:
                new = where(active, new, old)
            store(mem, (own + kept) * W, new)
            value = kernel(value, state, p)
        return value

    return after


def _link_begun(before, effect):
    """Return what `before` writes, and `value` as an effect's first memory."""
    kept = memory_row(effect.id)

    @inlined
    def after(mem, own, value):
        before(mem, own, value)
        store(mem, (own + kept) * W, value)

    return after


def _chain(link, start, effects, hook):
    return functools.reduce(link, (e for e in effects if e.hook is hook), start)


def _compose(hook):
    return _chain(_link, _unchanged, KERNEL_EFFECTS, hook)


def _masks(effects):
    """Return the flags of the effects in each hook, by its name: `MASK.SIGN`."""
    names = [hook.name for hook in Hook]
    return namedtuple('Masks', names)(
        *(sum(bit(e.id) for e in effects if e.hook is hook) for hook in Hook)
    )


MASK, KEEPING = _masks(KERNEL_EFFECTS), _masks(KEEPING_EFFECTS)
sign_hook = _compose(Hook.SIGN)
friction_hook = _compose(Hook.FRICTION)
torque_hook = _compose(Hook.TORQUE)
deflection_hook = _compose(Hook.DEFLECTION)
stiffness_hook = _compose(Hook.STIFFNESS)
carriage_hook = _compose(Hook.CARRIAGE_FORCE)
reading_hook = _compose(Hook.READING)
command_hook = _compose(Hook.COMMAND)
# What writes the memories of a hook's effects.
sign_keeps, friction_keeps, command_keeps = (
    _chain(_link_keeping, _unkept, KEEPING_EFFECTS, hook)
    for hook in (Hook.SIGN, Hook.FRICTION, Hook.COMMAND)
)
command_begun = _chain(_link_begun, _unbegun, KEEPING_EFFECTS, Hook.COMMAND)


@functools.cache
def sources_digest():
    """Return a digest of everything the kernels are compiled from.

    numba's cache looks at one source file only; the kernels close over this digest, so that a
    change in an effect or in the lanes makes a new entry.
    """
    package = Path(__file__).parents[1]
    models = (sorted((package / 'models').rglob(name)) for name in ('kernel*.py', 'linkage.py'))
    folders = package / 'lanes.py', package / 'effects', package / 'kernel'
    parts = [digest_of(*folders, *itertools.chain(*models))]
    # Files of users come in the order in which their effects lie in the rows.
    parts += [f'{module} {digest_of(path)}' for path, module in SOURCES.items()]
    return hashlib.sha256(' '.join(parts).encode()).hexdigest()[:16]
