# SPDX-License-Identifier: Apache-2.0
"""`ident identify`: a machine's parameters from a bag."""

import argparse
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import asked, from_earlier, searched
from ros2_ident.cli.runs import carry_out

if TYPE_CHECKING:
    from ros2_ident.jobs import Request


def request_of(args: argparse.Namespace) -> 'Request':
    """Return what parsed arguments ask for."""
    from ros2_ident.jobs import Request

    return from_earlier(Request(**asked(args), **searched(args)), args)


def run(args: argparse.Namespace) -> int:
    """Identify, write the results, print them."""
    from ros2_ident import jobs
    from ros2_ident.cli.table import print_result
    from ros2_ident.identify.result import Outcome

    done = carry_out(args, request_of(args), jobs.identify, print_result)
    return 0 if done.result.outcome is Outcome.IDENTIFIED else 1
