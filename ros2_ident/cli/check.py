# SPDX-License-Identifier: Apache-2.0
"""`ident check`: what is in a bag, what is in a machine file, and whether they can be used."""

import argparse
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import topics_of, with_effort
from ros2_ident.errors import ErrorCode, IdentError

if TYPE_CHECKING:
    from ros2_ident.identify.data import Data
    from ros2_ident.models import Machine


def run(args: argparse.Namespace) -> int:
    """Print the report."""
    from dataclasses import replace

    from ros2_ident.commissioning import check_both, check_machine
    from ros2_ident.identify.data import gather
    from ros2_ident.models.registry import read_machine_file, travel_of
    from ros2_ident.recording import check, read_bag, render, Report

    file = read_machine_file(args.machine) if args.machine else None
    if file is not None and file.machine is not None:
        file = replace(file, machine=with_effort(file.machine, args))
    if args.bag is None:
        if file is None:
            raise IdentError(
                ErrorCode.INVALID_GOAL, 'there is nothing to check; give a bag, --machine, or both'
            )
        report = Report(file.name, findings=check_machine(file))
        recordings = []
    else:
        machine = file.machine if file else None
        travel = travel_of(machine) if machine else None
        recordings = read_bag(args.bag, topics_of(args), travel=travel)
        report = check_both(recordings, file, args.drives) if file else check(recordings)
    for line in render(report):
        print(line)
    if report.level == 'error':
        return 1
    if file is not None and file.machine is not None:
        if recordings:
            print(_estimate(file.machine, args, gather(recordings, file.machine, args.drives)))
        elif report.level == 'ok':
            print('ok    every key is known and plausible')
    return 0


def _estimate(machine: 'Machine', args: argparse.Namespace, data: 'Data') -> str:
    """Return how long an identification takes here, by simulating a few candidates."""
    import time

    import numpy as np

    from ros2_ident.identify.problem import problem_of
    from ros2_ident.lanes import WIDTH
    from ros2_ident.search import GeneticSettings, ThreadedEvaluator
    from ros2_ident.threads import processors
    from ros2_ident.words.figures import duration

    problem = problem_of(machine, data, drives=args.drives)
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
    seconds = each * candidates
    long = 'less than 1 s' if seconds < 1.0 else f'about {duration(seconds)}'
    return (
        f'identification: {len(problem.parameters)} parameters, {problem.samples} effort samples; '
        f'{long} for {candidates} candidates, and the refinement'
    )
