# SPDX-License-Identifier: Apache-2.0
"""`ident identify`: a machine's parameters from a bag."""

import argparse
from typing import Any, TYPE_CHECKING

from ros2_ident.cli.arguments import asked, once
from ros2_ident.cli.runs import carry_out

if TYPE_CHECKING:
    from ros2_ident.jobs import Request


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
