# SPDX-License-Identifier: Apache-2.0
"""`ident fleet`: many bags of many machines, identified, diagnosed and compared."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import effort_of, searched, wished

if TYPE_CHECKING:
    from ros2_ident.fleet.summary import Row


def run(args: argparse.Namespace) -> int:
    """Run the fleet and print how its machines compare."""
    from ros2_ident.cli.progress import Meter
    from ros2_ident.cli.runs import interrupts, page_line
    from ros2_ident.fleet.run import read_fleet, run_fleet
    from ros2_ident.fleet.summary import sound

    entries = read_fleet(args.list, args.machine)
    how = {'without': args.without, **wished(args), **searched(args)}
    how |= {'diagnosed': not args.no_diagnosis, 'effort': effort_of(args)}
    rows: list[Row] = []

    def begun(entry: 'Row') -> None:
        gone = sum('after' not in row for row in rows)
        meter(gone / len(entries), f'{gone} of {len(entries)}: {entry["name"]}')

    def done(row: 'Row') -> None:
        rows.append(row)
        meter.note(f'{row["name"]} {row["state"]} {_said(row)}')

    with ExitStack() as end, interrupts(args.out) as cancel, Meter(quiet=args.quiet) as meter:
        end.callback(_print, rows)
        run_fleet(
            entries,
            args.out,
            how,
            scheduler=args.scheduler,
            cancel=cancel,
            on_start=begun,
            on_row=done,
        )
    page = page_line(Path(args.out), wanted=True)
    print(f'written: {args.out}/fleet.json')
    print(page, end='', flush=True)
    bags = [row for row in rows if 'after' not in row]
    return 0 if len(bags) == len(entries) and all(map(sound, rows)) else 1


def _said(row: 'Row') -> str:
    return str(row.get('verdict') or row['message'])


def _print(rows: 'list[Row]') -> None:
    from ros2_ident.change.result import Between
    from ros2_ident.cli.table import columns
    from ros2_ident.report.schema import read
    from ros2_ident.words.change import differences

    lines = [('bag', 'machine', 'date', 'state', 'verdict')] if rows else []
    for row in rows:
        if 'found' not in row:
            state = row['state'] if row['code'] == 'OK' else row['code']
            lines.append((row['name'], row['machine'], row['date'], state, _said(row)))
    columns(lines, '<<<<<')
    for text in differences([read(Between, row) for row in rows if 'found' in row]):
        print(text)
