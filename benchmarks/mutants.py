# SPDX-License-Identifier: Apache-2.0
"""Change the sources one place at a time, and count the changes that the tests notice.

A mutant has one comparison, operator, number, truth value, `min` or `max`, `break`, or statement
changed. The tests that belong to its module run on it in a process of their own, without those
marked slow; where all pass, it survives and is printed. Mutants are drawn at random, by seed.

Example: python benchmarks/mutants.py --rooms gap search recording --sample 300
"""

import argparse
import ast
from collections import Counter
from collections.abc import Iterator, Sequence
import copy
from dataclasses import dataclass
import importlib.abc
import importlib.util
import os
from pathlib import Path
import random
import resource
import sys
import time

ROOT = Path(__file__).parents[1]
# Modules and the tests that are for them.
TESTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    'gap': (('criteria', 'explain', 'verdict'), ('test_gap_rules',)),
    'search': (
        (
            'checkpoint',
            'driver',
            'genetic',
            'jacobian',
            'journal',
            'operators',
            'packing',
            'refine',
            'starts',
            'uncertainty',
        ),
        (
            'test_search_journal',
            'test_search_genetic',
            'test_search_driver',
            'test_search_limits',
            'test_search_refine',
            'test_search_uncertainty',
        ),
    ),
    'recording': (
        ('builder', 'damage', 'grid', 'limits', 'mcap_records', 'mcap_scan', 'outliers')
        + ('segments', 'streams', 'table', 'cdr'),
        (
            'test_recording_builder',
            'test_recording_grid',
            'test_recording_outliers',
            'test_recording_streams',
            'test_recording_table',
            'test_recording_damage',
            'test_recording_bag',
        ),
    ),
}
COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_ORDERED = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
CPU = 120  # s that the tests of one mutant may take


