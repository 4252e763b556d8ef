# SPDX-License-Identifier: Apache-2.0
"""Common parts of commands that run for long: Ctrl-C, the answer at the end, files and page.

Ctrl-C ends a run with what it found; a second one ends the process.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack, nullcontext
from dataclasses import replace
import os
from pathlib import Path
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any, TYPE_CHECKING

from ros2_ident.errors import ErrorCode, IdentError

if TYPE_CHECKING:
    from ros2_ident.jobs import Logs, Request
    from ros2_ident.report.page import LivePage


@contextmanager
def interrupts(out: object) -> Iterator[threading.Event]:
    """Give an event that SIGINT and SIGTERM set while the block runs.

    Args:
        out: Where the run will be written; what is false for nowhere.
    """
    event = threading.Event()
    written = ' and written' if out else '; without --out nothing is written'

    def stop(number: int, frame: FrameType | None) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()
        # The signal may have come in the middle of a `print`, which cannot be entered twice.
        os.write(2, f'stopping; what is found by now is printed{written}\n'.encode())

    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def carry_out(
    args: argparse.Namespace,
    request: 'Request',
    find: Callable[..., Any],
    show: Callable[[Any], None],
) -> Any:
    """Find what was asked for, write it, print it, and return it.

    Args:
        args: `begun`, `out`, `resume`, `live`, `quiet`, `no_overlay` and `no_report`.
        find: `jobs.identify` or `jobs.diagnose`.
    """
    from ros2_ident import jobs
    from ros2_ident.cli.progress import Meter, WRITING
    from ros2_ident.files import remove_file, sole_writer
    from ros2_ident.report import files, overlay

    logs = jobs.read(request)
    written: list[Path] = []
    page = ''
    identifying = find is jobs.identify
    checkpoint = files.CHECKPOINT if identifying else files.DIAGNOSIS_CHECKPOINT
    names = files.OF_RESULT if identifying else files.OF_DIAGNOSIS
    place = sole_writer(args.out, names) if args.out else nullcontext()
    # shown whatever becomes of the files, and after them: its reader may leave early, as `head`
    with ExitStack() as answer, place as out:
        if out is not None and not args.no_overlay:
            # before any work: bags that are not ours to replace
            overlay.require_place(out / overlay.OVERLAY, logs.fit, [*request.bags, *request.check])
        kept = None if out is None else out / checkpoint
        if kept is not None and not args.resume:
            remove_file(kept)
        with _live_page(args, out, request, logs, identifying) as live, interrupts(out) as cancel:
            writing = 0.0 if out is None else WRITING * (time.monotonic() - args.begun)

            def tell(progress: Any) -> None:
                progress = replace(progress, eta=progress.eta + writing)
                meter.show(progress)
                if live is not None:
                    live.show(progress)

            with Meter(quiet=args.quiet) as meter:
                done = find(request, logs, cancel=cancel, on_progress=tell, checkpoint=kept)
                answer.callback(show, done.result)
                if out is not None:
                    written = jobs.save(done, out, overlay=not args.no_overlay, live=args.live)
            try:
                answer.close()
                if written:
                    print('written: ' + ', '.join(map(str, written)), flush=True)
            finally:
                if out is not None:
                    page = page_line(out, wanted=not args.no_report)
    print(page, end='', flush=True)
    return done


def _live_page(
    args: argparse.Namespace, out: Path | None, request: 'Request', logs: 'Logs', identifying: bool
) -> 'LivePage | nullcontext[None]':
    """Return the page on a run that goes on; nothing where it is not wanted."""
    if not args.live:
        return nullcontext()
    if out is None or args.no_report:
        raise ErrorCode.INVALID_GOAL.error(
            '--live shows the run where its report will be; give --out, and leave out --no-report'
        )
    from ros2_ident.report.page import LivePage

    drives = ', '.join(args.drives or logs.fit.datasets[0].names)
    seconds = sum(dataset.duration for dataset in logs.fit.datasets)
    bags = ', '.join('/'.join(Path(bag).resolve().parts[-2:]) for bag in args.bag)
    problem = request.problem(logs.fit) if identifying else None
    doing = 'Identifying' if identifying else 'Diagnosing'
    page = LivePage(out, f'{doing} {bags}', f'{drives}; {seconds:.3g} s', problem)
    print(f'live: {page.place}', file=sys.stderr)
    return page


def page_line(directory: Path, *, wanted: bool) -> str:
    """Write the page at the end of a run; a run is not lost where that fails.

    Args:
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
