# SPDX-License-Identifier: Apache-2.0
"""`ident check`: what is in a bag, what is in a machine file, and whether they can be used."""

import argparse

from ros2_ident.cli.arguments import topics_of, with_effort
from ros2_ident.errors import ErrorCode


def run(args: argparse.Namespace) -> int:
    """Print the report."""
    from dataclasses import replace

    from ros2_ident.commissioning import check_both, check_machine
    from ros2_ident.models.registry import read_machine_file, travel_of
    from ros2_ident.recording import check, read_bag, render, Report

    file = read_machine_file(args.machine) if args.machine else None
    machine = file.machine if file else None
    if file is not None and machine is not None:
        machine = with_effort(machine, args)
        file = replace(file, machine=machine)
    if args.bag is not None:
        travel = travel_of(machine) if machine else None
        drives = machine.drives if machine else ()
        recordings = read_bag(args.bag, topics_of(args), travel, drives)
        report = check_both(recordings, file, args.drives) if file else check(recordings)
    elif file is not None:
        report = Report(file.name, findings=check_machine(file))
    else:
        raise ErrorCode.INVALID_GOAL.error(
            'there is nothing to check; give a bag, --machine, or both'
        )
    for line in render(report):
        print(line)
    if machine is not None and args.bag is None and report.level == 'ok':
        print('ok    every key is known and plausible')
    return 1 if report.level == 'error' else 0
