# SPDX-License-Identifier: Apache-2.0
"""Change the sources one place at a time, and count the changes that the tests notice.

A mutant has one comparison, operator, number, truth value, `min` or `max`, `break`, or statement
changed. The tests of its module run on it in a process of their own, then the rest of its room's,
without those marked slow; where all pass, it survives and is printed. Mutants are drawn at random,
by seed. One that takes too long is noticed.

Example: python checks/benchmarks/mutants.py --rooms gap search recording --sample 300
"""

import argparse
import ast
from collections import Counter
from collections.abc import Iterable, Iterator
import copy
from dataclasses import dataclass
import importlib
import importlib.abc
import importlib.util
import os
from pathlib import Path
import random
import resource
import signal
import sys
import time
from types import ModuleType

ROOT = Path(__file__).parents[2]
# Modules of `gap/` that are rules; the others simulate, which takes minutes for each change.
RULES = ('rules', 'verdict')
# Modules whose tests start a cluster, and are all slow.
REMOTE = ('cluster',)
# Tests, test/<room>/test_*.py, that are for a module and not named after it; they run first.
OWN: dict[str, str] = {
    'gap.selection': 'gap_rules gap_verdict',
    'gap.rules': 'gap_rules gap_verdict',
    'gap.verdict': 'gap_verdict gap_rules',
    'search.algebraic': 'search_linear',
    'search.driver': 'search_queue search_limits',
    'search.evaluators': 'search_starts search_driver',
    'search.evidence': 'search_sums',
    'search.jacobian': 'search_refine',
    'search.noise': 'search_uncertainty search_evidence',
    'search.operators': 'search_genetic search_starts',
    'recording.cdr': 'recording_bag',
    'recording.align': 'recording_align recording_span',
    'recording.bag': 'recording_damage recording_ros2_control recording_places',
    'recording.content': 'recording_bag recording_windows',
    'recording.grid': 'recording_grid',
    'recording.table': 'recording_table',
    'recording.outliers': 'recording_outliers',
    'recording.limits': 'recording_damage',
    'recording.motion': 'recording_quality recording_smooth',
    'recording.scan': 'recording_damage recording_bag',
    'recording.storage': 'recording_bag recording_damage',
    'recording.write': 'recording_damage recording_bag',
}
# Tests of which those marked slow are quick enough for the modules that they are for.
QUICK = {
    'search_algebraic',
    'search_evidence',
    'search_journal',
    'recording_align',
    'recording_bag',
    'recording_builder',
    'recording_damage',
    'recording_grid',
    'recording_outliers',
    'recording_spool',
}
# What is loaded before the first mutant; none of it imports a room.
LOADED = (
    'hypothesis',
    'numba',
    'pytest',
    'rosbags.highlevel',
    'scipy.optimize',
    'scipy.signal',
    'scipy.stats',
    'yaml',
    'ros2_ident.models',
    'checks.reference',
)
# Tests of a room that are left out: they draw at random for long, or read other data.
LEFT_OUT = {'recording_fuzz', 'search_cluster'}
ROOMS = ('gap', 'search', 'recording')
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
# s that the tests of one mutant may take, of the processor and by the clock
CPU, CLOCK = 30, 600
# What it says of a mutant that pytest ends with such a code; with any other, no test was run.
ENDED = {0: '', 1: 'a test fails', 2: 'it cannot be imported'}
UNRUN = 99


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


def modules(room: str) -> list[str]:
    """Return the modules of a room that are changed."""
    if room == 'gap':
        return list(RULES)
    names = sorted(path.stem for path in (ROOT / 'ros2_ident' / room).glob('*.py'))
    return [name for name in names if name != '__init__' and name not in REMOTE]


Tests = tuple[str, list[str]]  # which, of which files


def tests(room: str, module: str, *, own: bool = False) -> Iterator[Tests]:
    """Yield a module's tests, the room's others, and the module's that are slow but `QUICK`.

    Where `own`, only the first of these.
    """
    files = (ROOT / 'test').glob('*/test_*.py')
    whole = sorted(f'{x.parent.name}_{x.stem.removeprefix("test_")}' for x in files)
    named = [f'{room}_{module}'] if f'{room}_{module}' in whole else []
    first = list(dict.fromkeys([*named, *OWN.get(f'{room}.{module}', '').split()]))
    yield 'not slow', _files(first)
    if own:
        return
    if room != 'gap':
        others = {x for x in whole if x.startswith(f'{room}_')} - {*first, *LEFT_OUT}
        yield 'not slow', _files(sorted(others))
    yield 'slow', _files(x for x in first if x in QUICK)