@dataclass(frozen=True)
class Mutant:
    """One change of one module.

    Attributes:
        module: Name of the module.
        room: Its room.
        place: Number of the changed node.
        change: Which change of it.
        line: Where.
        said: What is changed.
    """

    module: str
    room: str
    place: int
    change: int
    line: int
    said: str


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield what may stand in a node's place, and what that is."""
    new = copy.deepcopy(node)
    if isinstance(new, ast.Compare):
        for k, operator in enumerate(new.ops):
            # Of floats, one is as good as the other.
            whole = any(map(_whole, [new.left, *new.comparators]))
            if whole or not isinstance(operator, _ORDERED):
                other = copy.deepcopy(new)
                other.ops[k] = COMPARISONS[type(operator)]()
                yield 'comparison', other
        if isinstance(new.ops[0], _ORDERED):
            yield 'negated', ast.UnaryOp(ast.Not(), new)
    elif isinstance(new, ast.BoolOp):
        new.op = ast.Or() if isinstance(new.op, ast.And) else ast.And()
        yield 'and, or', new
    elif isinstance(new, (ast.BinOp, ast.AugAssign)) and type(new.op) in OPERATORS:
        new.op = OPERATORS[type(new.op)]()
        yield 'operator', new
    elif isinstance(new, ast.UnaryOp) and isinstance(new.op, (ast.Not, ast.USub)):
        yield 'without its sign', new.operand
    elif isinstance(new, ast.Constant) and isinstance(new.value, bool):
        yield 'truth', ast.Constant(not new.value)
    elif isinstance(new, ast.Constant) and isinstance(new.value, (int, float)):
        yield 'number', ast.Constant(new.value + 1)
        if new.value:
            yield 'number', ast.Constant(new.value / 2 if new.value % 2 else new.value // 2)
    elif isinstance(new, ast.Name) and new.id in ('min', 'max'):
        yield 'min, max', ast.Name('max' if new.id == 'min' else 'min', ast.Load())
    elif isinstance(new, ast.Attribute) and new.attr in ('minimum', 'maximum', 'any', 'all'):
        pairs = {'minimum': 'maximum', 'any': 'all'}
        new.attr = (pairs | {v: k for k, v in pairs.items()})[new.attr]
        yield 'min, max, any, all', new
    elif isinstance(new, ast.Break):
        yield 'break', ast.Continue()
    elif isinstance(new, ast.Expr) and isinstance(new.value, ast.Call):
        yield 'statement left out', ast.Pass()


def _whole(node: ast.expr) -> bool:
    """Return whether a value is a whole number for sure."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int)
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == 'len'


class _Replace(ast.NodeTransformer):
    """Puts a node in the place of another one."""

    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> ast.AST:
        """Replace, or go on."""
        if node is self.old:
            return ast.copy_location(self.new, node)
        return self.generic_visit(node)


def places(tree: ast.Module) -> list[ast.AST]:
    """Return the nodes inside functions and of constants; annotations are no code."""
    outside: set[int] = set()
    for node in ast.walk(tree):
        for part in (getattr(node, x, None) for x in ('annotation', 'returns', 'decorator_list')):
            for one in part if isinstance(part, list) else [part]:
                outside |= {id(x) for x in ast.walk(one)} if isinstance(one, ast.AST) else set()
    return [node for node in ast.walk(tree) if id(node) not in outside]


def mutants(room: str, module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module."""
    path = ROOT / 'ros2_ident' / room / f'{module}.py'
    source = path.read_text()
    lines = source.splitlines()
    for place, node in enumerate(places(ast.parse(source))):
        for change, (said, _) in enumerate(changes(node)):
            line = getattr(node, 'lineno', 0)
            text = f'{said}: {lines[line - 1].strip()}'
            yield Mutant(f'ros2_ident.{room}.{module}', room, place, change, line, text)


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module changed."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant
        self.path = ROOT / (mutant.module.replace('.', '/') + '.py')

    def find_spec(self, name: str, path: object, target: object = None):  # type: ignore[no-untyped-def]
        """Return the changed module's."""
        if name != self.mutant.module:
            return None
        return importlib.util.spec_from_file_location(name, self.path, loader=self)

    def create_module(self, spec: object) -> None:
        """Let Python make it."""

    def exec_module(self, module):  # type: ignore[no-untyped-def]
        """Run it changed."""
        tree = ast.parse(self.path.read_text())
        node = places(tree)[self.mutant.place]
        new = list(changes(node))[self.mutant.change][1]
        tree = ast.fix_missing_locations(_Replace(node, new).visit(tree))
        for keyword in (x for x in ast.walk(tree) if isinstance(x, ast.keyword)):
            if keyword.arg == 'cache':  # Numba's does not see a changed number
                keyword.value = ast.copy_location(ast.Constant(False), keyword.value)
        exec(compile(tree, str(self.path), 'exec'), module.__dict__)


def passes(mutant: Mutant | None, tests: Sequence[str]) -> bool:
    """Return whether all tests pass in a process with a mutant, or without one."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    code = 1
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU, CPU))
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        if mutant is not None:
            sys.meta_path.insert(0, Finder(mutant))
        import pytest

        words = ['-x', '-q', '-p', 'no:cacheprovider', '-m', 'not slow', '--no-header']
        code = int(pytest.main([*words, *(f'test/{x}.py' for x in tests)]))
    finally:
        os._exit(code != 0)


def main() -> None:
    """Draw, change, test, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rooms', nargs='*', choices=tuple(TESTS), default=list(TESTS))
    parser.add_argument('--modules', nargs='*', default=[], help='only these')
    parser.add_argument('--sample', type=int, default=0, help='mutants; all where 0')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--minutes', type=float, default=1e9, help='end after this time')
    args = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    import hypothesis  # noqa: F401
    import numba  # noqa: F401
    import rosbags.highlevel  # noqa: F401
    import scipy.optimize  # noqa: F401
    import scipy.signal  # noqa: F401

    drawn = [
        mutant
        for room in args.rooms
        for module in TESTS[room][0]
        if not args.modules or module in args.modules
        for mutant in mutants(room, module)
    ]
    whole = len(drawn)
    random.Random(args.seed).shuffle(drawn)
    drawn = drawn[: args.sample or whole]
    for room in args.rooms:
        if not passes(None, TESTS[room][1]):
            sys.exit(f'the tests of {room} do not pass as it is')
    begin, killed, count = time.monotonic(), Counter[str](), Counter[str]()
    for mutant in drawn:
        if time.monotonic() - begin > 60.0 * args.minutes:
            break
        count[mutant.room] += 1
        if passes(mutant, TESTS[mutant.room][1]):
            print(f'survives: {mutant.module}:{mutant.line} {mutant.said}', flush=True)
        else:
            killed[mutant.room] += 1
    for room in args.rooms:
        share = 100.0 * killed[room] / max(1, count[room])
        print(f'{room}: {killed[room]} of {count[room]} killed, {share:.0f} %')
    seconds = time.monotonic() - begin
    print(f'{sum(count.values())} of {whole} mutants, seed {args.seed}, {seconds:.0f} s')


if __name__ == '__main__':
    main()
