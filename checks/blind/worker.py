# SPDX-License-Identifier: Apache-2.0
"""The process that diagnoses: told paths on its input, one case a line, and nothing else.

It runs `ident diagnose` as a user would. A hook refuses every file of the run's directory that is
not the case's own, and what the system tells of other processes.
"""

from collections.abc import Sequence
import contextlib
import io
import json
import os
from pathlib import Path
import resource
import sys
import time
from typing import Any

# The diagnosis must not be able to ask the ones who know.
FORBIDDEN = (
    'checks.reference',
    'checks.blind.draw',
    'checks.blind.forms',
    'checks.blind.seal',
    'checks.generators',
)


class Fence:
    """Refuses files of the run that are not the present case's."""

    def __init__(self, root: Path) -> None:
        self.root = str(root.resolve()) + os.sep
        self.open_to: tuple[str, ...] = ()

    def __call__(self, event: str, args: tuple[Any, ...]) -> None:
        """Judge one audit event."""
        if event not in ('open', 'os.listdir', 'os.scandir', 'sqlite3.connect'):
            return
        if not args or not isinstance(args[0], (str, bytes, os.PathLike)):
            return
        path = os.path.abspath(os.fsdecode(args[0]))
        if path.startswith('/proc/') and path.rpartition('/')[2] in ('cmdline', 'environ'):
            raise PermissionError(f'{path} is not for the diagnosis')
        inside = path.startswith(self.root) or path + os.sep == self.root
        if inside and not any(path == p or path.startswith(p + os.sep) for p in self.open_to):
            raise PermissionError(f'{path} is not for the diagnosis')


def spent() -> float:
    """Return the processor time of this process and of those it has waited for [s]."""
    whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(x.ru_utime + x.ru_stime for x in map(resource.getrusage, whose))


def diagnose(order: dict[str, str], fence: Fence) -> dict[str, Any]:
    """Run one diagnosis, and an identification where one is asked for; say how they went."""
    files = (path for key, path in order.items() if key not in ('output', 'threads', 'method'))
    fence.open_to = tuple(map(os.path.abspath, files))
    of_what = [order['fit'], '--machine', order['machine'], '--quiet', '--no-overlay']
    words = ['diagnose', *of_what, '--out', order['out'], '--no-report', '--resume']
    for name in ('check', 'output', 'threads'):
        words += [f'--{name}', order[name]] if name in order else []
    went: dict[str, Any] = {}
    if 'identify' in order:
        asked = ['identify', *of_what, '--out', order['identify']]
        asked += ['--method', order['method']] if 'method' in order else []
        went = {'identify': _ran(asked)}
    went |= _ran(words)
    fence.open_to = ()
    known = [name for name in sys.modules if name.startswith(FORBIDDEN)]
    if known:
        went['error'] = went['error'] or f'the diagnosis has loaded {known[0]}'
    return went


def _ran(words: list[str]) -> dict[str, Any]:
    """Run a command; return what was wrong, and its seconds."""
    from ros2_ident.cli.main import main

    text = io.StringIO()
    begin, cpu = time.monotonic(), spent()
    error = ''
    try:
        with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
            code = main(words)
        if code:
            error = f'exit code {code}: {text.getvalue().strip()[-500:]}'
    except Exception as exc:  # a crash of the diagnosis is a finding, not the end of the check
        error = f'{type(exc).__name__}: {exc}'
    return {'error': error, 'seconds': time.monotonic() - begin, 'cpu_seconds': spent() - cpu}


def main(argv: Sequence[str]) -> int:
    """Serve cases until the input ends."""
    fence = Fence(Path(argv[0]))
    sys.addaudithook(fence)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'w')
    for line in sys.stdin:
        if line.strip():
            print(json.dumps(diagnose(json.loads(line), fence)), file=answers, flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
