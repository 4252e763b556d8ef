# SPDX-License-Identifier: Apache-2.0
"""The hooks of a simulation step: for each, one function that runs the effects that are on.

Which effects are on is the same for all candidates of a batch, so the branch on it costs next to
nothing and nothing is compiled again when another effect is tried.
"""
# mypy: ignore-errors

import functools
import hashlib
from pathlib import Path

from ros2_ident.effects import Hook
from ros2_ident.kernel.rows import bit, effect_row, KERNEL_EFFECTS
from ros2_ident.lanes import inlined, load, WIDTH

W = WIDTH


@inlined
def _gather1(par, row):
    return (load(par, row * W),)


@inlined
def _gather2(par, row):
    return (load(par, row * W), load(par, (row + 1) * W))


@inlined
def _gather3(par, row):
    return (load(par, row * W), load(par, (row + 1) * W), load(par, (row + 2) * W))


_GATHER = {1: _gather1, 2: _gather2, 3: _gather3}


@inlined
def _unchanged(value, drive, on, par, first):
    return value


def _link(before, effect, kernel):
    gather = _GATHER[len(effect.parameters)]
    mask = bit(effect.id)
    row = effect_row(effect.id)

    @inlined
    def after(value, drive, on, par, first):
        value = before(value, drive, on, par, first)
        if on & mask:
            value = kernel(value, drive, gather(par, first + row))
        return value

    return after


def _compose(hook):
    function = _unchanged
    for effect in KERNEL_EFFECTS:
        if effect.hook is hook:
            function = _link(function, effect, effect.kernel)
    return function


def _compose_keeps(hook):
    keeping = [e for e in KERNEL_EFFECTS if e.hook is hook and e.keeps is not None]
    assert len(keeping) == 1, f'effects of {hook} would share one memory'
    return _link(_unchanged, keeping[0], keeping[0].keeps), bit(keeping[0].id)


def mask_of(hook):
    """Return the flags of all effects in a hook."""
    return sum(bit(e.id) for e in KERNEL_EFFECTS if e.hook is hook)


sign_hook = _compose(Hook.SIGN)
friction_hook = _compose(Hook.FRICTION)
torque_hook = _compose(Hook.TORQUE)
deflection_hook = _compose(Hook.DEFLECTION)
stiffness_hook = _compose(Hook.STIFFNESS)
carriage_hook = _compose(Hook.CARRIAGE_FORCE)
reading_hook = _compose(Hook.READING)
command_hook = _compose(Hook.COMMAND)
command_keeps, _ = _compose_keeps(Hook.COMMAND)
friction_keeps, WARMING = _compose_keeps(Hook.FRICTION)


@functools.cache
def sources_digest():
    """Return a digest of everything the kernels are compiled from.

    numba's cache looks at one source file only; the kernels close over this digest, so that a
    change in an effect or in the lanes makes a new entry.
    """
    package = Path(__file__).parents[1]
    files = [
        package / 'lanes.py',
        *(package / 'effects').glob('*.py'),
        *(package / 'kernel').glob('*.py'),
        *(package / 'models').rglob('*.py'),
    ]
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
