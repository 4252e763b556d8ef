# SPDX-License-Identifier: Apache-2.0
"""`ident excite`: the motion that determines parameters best, within limits."""

import argparse
import shlex
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import once

if TYPE_CHECKING:
    from ros2_ident.excite.plan import Excitation


def run(args: argparse.Namespace) -> int:
    """Plan, write, say what it is worth."""
    from contextlib import ExitStack
    from dataclasses import replace

    from ros2_ident.cli.progress import Meter
    from ros2_ident.excite.course import courses_for
    from ros2_ident.excite.files import require_place, write_excitation
    from ros2_ident.excite.information import Sensitivity
    from ros2_ident.excite.limits import limits_of
    from ros2_ident.excite.plan import excite, SEARCH
    from ros2_ident.models import load_machine
    from ros2_ident.search import Budget
    from ros2_ident.threads import processors

    require_place(args.out)
    machine = load_machine(args.machine)
    limits = limits_of(machine, args.limits)
    courses = courses_for(machine, limits, args.seconds, args.harmonics, args.rest)
    expected = once(args.set, '--set')
    if args.results is not None:
        from ros2_ident.report.estimate import read_estimate

        expected = {**read_estimate(args.results).values, **expected}
    fixed = once(args.fix, '--fix')
    sensitivity = Sensitivity(
        machine, values=expected, drives=args.drives, fixed=fixed, rate=args.rate
    )
    generations = max(1, args.generations)
    # Fewer generations shrink their steps as far.
    shrink = SEARCH.range_reduction ** (SEARCH.generations / generations)
    with ExitStack() as end:
        with Meter(quiet=args.quiet) as meter:
            found = excite(
                courses,
                sensitivity,
                args.parameters,
                criterion=args.criterion,
                seed=args.seed,
                settings=replace(SEARCH, generations=generations, range_reduction=shrink),
                budget=Budget(seconds=args.max_seconds),
                threads=args.threads or processors(),
                on_progress=lambda p: meter(
                    min(1.0, p.evaluations / p.budget), f'{p.evaluations} motions tried'
                ),
            )
        end.callback(_say, found)
        asked = shlex.join(['ident', *args.words])
        files = write_excitation(args.out, found, args.lead, asked)
    print(f'written: {", ".join(str(path) for path in files)}')
    return 0


def _say(found: 'Excitation') -> None:
    """Print the intervals to expect, and what of the limits the motion takes."""
    from ros2_ident.cli.table import columns

    rows = [('parameter', 'expected', '95 %', 'a random motion', 'unit')]
    for n, p in enumerate(found.parameters):
        if found.wanted[n]:
            half, chance = found.half_widths[n], found.chance[n]
            numbers = f'{found.values[n]:.5g}', f'± {half:.2g}', f'± {chance:.2g}'
            rows.append((p.name, *numbers, p.unit))
    columns(rows, '<>>><')
    loads = ', '.join(f'{100.0 * x:.0f} % {name}' for name, x in found.loads.items() if x > 0.0)
    print(f'of the limits it takes at most: {loads}')