def every(room: str, *, own: bool = False) -> list[Tests]:
    """Return all tests that any module of a room has."""
    files: dict[str, set[str]] = {'not slow': set(), 'slow': set()}
    for module in modules(room):
        for which, names in tests(room, module, own=own):
            files[which] |= {*names}
    return [(which, sorted(names)) for which, names in files.items()]


def _files(names: Iterable[str]) -> list[str]:
    return [f'test/{name.replace("_", "/test_", 1)}.py' for name in names]


class _Fair:
    """Lets no test fail for the machine's being busy, and tells which one has failed."""

    def __init__(self, told: int) -> None:
        self.told = told

    def pytest_sessionstart(self, session) -> None:  # type: ignore[no-untyped-def]
        """Take the limits of time away, those of every test and those of drawn examples."""
        from hypothesis import settings

        for plugin in session.config.pluginmanager.get_plugins():
            if isinstance(plugin, ModuleType) and plugin.__name__ == 'conftest':
                plugin.LIMIT = float('inf')  # type: ignore[attr-defined]
        settings.register_profile('fair', settings.get_profile('fixed'), deadline=None)
        settings.load_profile('fair')

    def pytest_runtest_logreport(self, report) -> None:  # type: ignore[no-untyped-def]
        """Write the name of a test that fails."""
        if report.failed:
            os.write(self.told, report.nodeid.encode())


def noticed(mutant: Mutant | None, groups: Iterable[Tests]) -> str:
    """Return what fails in a process with a mutant, or without one; empty where nothing does."""
    source, told = os.pipe()
    child = os.fork()
    if child:
        os.close(told)
        status = os.waitpid(child, 0)[1]
        said = os.read(source, 1 << 12).decode()
        os.close(source)
        if os.WIFSIGNALED(status):
            return said or 'takes too long'
        if (code := os.WEXITSTATUS(status)) not in ENDED:
            sys.exit(f'the tests were not run (exit code {code}): {mutant}')
        return said or ENDED[code]
    code = UNRUN
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU, CPU))
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        signal.alarm(CLOCK)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        if mutant is not None:
            assert mutant.module not in sys.modules, 'what the parent imports is not changed'
            sys.meta_path.insert(0, Finder(mutant))
        import pytest

        words = ['-x', '-q', '-p', 'no:cacheprovider', '--no-header', '-k', 'not fast_enough']
        for which, files in groups:
            if files:
                code = int(pytest.main([*words, '-m', which, *files], plugins=[_Fair(told)]))
                if code:
                    break
    finally:
        os._exit(code)


def main() -> None:
    """Draw, change, test, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rooms', nargs='*', choices=ROOMS, default=list(ROOMS))
    parser.add_argument('--modules', nargs='*', default=[], help='only these')
    parser.add_argument('--sample', type=int, default=0, help='mutants; all where 0')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--own', action='store_true', help='only the tests of the module itself')
    parser.add_argument('--killed', action='store_true', help='print what noticed a mutant, too')
    parser.add_argument('--minutes', type=float, default=1e9, help='end after this time')
    args = parser.parse_args()
    os.chdir(ROOT)
    # Not this folder, whose modules others would take for packages of their names.
    sys.path[0] = str(ROOT)
    # What every process needs and no room is in is loaded once.
    for name in LOADED:
        importlib.import_module(name)

    drawn = [
        mutant
        for room in args.rooms
        for module in modules(room)
        if not args.modules or module in args.modules
        for mutant in mutants(room, module)
    ]
    whole = len(drawn)
    random.Random(args.seed).shuffle(drawn)
    drawn = drawn[: args.sample or whole]
    for room in args.rooms:
        if wrong := noticed(None, every(room, own=args.own)):
            sys.exit(f'the tests of {room} do not pass as it is: {wrong}')
    begin, killed, count = time.monotonic(), Counter[str](), Counter[str]()
    for mutant in drawn:
        if time.monotonic() - begin > 60.0 * args.minutes:
            break
        count[mutant.room] += 1
        module = mutant.module.rpartition('.')[2]
        by = noticed(mutant, list(tests(mutant.room, module, own=args.own)))
        killed[mutant.room] += bool(by)
        if args.killed or not by:
            word = f'killed by {by}' if by else 'survives'
            print(f'{word}: {mutant.module}:{mutant.line} {mutant.said}', flush=True)
    for room in args.rooms:
        share = 100.0 * killed[room] / max(1, count[room])
        print(f'{room}: {killed[room]} of {count[room]} killed, {share:.0f} %')
    seconds = time.monotonic() - begin
    print(f'{sum(count.values())} of {whole} mutants, seed {args.seed}, {seconds:.0f} s')


if __name__ == '__main__':
    main()
