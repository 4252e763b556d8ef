# SPDX-License-Identifier: Apache-2.0
"""`ident export`: what was identified, in the files of simulators and controllers."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

from ros2_ident.cli.arguments import topics_of, with_effort
from ros2_ident.errors import ErrorCode

if TYPE_CHECKING:
    from ros2_ident.identify.problem import Problem
    from ros2_ident.report.estimate import Estimate


def run(args: argparse.Namespace) -> int:
    """Write the files, say what they lack."""
    from ros2_ident.export.content import content_of
    from ros2_ident.export.targets import fitting, TARGETS, write
    from ros2_ident.machine.description import description_text
    from ros2_ident.report.estimate import read_estimate

    wrong = [name for name in args.to or () if name not in TARGETS]
    if wrong:
        raise ErrorCode.INVALID_GOAL.error(
            f'{wrong[0]} is no target; choose from {", ".join(TARGETS)}'
        )
    estimate = read_estimate(args.results)
    problem = _problem(args, estimate)
    content = content_of(problem, estimate, args.prior)
    # The text that values are written into, and where the files lie that it names.
    machine, description = problem.machine, ''
    folder = machine.described_in
    if args.into is not None:
        description, folder = description_text(Path(args.into)), Path(args.into).parent
    elif 'description' in machine.constants:
        description = machine.text('description')
    names = args.to or fitting(content, description)
    files = write(args.out, names, content, description, folder)
    if content.links is not None:
        print(f'links: physically consistent; masses of the description ± {100 * args.prior:g} %')
        if impossible := ', '.join(content.links.mended):
            print(f'the description gives {impossible} inertials that no body can have')
    for name, (path, words) in files.items():
        print(f'{name}: {path}')
        for sentence in words:
            print(f'  {sentence}')
    return 0


def _problem(args: argparse.Namespace, estimate: 'Estimate') -> 'Problem':
    """Return what was solved, with the effects that were found."""
    from ros2_ident.identify.problem import problem_of
    from ros2_ident.identify.run import read_data

    settings = estimate.settings
    machine = machine_behind(args, estimate)
    logs = args.bag or settings.get('bags') or []
    missing = next((log for log in logs if not Path(log).exists()), None)
    if not logs or missing is not None:
        raise ErrorCode.NO_DATA.error(
            f'the log {missing or estimate.source or "of the results"} is not there; give the bag '
            'behind RESULTS'
        )
    drives = estimate.drives or None
    data = read_data(logs, machine, drives, topics=topics_of(args))
    if settings.get('method') == 'algebraic':
        data = data.without_command()
    nominal = problem_of(machine, data, drives=drives, fixed=estimate.fixed)
    effects = estimate.effects(nominal.names)
    if not effects or nominal.setup is None:
        return nominal
    return replace(nominal.setup, effects=effects).problem()


def machine_behind(args: argparse.Namespace, estimate: 'Estimate') -> Any:
    """Return the machine of the file that is given, else of that of the estimate.

    Raises:
        IdentError: INVALID_GOAL where it is not there.
    """
    from ros2_ident.models import load_machine

    before = estimate.settings.get('machine_file')
    found = args.machine or (before if isinstance(before, str) else None)
    if found is None or not Path(found).exists():
        raise ErrorCode.INVALID_GOAL.error(
            f'the machine file {found or "of the results"} is not there; give it with --machine'
        )
    return with_effort(load_machine(found), args)
