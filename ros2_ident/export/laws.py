# SPDX-License-Identifier: Apache-2.0
"""Laws of effects as simulators can call them: of a joint's position and speed alone."""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import inspect
import textwrap
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import Effect, get_effect, Hook
from ros2_ident.kernel.rows import of_effect
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.joints import Joint
from ros2_ident.models.drives.model import DriveModel

# What kernels call, by its name in numpy.
_FUNCTIONS = {
    'absolute': 'abs', 'cosine': 'cos', 'exp': 'exp', 'maximum': 'maximum', 'minimum': 'minimum',
    'sine': 'sin', 'spread': 'float64', 'tanh': 'tanh', 'where': 'where',
}  # fmt: skip
# What of a drive's state a simulator has, too; that of the log is constant.
_CONSTANT = 'coulomb', 'viscous', 'gear'
_STATE = {'position', 'carriage', 'velocity', 'direction', 'turn', *_CONSTANT}
_HOOKS = Hook.FRICTION, Hook.TORQUE, Hook.CARRIAGE_FORCE


@dataclass(frozen=True, eq=False)
class Law:
    """An effect at a joint.

    Attributes:
        effect: Its id.
        takes: Effort at the joint, N m or N, that one of its kernel's value takes.
        values: Of its parameters.
        state: The drive's constant numbers that a kernel sees.
    """

    effect: str
    takes: float
    values: tuple[float, ...]
    state: Mapping[str, float]

    def effort(self, position: Array, velocity: Array) -> Array:
        """Return (K,) effort at the joint that it takes, N m or N, at positions, speeds (K,)."""
        known = {name: getattr(np, own) for name, own in _FUNCTIONS.items()}
        function = FunctionType(_kernel(get_effect(self.effect)).__code__, known)
        seen = dict.fromkeys(('position', 'carriage'), position)
        seen |= {'velocity': velocity, 'direction': np.sign(velocity)}
        drive = SimpleNamespace(**seen, **self.state)
        return np.asarray(self.takes * function(0.0, drive, self.values) + 0.0 * velocity)

    @property
    def source(self) -> str:
        """Its kernel as a function in Python, called as the effect, of numpy's functions."""
        function = _definition(get_effect(self.effect))
        function.name, function.decorator_list, function.returns = self.effect, [], None
        for argument in function.args.args:
            argument.annotation = None
        for name in (x for x in ast.walk(function) if isinstance(x, ast.Name)):
            if name.id in _FUNCTIONS:
                name.id = f'np.{_FUNCTIONS[name.id]}'
        return ast.unparse(function)


def _kernel(effect: Effect) -> Callable[..., Any]:
    return getattr(effect.kernel, 'py_func', effect.kernel)  # type: ignore[return-value]


def _definition(effect: Effect) -> ast.FunctionDef:
    (found,) = ast.parse(textwrap.dedent(inspect.getsource(_kernel(effect)))).body
    assert isinstance(found, ast.FunctionDef)
    return found


def is_law(effect: Effect) -> bool:
    """Whether an effect adds a force that depends on a joint's position and speed alone."""
    if effect.hook not in _HOOKS or effect.keeps is not None:
        return False
    code = _kernel(effect).__code__
    if code.co_freevars or not _STATE | _FUNCTIONS.keys() >= {*code.co_names}:
        return False
    term = getattr(_definition(effect).body[-1], 'value', None)
    while isinstance(term, ast.BinOp) and isinstance(term.op, ast.Add | ast.Sub):
        term = term.left
    return isinstance(term, ast.Name) and term.id == code.co_varnames[0]


def laws_of(
    model: DriveModel, theta: Array, effects: Sequence[EffectAt]
) -> dict[str, tuple[Law, ...]]:
    """Return the laws of a candidate (N,), by joint; none of joints without."""
    block, drives = model.rows(np.atleast_2d(theta)), model.machine.drives
    numbers = {name: model.candidates.of(block, name)[0] for name in (*_CONSTANT, 'motor_turn')}
    numbers['turn'] = numbers.pop('motor_turn')
    found = {}
    for d in model.signals.places:
        state, laws = {name: float(row[d]) for name, row in numbers.items()}, []
        takes = {Hook.FRICTION: state['gear'], Hook.TORQUE: -state['gear']}
        own = [get_effect(at.effect) for at in effects if at.where in (drives[d], 'all')]
        for effect in filter(is_law, own):
            count = range(len(effect.parameters))
            rows = [of_effect(block, effect.id, n, len(drives)) for n in count]
            values = tuple(float(row[0, d]) for row in rows)
            laws.append(Law(effect.id, takes.get(effect.hook, -1.0), values, state))
        if laws:
            found[drives[d]] = tuple(laws)
    return found


def taken(
    laws: Mapping[str, Sequence[Law]], joints: Sequence[Joint], place: Array, speed: Array
) -> Array:
    """Return (D, K) what effects take of joints, N m or N, at positions and speeds (D, K)."""
    return np.array([
        sum((law.effort(q, v) for law in laws.get(joint.name, ())), 0.0 * v)
        for joint, q, v in zip(joints, place, speed, strict=True)
    ])  # fmt: skip
