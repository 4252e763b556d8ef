# SPDX-License-Identifier: Apache-2.0
"""The diagnosis, checked blind with cases from MuJoCo: a generator that is not the package's.

As `checks.blind`, with the same label, noise, faults and scores; only machines and effects are
MuJoCo's. Goes on where a run was left. MuJoCo has to be importable; `tools/bench.sh mujoco_blind`
sees to that.

    python checks/benchmarks/mujoco_blind.py --cases 200 --seed 2026
"""

import argparse
from pathlib import Path
import shlex
import sys
from typing import Any

from checks.blind.command import numbers
from checks.blind.keep import keep_all, keep_seals
from checks.blind.page import write_page
from checks.blind.planning import Shares
from checks.blind.run import BlindCheck
from checks.blind.score import score, sentences
from checks.generators.mujoco_cases import MujocoDrawer


def tell(share: float, text: str) -> None:
    """Say how far it is."""
    print(f'{100.0 * share:.0f} %, {text}', file=sys.stderr)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--cases', type=int, default=200)
    parser.add_argument('--seed', type=int, default=2026)
    parser.add_argument('--machine', type=Path, default=Path('config/tripod.yaml'))
    parser.add_argument('--out', type=Path, default=Path('build/mujoco_blind'))
    parser.add_argument('--keep', type=Path, help='as of `checks.blind`')
    parser.add_argument('--only', help='diagnose and score only these cases: 3,8,20-40')
    parser.add_argument('--draw-only', action='store_true', help='draw and seal only')
    parser.add_argument('--processes', type=int, default=2)
    return parser.parse_args()


def rows_of(check: BlindCheck, args: argparse.Namespace) -> list[dict[str, Any]] | None:
    """Draw, seal, diagnose and score; None where nothing shall be diagnosed."""
    command = shlex.join(['python', *sys.argv])
    check.begin(args.machine, args.cases, args.seed, Shares(), command)
    print(f'sealed: {args.cases} cases, SHA-256 {check.draw()}', flush=True)
    if args.keep:
        print(f'kept: {keep_seals(check.store, args.keep)}')
    if args.draw_only:
        return None
    only = numbers(args.only)
    check.diagnose(only)
    return [row for row in check.score() if not only or row['case'] in only]


def main() -> int:
    """Run it."""
    args = arguments()
    check = BlindCheck(args.out, args.processes, tell, generator=MujocoDrawer)
    rows = rows_of(check, args)
    if rows is None:
        return 0
    found = score(rows)
    print(*sentences(found), sep='\n')
    page = write_page(args.out / 'blind.md', rows, found, check.store.about())
    print(f'written: {page}')
    if args.keep:
        print(f'kept: {keep_all(check.store, args.keep, rows)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
