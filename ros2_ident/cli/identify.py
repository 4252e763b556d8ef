# SPDX-License-Identifier: Apache-2.0
"""`ident identify`: a machine's parameters from a bag."""

import argparse
from typing import Any, TYPE_CHECKING

from ros2_ident.cli.arguments import (
    add,
    add_bags,
    add_log,
    asked,
    count,
    interval,
    once,
    parameters,
    positive,
)
from ros2_ident.cli.runs import carry_out

if TYPE_CHECKING:
    from ros2_ident.jobs import Request

DESCRIPTION = (
    "Identify a machine's parameters from a bag: the paper's genetic algorithm, a local "
    'refinement, and 95 % intervals. Ctrl-C keeps the best so far.'
)
EXAMPLES = (
    '  ident identify bags/axis_reversals --machine config/emps.yaml --out results\n'
    '  ident identify bags/tripod_mixed --machine config/tripod.yaml --drives drive_1 --out out\n'
    '  ident identify my_bag --machine my.yaml --fix tool_mass=1.4 \\\n'
    '      --bounds drive_1.gear_stiffness=1e4:1e5 --seed 7 --seconds 60 --out results\n'
    '  ident identify bags/tripod_mixed bags/tripod_pick_and_place --each tool_mass \\\n'
    '      --machine config/tripod.yaml --out results\n'
    '  ident identify bags/tripod_mixed --check bags/tripod_pick_and_place \\\n'
    '      --machine config/tripod.yaml --out results\n'
    '\n'
    'writes to DIR: result.json and result.yaml (the same content), history.npz (every\n'
    'candidate), signals.npz (measured and simulated effort), overlay (a bag with the measured,\n'
    'simulated and residual effort, the result, and of a tripod or an arm its motion as markers\n'
    'for RViz and Foxglove), report.html (all of it as a page); while it runs,\n'
    'identify.checkpoint, which stays where it was cut short\n'
)
EXIT_CODES = {
    0: 'identified',
    1: 'cancelled, budget spent, not identifiable, diverged, or contradicted: log and machine '
    'file disagree, or the model leaves a large part of the log',
}


# Settings whose options have shorter names.
_SETTINGS = {'stagnation': 'stagnation_generations', 'population': 'initial_population'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_bags(parser)
    add(
        parser,
        '--check',
        help='recording that the held-out error is judged on, more than once for several; without '
        'it, each quarter of the log is predicted from the other three',
    )
    add(parser, '--machine')
    add(parser, '--out', required=True)
    add(parser, '--drives')
    add(parser, '--seed', help='same seed and data, same result')
    add(parser, '--fix')
    add(
        parser,
        '--bounds',
        action='append',
        default=[],
        type=interval,
        metavar='NAME=LOW:HIGH',
        words=parameters,
        help="search here instead of in the machine file's bounds",
    )
    add(parser, '--outputs', '--no-overlay', '--no-report', '--live', '--quiet')
    group = parser.add_argument_group('search')
    group.add_argument('--no-refine', action='store_true', help='genetic algorithm only')
    group.add_argument(
        '--resume',
        action='store_true',
        help='continue a run of the same command that was cut short, from '
        'DIR/identify.checkpoint; same result',
    )
    group.add_argument(
        '--method',
        choices=('genetic', 'algebraic'),
        default='genetic',
        help='genetic (default): search; algebraic: weighted least squares along the recorded '
        'motion, for parameters that the effort is linear in',
    )
    group.add_argument(
        '--decimation',
        type=count,
        metavar='N',
        help='least squares: take every Nth sample; 10 by default',
    )
    for name, kind, what in (
        ('evaluations', count, 'simulate at most N candidates'),
        ('seconds', positive, 'stop after N seconds'),
        ('generations', count, 'generations, the first included; 12 by default'),
        ('stagnation', count, 'stop after N generations without improvement; never by default'),
        ('population', count, 'candidates of the first generation; 1024 by default'),
        ('survivors', count, 'parents of the next generation; 8 by default'),
        ('children', count, 'children of each parent; 8 by default'),
        (
            'range-reduction',
            positive,
            'factor on the range of mutation, each generation; 0.5 by default',
        ),
        (
            'min-distance',
            positive,
            'minimum distance of survivors in the unit cube; 0 by default',
        ),
        ('starts', count, 'refine at most N candidates; 4 by default'),
        ('samples', count, 'fit at most N effort samples of a long log; 180000 by default'),
    ):
        field = _SETTINGS.get(name, name.replace('-', '_'))
        group.add_argument(f'--{name}', dest=field, type=kind, metavar='N', help=what)
    add(group, '--threads', '--scheduler')
    add_log(parser)


def request_of(args: argparse.Namespace) -> 'Request':
    """Return what parsed arguments ask for."""
    from dataclasses import fields

    from ros2_ident.identify.outputs import read_outputs
    from ros2_ident.identify.settings import IdentifySettings
    from ros2_ident.jobs import Request
    from ros2_ident.search import Budget, GeneticSettings

    given = {name: value for name, value in vars(args).items() if value is not None}

    def of(kind: Any) -> dict[str, Any]:
        return {x.name: given[x.name] for x in fields(kind) if x.name in given}

    settings = IdentifySettings(
        **of(IdentifySettings),
        genetic=GeneticSettings(**of(GeneticSettings)),
        budget=Budget(evaluations=args.evaluations, seconds=args.seconds),
        refine=not args.no_refine,
    )
    return Request(
        **asked(args),
        bounds=once(args.bounds, '--bounds'),
        outputs=read_outputs(args.outputs),
        settings=settings,
        **({} if args.samples is None else {'samples': args.samples}),
    )


def run(args: argparse.Namespace) -> int:
    """Identify, write the results, print them."""
    from ros2_ident import jobs
    from ros2_ident.cli.table import print_result
    from ros2_ident.identify.result import Outcome

    done = carry_out(args, request_of(args), jobs.identify, print_result)
    return 0 if done.result.outcome is Outcome.IDENTIFIED else 1
