# SPDX-License-Identifier: Apache-2.0
"""`ident check`: what is in a bag, and whether it can be used."""

import argparse
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import (
    add_bag,
    add_drives,
    add_effort,
    add_machine,
    add_topics,
    machine_of,
    topics_of,
)

if TYPE_CHECKING:
    from ros2_ident.models import Machine

DESCRIPTION = (
    'Say what is in a bag: streams, rates, gaps, missing values, motion, and whether the efforts '
    'are plausible; with a machine file also whether they fit it, and how long an identification '
    'takes.'
)
EXAMPLES = (
    '  ident check my_bag\n'
    '  ident check my_bag --machine my.yaml\n'
    '  ident check my_bag --machine my.yaml --effort-topic /drives/torque\n'
    '\n'
    'exit codes: 0 nothing wrong (warnings included), 1 errors found, 2 the bag cannot be read\n'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_bag(parser)
    add_machine(parser, required=False)
    add_drives(parser)
    add_effort(parser)
    add_topics(parser)


def run(args: argparse.Namespace) -> int:
    """Print the report."""
    from ros2_ident.errors import IdentError
    from ros2_ident.recording import check, read_bag, render
    from ros2_ident.segments import gather

    machine = machine_of(args) if args.machine else None
    recordings = read_bag(args.bag, topics_of(args))
    report = check(recordings, machine)
    for line in render(report):
        print(line)
    if machine is not None:
        try:
            data = gather(recordings, machine, args.drives)
            print(_estimate(machine, args, data))
        except IdentError as error:
            print(f'error: cannot be identified: {error.message}')
            return 1
    return 1 if report.level == 'error' else 0


def _estimate(machine: 'Machine', args: argparse.Namespace, data: object) -> str:
    """Return how long an identification takes here, by simulating a few candidates."""
    import time

    import numpy as np

    from ros2_ident.cli.progress import duration
    from ros2_ident.lanes import WIDTH
    from ros2_ident.problem import Problem
    from ros2_ident.search import GeneticSettings, ThreadedEvaluator
    from ros2_ident.segments import Data
    from ros2_ident.threads import processors

    assert isinstance(data, Data)
    problem = Problem(machine, data, drives=args.drives)
    lot = WIDTH * processors()
    points = np.random.default_rng(0).random((2 * lot, len(problem.parameters)))
    points = points[np.argsort(problem.work(points), kind='stable')]
    theta = problem.low + points * (problem.high - problem.low)
    with ThreadedEvaluator(problem.costs, processors()) as costs:
        costs(theta[:lot])
        start = time.monotonic()
        costs(theta)
        each = (time.monotonic() - start) / len(theta)
    candidates = GeneticSettings().evaluations
    return (
        f'identification: {len(problem.parameters)} parameters, {problem.samples} effort samples; '
        f'about {duration(each * candidates)} for {candidates} candidates, and the refinement'
    )
