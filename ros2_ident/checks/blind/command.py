# SPDX-License-Identifier: Apache-2.0
"""`ident blind`: the diagnosis judged on cases whose answer it cannot see."""

import argparse
import shlex

from ros2_ident.cli.arguments import count, whole

SUMMARY = 'judge the diagnosis on cases whose answer it cannot see'
DESCRIPTION = (
    'Draw machines with and without unmodelled effects, seal what was put into them, diagnose '
    'their bags in other processes, open the seals, score. The same command goes on with an '
    'interrupted run.'
)
EXAMPLES = (
    '  ident blind --cases 300 --seed 7 --out blind_7\n'
    '  ident blind --rescore blind_7 --page docs/blind.md\n'
    '\n'
    'writes to DIR: the bags in cases/, the seals in sealed/, table.jsonl with one line a case, '
    'blind.md with pictures\n'
)
EXIT_CODES = {0: 'scored', 1: 'stopped; the same command goes on'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument('--cases', type=count, default=20, metavar='N', help='20 by default')
    parser.add_argument('--seed', type=whole, default=1, help='of everything drawn; 1 by default')
    parser.add_argument('--out', metavar='DIR', help='directory of the run; blind_SEED by default')
    parser.add_argument(
        '--machine',
        default='config/tripod.yaml',
        metavar='FILE',
        help='machine file; config/tripod.yaml by default',
    )
    parser.add_argument(
        '--processes', type=count, default=2, metavar='N', help='cases at a time; 2 by default'
    )
    for name, share in (
        ('single', 0.45),
        ('pair', 0.15),
        ('none', 0.20),
        ('outside', 0.12),
        ('hidden', 0.08),
    ):
        parser.add_argument(
            f'--{name}',
            type=float,
            default=share,
            metavar='SHARE',
            help=f'share of these cases; {share:g} by default',
        )
    parser.add_argument('--page', metavar='FILE', help='page to write; DIR/blind.md by default')
    parser.add_argument(
        '--notes', metavar='FILE', help='text for the page: why a level is not reached'
    )
    parser.add_argument(
        '--rescore', metavar='DIR', help='score a run again from its table, without diagnosing'
    )
    parser.add_argument(
        '--reopen', action='store_true', help='with --rescore: compute the table anew as well'
    )
    parser.add_argument('--quiet', action='store_true', help='show no progress')


def run(args: argparse.Namespace) -> int:
    """Run or rescore, and write the page."""
    from pathlib import Path

    from ros2_ident.checks.blind.draw import Shares
    from ros2_ident.checks.blind.page import write_page
    from ros2_ident.checks.blind.run import BlindCheck, Stopped
    from ros2_ident.checks.blind.score import score, sentences
    from ros2_ident.cli.interrupt import interrupts
    from ros2_ident.cli.progress import FractionMeter

    root = Path(args.rescore or args.out or f'blind_{args.seed}')
    with FractionMeter(quiet=args.quiet) as meter, interrupts() as cancel:
        check = BlindCheck(root, args.processes, meter, cancel.is_set)
        try:
            if args.rescore:
                rows = check.score(again=args.reopen) if args.reopen else check.store.rows()
            else:
                shares = Shares(args.single, args.pair, args.none, args.outside, args.hidden)
                command = shlex.join(['ident', *args.words])
                check.begin(args.machine, args.cases, args.seed, shares, command)
                digest = check.draw()
                print(f'sealed: {args.cases} cases, SHA-256 {digest}', flush=True)
                check.diagnose()
                rows = check.score()
        except Stopped:
            print(f'stopped; the same command goes on in {root}')
            return 1
    found = score(rows)
    for line in sentences(found):
        print(line)
    notes = Path(args.notes).read_text(encoding='utf-8') if args.notes else ''
    page = write_page(args.page or root / 'blind.md', rows, found, check.store.about(), notes)
    print(f'written: {page}')
    return 0
