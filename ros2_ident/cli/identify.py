# SPDX-License-Identifier: Apache-2.0
"""`ident identify`: a machine's parameters from a bag."""

import argparse

from ros2_ident.cli.arguments import asked, searched
from ros2_ident.cli.runs import carry_out


def run(args: argparse.Namespace) -> int:
    """Identify, write the results, print them."""
    from ros2_ident import jobs
    from ros2_ident.cli.table import print_result
    from ros2_ident.identify.result import Outcome

    request = jobs.knowing(jobs.Request(**asked(args), **searched(args)), args.earlier)
    done = carry_out(args, request, jobs.identify, print_result)
    return 0 if done.result.outcome is Outcome.IDENTIFIED else 1
