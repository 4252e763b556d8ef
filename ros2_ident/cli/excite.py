# SPDX-License-Identifier: Apache-2.0
"""`ident excite`: the motion that determines parameters best, within limits."""

import argparse
from pathlib import Path
import shlex
import sys
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import add, names, not_negative, once, parameters, positive, whole

if TYPE_CHECKING:
    from ros2_ident.excite.plan import Excitation, Wish

DESCRIPTION = (
    'Plan a motion that determines the parameters of a machine best, within limits on position, '
    'velocity, acceleration, jerk and effort, of the set-points and of the simulated machine. '
    'Needs no bag: what a log will show is computed at the expected parameters. '
    'Collisions are not checked.'
)
EXAMPLES = (
    '  ident excite motion --machine config/tripod.yaml --seconds 10\n'
    '  ident excite motion --machine config/tripod.yaml --limits joint_limits.yaml \\\n'
    '      --parameters gear_stiffness,tool_mass --criterion worst\n'
    '  ident excite motion --machine config/tripod.yaml --results results\n'
    '\n'
    'writes to DIR: set_points (a bag), trajectory.yaml (JointTrajectory), motion.csv,\n'
    'excite.json with the intervals to expect, and motion.png\n'
)
EXIT_CODES = {0: 'written'}
# Motions that are simulated in the search, beside those of its first generation.
GENERATIONS = 60


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument('out', metavar='DIR', help='directory for the files')
    add(parser, '--machine')
    parser.add_argument(
        '--limits',
        metavar='FILE',
        help='limits of the drives, a file as joint_limits.yaml of MoveIt and ros2_control; what '
        'it leaves out is taken from the machine file, its URDF, or what suits its kind',
    )
    parser.add_argument('--seconds', type=positive, default=10.0, help='duration; 10 by default')
    add(parser, '--drives')
    add(
        parser,
        '--parameters',
        type=names,
        default=(),
        metavar='NAME,..',
        words=parameters,
        help='parameters to determine, all by default; gear_stiffness means that of every '
        'drive. The others count as unknown, but their intervals do not matter',
    )
    parser.add_argument(
        '--criterion',
        choices=('d', 'worst'),
        default='d',
        help='d: least volume of the joint confidence region (default); worst: smallest of the '
        'largest intervals, in widths of the ranges in the machine file',
    )
    group = parser.add_argument_group('expected parameters; the middle of their ranges by default')
    add(group, '--set', help='an expected parameter')
    group.add_argument(
        '--results', metavar='RESULTS', help='those that `ident identify` or `diagnose` found'
    )
    add(group, '--fix', help='a parameter that is known')
    group.add_argument(
        '--rate', type=positive, metavar='HZ', help='samples of the log; one in every cycle'
    )
    group = parser.add_argument_group('motion')
    group.add_argument(
        '--harmonics', type=whole, default=8, help='largest number of frequencies; 8 by default'
    )
    group.add_argument(
        '--rest', type=not_negative, default=0.25, help='rest before and after, s; 0.25'
    )
    group.add_argument(
        '--lead', type=not_negative, default=3.0,
        help='time the trajectory gives to reach its first point, s; 3 by default',
    )  # fmt: skip
    group = parser.add_argument_group('search')
    group.add_argument('--seed', type=whole, default=0, help='of the search')
    group.add_argument(
        '--generations', type=whole, default=GENERATIONS, help=f'{GENERATIONS} by default'
    )
    group.add_argument('--max-seconds', type=positive, metavar='S', help='wall time of the search')
    group.add_argument('--threads', type=whole, default=0, help='all processors by default')
    add(group, '--quiet')


def run(args: argparse.Namespace) -> int:
    """Plan, write, say what it is worth."""
    from ros2_ident.cli.progress import Meter
    from ros2_ident.cli.runs import answered
    from ros2_ident.excite.course import courses_for
    from ros2_ident.excite.files import PICTURE, require_place, write_excitation
    from ros2_ident.excite.information import Sensitivity
    from ros2_ident.excite.limits import limits_of
    from ros2_ident.excite.plan import excite
    from ros2_ident.models import load_machine

    require_place(args.out)
    machine = load_machine(args.machine)
    limits = limits_of(machine, args.limits)
    courses = courses_for(machine, limits, args.seconds, args.harmonics, args.rest)
    sensitivity = Sensitivity(
        machine,
        values=_expected(args),
        drives=args.drives,
        fixed=once(args.fix, '--fix'),
        rate=args.rate,
    )
    with answered(_say) as answer:
        with Meter(quiet=args.quiet) as meter:
            found = excite(
                courses,
                sensitivity,
                _wish(args),
                on_progress=lambda p: meter(
                    min(1.0, p.evaluations / p.budget), f'{p.evaluations} motions tried'
                ),
            )
        answer(found)
        series = courses.series
        files = write_excitation(
            args.out,
            found,
            machine.drives,
            float(series.harmonics.max()) / series.period,
            args.lead,
            shlex.join(['ident', *args.words]),
        )
    print(f'written: {", ".join(str(path) for path in files)}')
    if Path(args.out) / PICTURE not in files:
        print('no picture is drawn: `pip install "ros2-ident[picture]"`', file=sys.stderr)
    return 0


def _expected(args: argparse.Namespace) -> dict[str, float]:
    """Return the expected parameters: those found before, and those given over them."""
    given = once(args.set, '--set')
    if args.results is None:
        return given
    from ros2_ident.export.estimate import read_estimate

    return {**read_estimate(args.results).values, **given}


def _wish(args: argparse.Namespace) -> 'Wish':
    """Return what is to be determined, and how to search."""
    from dataclasses import replace

    from ros2_ident.excite.plan import SEARCH, Wish
    from ros2_ident.search import Budget
    from ros2_ident.threads import processors

    generations = max(1, args.generations)
    # Fewer generations shrink their steps as far.
    shrink = SEARCH.range_reduction ** (SEARCH.generations / generations)
    settings = replace(SEARCH, generations=generations, range_reduction=shrink)
    return Wish(
        names=args.parameters,
        criterion=args.criterion,
        seed=args.seed,
        settings=settings,
        budget=Budget(seconds=args.max_seconds),
        threads=args.threads or processors(),
    )


def _say(found: 'Excitation') -> None:
    """Print the intervals to expect, and what of the limits the motion takes."""
    from ros2_ident.cli.table import columns

    rows = [('parameter', 'expected', '95 %', 'a random motion', 'unit')]
    for n, p in enumerate(found.parameters):
        if found.wanted[n]:
            half, chance = found.half_widths[n], found.chance[n]
            rows.append(
                (p.name, f'{found.values[n]:.5g}', f'± {half:.2g}', f'± {chance:.2g}', p.unit)
            )
    columns(rows, '<>>><')
    loads = ', '.join(f'{100.0 * x:.0f} % {name}' for name, x in found.loads.items() if x > 0.0)
    print(f'of the limits it takes at most: {loads}')
