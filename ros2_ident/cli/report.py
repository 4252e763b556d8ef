# SPDX-License-Identifier: Apache-2.0
"""`ident report`: one page on a result directory."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
import sys
import time
from typing import Any, TYPE_CHECKING

from ros2_ident.errors import ErrorCode, IdentError

if TYPE_CHECKING:
    from ros2_ident.identify.data import Data
    from ros2_ident.identify.problem import Problem
    from ros2_ident.jobs import Request
    from ros2_ident.report.page import LivePage

DESCRIPTION = (
    'Write a page on what a result directory holds: what is wrong with the simulation, how sure '
    'that is, how far the gap closes, what to do now, and the details. Of several directories, '
    'write one page that compares them. A page is one HTML file; it opens without a network and '
    'prints.'
)
EXAMPLES = (
    '  ident report results\n'
    '  ident report results --page axis_7.html\n'
    '  ident report before after --page before_and_after.html\n'
    '\n'
    '`ident identify` and `ident diagnose` write the page by themselves; this writes it again,\n'
    'for an older directory or after both have written to one.\n'
)
EXIT_CODES = {0: 'the page is written'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        'directory',
        metavar='DIR',
        nargs='+',
        help='what `ident identify`, `ident diagnose` or `ident fleet` wrote; the others are '
        'compared with the first',
    )
    parser.add_argument(
        '--page',
        metavar='FILE',
        type=Path,
        help='file to write; by default report.html in DIR, of several comparison.html in the '
        'first',
    )


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from ros2_ident.report.page import write_comparison, write_report

    if len(args.directory) == 1:
        page = write_report(args.directory[0], args.page)
    else:
        page = write_comparison(args.directory, args.page)
    print(f'written: {page}')
    return 0


def carry_out(
    args: argparse.Namespace,
    request: 'Request',
    find: Callable[..., Any],
    show: Callable[[Any], None],
    files: Sequence[str],
    checkpoint: str,
    begun: float,
) -> Any:
    """Find what was asked for, write it, and print it.

    Args:
        args: `out`, `resume`, `live`, `quiet`, `no_overlay` and `no_report`.
        request: What was asked for.
        find: `jobs.identify` or `jobs.diagnose`.
        show: Prints a result.
        files: Names of all that may be written.
        checkpoint: Name of the file to go on from.
        begun: When the command began, by `time.monotonic`, s.

    Returns:
        What `find` returned.
    """
    from ros2_ident import jobs
    from ros2_ident.cli.interrupt import interrupts
    from ros2_ident.cli.progress import Meter, WRITING
    from ros2_ident.files import sole_writer
    from ros2_ident.search.journal import forget

    logs = jobs.read(request)
    written: list[Path] = []
    page = ''
    place = sole_writer(args.out, files) if args.out else nullcontext()
    # last: whoever reads the output may leave early, as `head` does
    with answered(show) as answer, place as out:
        if out is not None and not args.no_overlay:
            jobs.require_room(request, logs, out)
        kept = None if out is None else out / checkpoint
        if kept is not None and not args.resume:
            forget(kept)
        problem = request.problem(logs.fit) if args.live and find is jobs.identify else None
        with (
            live_page(args, out, logs.fit, problem) as live,
            interrupts() as cancel,
            Meter(quiet=args.quiet) as meter,
        ):
            writing = 0.0 if out is None else WRITING * (time.monotonic() - begun)

            def tell(progress: Any) -> None:
                progress = replace(progress, eta=progress.eta + writing)
                meter.show(progress)
                if live is not None:
                    live.show(progress)

            done = find(request, logs, cancel=cancel, on_progress=tell, checkpoint=kept)
            answer(done.result)
            if out is not None:
                written = jobs.save(done, out, overlay=not args.no_overlay)
                page = page_line(out, wanted=not args.no_report)
    if written:
        print('written: ' + ', '.join(str(path) for path in written))
    print(page, end='', flush=True)
    return done


def live_page(
    args: argparse.Namespace, out: Path | None, data: 'Data', problem: 'Problem | None' = None
) -> 'AbstractContextManager[LivePage | None]':
    """Return the page on a run that goes on; nothing where it is not wanted.

    Args:
        args: `live`, `no_report`, `bag` and `drives`.
        out: The directory for the results.
        data: What was read.
        problem: Of an identification.

    Raises:
        IdentError: INVALID_GOAL where there is no place for it.
    """
    if not args.live:
        return nullcontext()
    if out is None or args.no_report:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            '--live shows the run where its report will be; give --out, and leave out --no-report',
        )
    from ros2_ident.report.page import LivePage

    drives = ', '.join(args.drives or data.datasets[0].names)
    seconds = sum(dataset.duration for dataset in data.datasets)
    bags = ', '.join('/'.join(Path(bag).resolve().parts[-2:]) for bag in args.bag)
    doing = 'Identifying' if problem else 'Diagnosing'
    page = LivePage(out, f'{doing} {bags}', f'{drives}; {seconds:.3g} s', problem)
    print(f'live: {page.place}', file=sys.stderr)
    return page


@contextmanager
def answered(show: Callable[[Any], None]) -> Iterator[Callable[[Any], None]]:
    """Take an answer and show it at the end, whatever becomes of the files."""
    found: list[Any] = []
    try:
        yield found.append
    finally:
        for answer in found:
            show(answer)


def page_line(directory: Path, *, wanted: bool) -> str:
    """Write the page at the end of a run; a run is not lost where that fails.

    Args:
        directory: Where the run has written its files.
        wanted: False only takes away the page on an earlier run.

    Returns:
        The line that says where it is; empty where none was written.
    """
    from ros2_ident.files import remove_file
    from ros2_ident.report.files import PAGE

    try:
        remove_file(directory / PAGE)
        if not wanted:
            return ''
        from ros2_ident.report.page import write_report

        return f'page: {write_report(directory)}\n'
    except IdentError as error:
        print(f'no page is written: {error.message}', file=sys.stderr)
        return ''
