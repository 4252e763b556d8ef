# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.blind`: the diagnosis judged on cases whose answer it cannot see."""

import argparse
import importlib
from pathlib import Path
import shlex
from typing import Any, TYPE_CHECKING

from checks.blind.sorts import SHARES
from ros2_ident.cli.arguments import count, whole
from ros2_ident.errors import ErrorCode, IdentError

if TYPE_CHECKING:
    from checks.blind.run import BlindCheck, Generator

DESCRIPTION = (
    'Draw machines with and without unmodelled effects, seal what was put into them, diagnose '
    'their bags in other processes, open the seals, score. The same command goes on with an '
    'interrupted run.'
)
EXAMPLES = (
    '  python -m checks.blind --cases 300 --seed 7 --out blind_7\n'
    '  python -m checks.blind --rescore blind_7\n'
    '  python -m checks.blind --cases 300 --seed 7 --out blind_7 \\\n'
    '      --draw-only --keep docs/blind/reference\n'
    '  python -m checks.blind --verify docs/blind/reference\n'
    '  python -m checks.blind --generator mjcf --mjcf ur5e.xml --cases 40 --twins 20\n'
    '\n'
    'writes to DIR: the bags in cases/, the seals in sealed/ and seals.json, table.jsonl with one '
    'line a case, blind.md with pictures\n'
)
# Where each generator of cases stands: in the name GENERATOR.
GENERATORS = {
    'reference': 'checks.blind.run',
    'mujoco': 'checks.generators.mujoco_cases',
    'arms': 'checks.generators.arm_cases',
    'free-arms': 'checks.generators.free_arms',
    'mjcf': 'checks.generators.mjcf_cases',
}
EXIT_CODES = {0: 'scored, drawn, or verified', 1: 'stopped; the same command goes on'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument('--cases', type=count, default=20, metavar='N', help='20 by default')
    parser.add_argument('--seed', type=whole, default=1, help='of everything drawn; 1 by default')
    parser.add_argument('--out', metavar='DIR', help='directory of the run; blind_SEED by default')
    parser.add_argument(
        '--generator',
        choices=GENERATORS,
        default='reference',
        help='what simulates, the slow reference by default',
    )
    parser.add_argument('--mjcf', metavar='FILE', help="of `mjcf`: the arm's description")
    parser.add_argument(
        '--twins',
        type=whole,
        default=0,
        metavar='N',
        help="of `mjcf`: so many tripods are the package's own, too",
    )
    parser.add_argument(
        '--finer',
        type=count,
        default=1,
        metavar='N',
        help="of `mjcf`: steps of RK4 in one of the description's, its own integrator by default",
    )
    parser.add_argument(
        '--machine',
        default='config/tripod.yaml',
        metavar='FILE',
        help='machine file; config/tripod.yaml by default',
    )
    parser.add_argument(
        '--processes', type=count, default=2, metavar='N', help='cases at a time; 2 by default'
    )
    for name, (share, which) in SHARES.items():
        parser.add_argument(
            f'--{name}',
            type=float,
            default=share,
            metavar='SHARE',
            help=f'share of cases {which}; {share:g} by default',
        )
    parser.add_argument(
        '--draw-only', action='store_true', help='draw and seal, and diagnose nothing yet'
    )
    parser.add_argument(
        '--only', metavar='CASES', help='diagnose and score only these cases: 3,8,20-40'
    )
    parser.add_argument(
        '--keep',
        metavar='DIR',
        help='copy there what everybody can check: the seals, and once opened labels and table',
    )
    parser.add_argument(
        '--verify', metavar='DIR', help='check what --keep has left: is it what was sealed?'
    )
    parser.add_argument(
        '--rescore', metavar='DIR', help='score a run again from its table, without diagnosing'
    )
    parser.add_argument(
        '--reopen', action='store_true', help='with --rescore: compute the table anew as well'
    )
    parser.add_argument('--quiet', action='store_true', help='show no progress')


def numbers(text: str | None) -> tuple[int, ...]:
    """Read numbers of cases, as `3,8,20-40`.

    Raises:
        IdentError: INVALID_GOAL where it cannot be read.
    """
    out: list[int] = []
    for part in (text or '').split(','):
        first, dash, last = part.strip().partition('-')
        if not part.strip():
            continue
        if not first.isdigit() or (dash and not last.isdigit()):
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'cannot read the cases {text!r}; write as 3,8,20-40'
            )
        out += range(int(first), int(last or first) + 1)
    return tuple(out)


def generator_of(name: str) -> 'Generator':
    """Return a generator by its name."""
    found: Generator = importlib.import_module(GENERATORS[name]).GENERATOR
    return found


def run(args: argparse.Namespace) -> int:
    """Run, rescore or verify, and write the page."""
    from checks.blind.keep import verify

    if args.verify:
        print(*verify(args.verify), sep='\n')
        return 0
    return _run(args)


def _run(args: argparse.Namespace) -> int:
    from checks.blind.keep import keep_all
    from checks.blind.run import BlindCheck, Stopped
    from checks.blind.store import Store
    from ros2_ident.cli.progress import Meter
    from ros2_ident.cli.runs import interrupts

    root = Path(args.rescore or args.out or f'blind_{args.seed}')
    name = Store(root).about().get('generator', 'reference') if args.rescore else args.generator
    generator = generator_of(name)
    with Meter(quiet=args.quiet) as meter, interrupts(root) as cancel:
        check = BlindCheck(root, args.processes, meter, cancel.is_set, generator)
        try:
            rows = _rows(check, args)
        except Stopped:
            print(f'stopped; the same command goes on in {root}')
            return 1
    if rows is None:
        return 0
    print(*generator.told(check.store, rows), sep='\n')
    if args.keep:
        print(f'kept: {keep_all(check.store, args.keep, rows)}')
    return 0


def _rows(check: 'BlindCheck', args: argparse.Namespace) -> list[dict[str, Any]] | None:
    """Return the scored cases; None where nothing shall be diagnosed."""
    from checks.blind.keep import keep_seals

    if args.rescore:
        return check.score(again=True) if args.reopen else check.store.rows()
    shares = {name: getattr(args, name) for name in SHARES}
    command = shlex.join(args.command)
    more: dict[str, Any] = {'generator': args.generator}
    if args.generator == 'mjcf':
        if not args.mjcf:
            raise IdentError(ErrorCode.INVALID_GOAL, 'no description of an arm; give --mjcf FILE')
        more |= {'mjcf': str(Path(args.mjcf).resolve()), 'twins': args.twins, 'finer': args.finer}
    check.begin(args.machine, args.cases, args.seed, shares, command, **more)
    digest = check.draw()
    print(f'sealed: {args.cases} cases, SHA-256 {digest}', flush=True)
    if args.keep:
        print(f'kept: {keep_seals(check.store, args.keep)}', flush=True)
    if args.draw_only:
        return None
    only = numbers(args.only)
    check.diagnose(only)
    rows = check.score()
    return [row for row in rows if not only or int(row['case']) in only]
