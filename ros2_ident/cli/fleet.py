# SPDX-License-Identifier: Apache-2.0
"""`ident fleet`: many bags of many machines, identified, diagnosed and compared."""

import argparse
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import add, add_conditions, add_topics, count, positive, wished
from ros2_ident.errors import IdentError

if TYPE_CHECKING:
    from ros2_ident.fleet import Entry, Row, Wish

DESCRIPTION = (
    'Identify and diagnose many bags as one job, and compare the machines. The same command goes '
    'on where the last one ended; a bad bag fails alone.'
)
EXAMPLES = (
    '  ident fleet bags --machine config/tripod.yaml --out fleet\n'
    '  ident fleet fleet.yaml --out fleet --scheduler tcp://head:8786\n'
    '\n'
    'writes to DIR: fleet.json, fleet.csv, report.html (the machines on a page), and rows/ with\n'
    'a file for each bag\n'
)
EXIT_CODES = {
    0: 'every bag is done',
    1: 'some failed, are unfinished, or contradict their machine file',
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument('list', metavar='DIR_OR_LIST', help='directory of bags, or a YAML list')
    add(parser, '--machine', required=False)
    add(parser, '--out', required=True)
    parser.add_argument('--no-diagnosis', action='store_true', help='identify only')
    add(parser, '--seed', default=1, help='of every search')
    add(
        parser,
        '--scheduler',
        help='run the bags on the workers of this Dask scheduler; they have to see the same paths',
    )
    add(parser, '--fix')
    parser.add_argument(
        '--evaluations', type=count, metavar='N', help='simulate at most N candidates a bag'
    )
    parser.add_argument(
        '--seconds',
        type=positive,
        metavar='N',
        help='end the identification of a bag after N seconds, and its diagnosis likewise',
    )
    add(parser, '--quiet')
    add_conditions(parser)
    add_topics(parser)


def wish_of(args: argparse.Namespace) -> 'Wish':
    """Return how the bags are to be run."""
    from ros2_ident.fleet import Wish
    from ros2_ident.identify.settings import IdentifySettings
    from ros2_ident.search import Budget

    budget = Budget(evaluations=args.evaluations, seconds=args.seconds)
    return Wish(
        diagnosed=not args.no_diagnosis,
        settings=IdentifySettings(budget=budget),
        **wished(args),
    )


def run(args: argparse.Namespace) -> int:
    """Run the fleet and print how its machines compare."""
    from ros2_ident.cli.progress import Meter
    from ros2_ident.cli.runs import answered, interrupts, page_line
    from ros2_ident.fleet import read_fleet, run_fleet, sound

    entries = read_fleet(args.list, args.machine)
    rows: list[Row] = []

    def begun(entry: 'Entry') -> None:
        gone = sum(row['name'] != entry.name for row in rows)
        meter(gone / len(entries), f'{gone} of {len(entries)}: {entry.name}')

    def done(row: 'Row') -> None:
        # one that is fitted once more for the comparison takes its own place
        kept = {x['name']: x for x in (*rows, row)}
        rows[:] = [kept[entry.name] for entry in entries if entry.name in kept]
        meter.note(f'{row["name"]} {row["state"]} {_said(row)}')

    with (
        answered(_print) as answer,
        interrupts() as cancel,
        Meter(quiet=args.quiet) as meter,
    ):
        answer(rows)
        run_fleet(
            entries,
            args.out,
            wish=wish_of(args),
            scheduler=args.scheduler,
            cancel=cancel,
            on_start=begun,
            on_row=done,
        )
    page = page_line(Path(args.out), wanted=True)
    print(f'written: {args.out}/fleet.json, {args.out}/fleet.csv')
    print(page, end='', flush=True)
    return 0 if len(rows) == len(entries) and all(map(sound, rows)) else 1


def _said(row: 'Row') -> str:
    return str(row.get('verdict') or row['message'])


def _print(rows: 'list[Row]') -> None:
    from ros2_ident.cli.table import columns
    from ros2_ident.fleet import summarise

    lines = [('bag', 'machine', 'date', 'state', 'verdict')] if rows else []
    for row in rows:
        state = row['state'] if row['code'] == 'OK' else row['code']
        lines.append((row['name'], row['machine'], row['date'], state, _said(row)))
    columns(lines, '<<<<<')
    with suppress(IdentError):  # without the page's packages they stand in fleet.json alone
        from ros2_ident.report.page.several import differences

        for text in differences(summarise(rows)):
            print(text)
