# SPDX-License-Identifier: Apache-2.0
"""`ident new-machine`: a commented machine file to start from."""

import argparse
from collections.abc import Sequence
from contextlib import suppress
import functools
import os
from pathlib import Path
import shlex
import sys
from typing import Any, TYPE_CHECKING

from ros2_ident.cli.arguments import topics_of
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_text
from ros2_ident.machine.units import STATED_FOR
from ros2_ident.models.registry import KINDS, machine_from_mapping

if TYPE_CHECKING:
    from ros2_ident.recording import Recording


def run(args: argparse.Namespace) -> int:
    """Write the file."""
    import yaml

    from ros2_ident.machine.description import description_text
    from ros2_ident.models import new_file

    folder = Path(args.out).parent if args.out else Path()
    known: dict[str, Any] = {}
    if args.description is not None:
        known['description'] = description_text(Path(args.description))
    log = _log(args, known.get('description', '')) if args.bag else None
    if args.kind is None and (log is None or args.description is None):
        raise ErrorCode.INVALID_GOAL.error(
            f'say of what kind the machine is, --kind {"/".join(KINDS)}; of an arm a description '
            'and a log of it say that, --description and --bag'
        )
    text = None
    if args.description is not None:
        folder.mkdir(parents=True, exist_ok=True)  # the way leads through it
        known['named'] = os.path.relpath(args.description, folder)
    if args.kind is None and log is not None:
        text = new_file.followed_file(args.drives, known['description'], known['named'], log)
    follows = log is not None and log.sets_positions
    kind = KINDS[args.kind] if args.kind else new_file.arm_kind(follows and text is None)
    if args.description is not None:
        new_file.description_key(kind)
    freely = text is not None
    if log is not None:
        if args.description is None:
            text = new_file.driven_file(kind, args.drives, log, args.travel)
        known['log'] = log
    example = text is None and log is not None and args.description is None
    text = text or new_file.new_machine_file(kind, args.drives, **known)
    stated = yaml.safe_load(text)
    unit = machine_from_mapping(stated, '--drives', folder).effort_unit
    if args.out is None:
        print(text, end='')
        return 0
    path = Path(args.out)
    if path.exists():
        raise ErrorCode.INVALID_GOAL.error(
            f'{path}: exists already; remove it or give another name'
        )
    write_text(path, text)
    command = shlex.join(['ident', 'check', '--machine', str(path)])
    key = STATED_FOR.get(unit)
    first = f'state its {key}, as efforts are in {unit}, ' if key in stated else ''
    if example and 'geometry' in stated:
        first += "state its geometry, which is an example's, "
    print(f'written: {path}; {first}change its values, then: {command}')
    if log is not None and kind.joints is not None:
        print(new_file.ways(kind, log, freely))
    if args.description is not None and (said := new_file.held(kind, known['description'])):
        print(said)
    return 0


def _log(args: argparse.Namespace, description: str) -> 'Recording':
    """Return what a bag holds, of a table or arrays by their map, or one made from the names."""
    from ros2_ident.recording import read_bag
    from ros2_ident.recording.table import map_beside, of_columns

    path = Path(args.bag)
    where = map_beside(path)
    there = path.exists()  # of what is not there the reader says so
    named = there and of_columns(path)
    option = '--column' if args.column else '--rate' if args.rate else ''
    if option and there and not named:
        raise ErrorCode.INVALID_GOAL.error(
            f'{option} is of a table or of arrays, which {path} is not; leave it out'
        )
    if named and (option or args.drives or not (args.columns or where.exists())):
        _draft(path, Path(args.columns or where), args, description)
    recording = read_bag(args.bag, topics_of(args))[0]
    if recording.state is None:
        raise ErrorCode.MISSING_STREAM.error(
            f'{args.bag} holds no measured motion; name its topic with --state-topic, or its '
            'columns in the column map'
        )
    efforts = (recording.effort or recording.state).effort
    if efforts is None and recording.command is None:
        raise ErrorCode.MISSING_STREAM.error(
            f'{args.bag} holds motion only, and a motion alone tells no parameter; log the effort '
            'or, of hobby servos, the set-point, or name its topic or column'
        )
    return recording


def _draft(path: Path, where: Path, args: argparse.Namespace, description: str) -> None:
    """Write the column map of a table, or of arrays, by the names there, and print it.

    One that an earlier command has written by the names alone gives way to that by options.
    """
    import yaml

    from ros2_ident.machine.description import joints_in, judged_tree
    from ros2_ident.recording.headers import Header, header_of
    from ros2_ident.recording.limits import printable

    joints = joints_in(judged_tree(description)) if description else ()
    read = functools.cache(header_of)

    def header_by(drives: Sequence[str], columns: Sequence[str], rate: float) -> Header:
        named = {*drives, *joints}
        # joints that have numbers are as many as the drives with or without such as are not driven
        header = read(path).timed(rate)
        header = header.called(drives).driven(columns, named).called(drives)
        return header.assigned(columns).driven(columns, named)

    def text_of(header: Header) -> str:
        text = yaml.safe_dump(header.map(), sort_keys=False, allow_unicode=True)
        return f'# From the names in {printable(path.name)}.\n{text}'

    before = where.read_text() if where.exists() else None
    plain = None
    with suppress(IdentError):
        plain = None if before is None else text_of(header_by((), (), 0.0))
    if before != plain and not (args.column or args.rate):
        return  # as its owner has it
    header = header_by(args.drives, args.column, args.rate)
    header.require_told(path)
    text = text_of(header)
    if before not in (None, plain, text):
        raise ErrorCode.INVALID_GOAL.error(
            f'{where} says what the columns are, so that --column and --rate have no part in '
            'it; correct it there, or remove that file'
        )
    # Bounds of the file come from the log's effort, in N m or N.
    keys = {key.name for key in KINDS[args.kind].keys} if args.kind else set()
    several = len({x.joint for x in header.columns} - {''}) > 1
    own = {'moving_mass'} if several else {'moving_mass', 'link_moment'}
    print(f'{path} is read as', *header.lines(), sep='\n', file=sys.stderr)
    header.require_scales(args.description is None and bool(keys & own))
    if before == text:  # by the same options, of a command that was given again
        return
    write_text(where, text, replace=True)
    print(f'written: {where}; correct it where a column is another', file=sys.stderr)
    options = header.in_order()
    if header.called(joints) is not header:
        options = shlex.join(['--drives', ','.join(joints)])
    if options:
        said = 'are these in the order of the joints? if so, give'
        print(said, options, file=sys.stderr)
