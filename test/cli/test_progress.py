# SPDX-License-Identifier: Apache-2.0
"""Progress on a terminal, which is a pty here, and elsewhere."""

import io
import math
import os
import pty
import re
import subprocess
import sys
import time

from identify_cases import AXIS_FILE, ROOT
import numpy as np

from ros2_ident.cli import progress as module
from ros2_ident.cli.progress import Meter
from ros2_ident.identify.settings import IdentifyProgress

ESCAPE = re.compile(r'\x1b\[[0-9;?]*[A-Za-z]')


def on_a_terminal(words, **environment):
    """Return exit code and what a command writes to a terminal as its standard error."""
    here, there = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, '-m', 'ros2_ident.cli.main', *words],
        env={
            **{k: v for k, v in os.environ.items() if k not in ('NO_COLOR', 'TERM')},
            'PYTHONPATH': str(ROOT),
            'PYTHONIOENCODING': 'utf-8',
            'COLUMNS': '100',
            'LINES': '24',
            **environment,
        },
        stdout=subprocess.DEVNULL,
        stderr=there,
    )
    os.close(there)
    said = b''
    while True:
        try:
            block = os.read(here, 65536)
        except OSError:
            # the other end is closed
            break
        if not block:
            break
        said += block
    os.close(here)
    return process.wait(60), said.decode()


def identify(out):
    words = ['identify', str(ROOT / 'bags/axis_reversals'), '--machine', str(AXIS_FILE)]
    return [*words, '--out', str(out), '--generations', '4', '--no-overlay', '--no-report']


def test_a_terminal_shows_a_bar_and_is_left_clean(tmp_path):
    code, said = on_a_terminal(identify(tmp_path / 'out'), TERM='xterm-256color')
    assert code == 0, said
    plain = ESCAPE.sub('', said)
    assert '━' in plain and re.search(r'\d+%', plain)
    # which of them is drawn hangs on the computer's pace
    assert re.search(r'generation \d of 4|refining start|intervals, ', plain)
    assert re.search(r'best [\d.e+-]+ N', plain)
    # the cursor is hidden while it is drawn and back at the end, and the last line is erased
    assert said.count('\x1b[?25l') == said.count('\x1b[?25h') == 1
    assert said.rindex('\x1b[2K') > said.rindex('━')


def test_lines_where_nothing_shall_be_drawn(tmp_path):
    code, said = on_a_terminal(identify(tmp_path / 'out'), TERM='xterm', NO_COLOR='1')
    assert code == 0, said
    assert '\x1b' not in said
    assert re.search(r'^generation 1 of 4, ', said, re.MULTILINE)


class Terminal(io.StringIO):
    encoding = 'utf-8'

    def isatty(self):
        return True


def progress(cost):
    names = 'drive_1.gear_stiffness', 'drive_1.inertia'
    return IdentifyProgress(
        'search', 3, 12, 500, 1000, cost, 'N m', names, np.zeros(2), 0.25, 65.0, 30.0
    )


def test_what_is_drawn(monkeypatch):
    monkeypatch.delenv('NO_COLOR', raising=False)
    for name, value in {'TERM': 'xterm', 'LINES': '20'}.items():
        monkeypatch.setenv(name, value)

    def drawn(step, columns=120):
        monkeypatch.setenv('COLUMNS', str(columns))
        stream = Terminal()
        with Meter(stream=stream) as meter:
            meter.note('[so far]')
            meter.show(step)
        return ESCAPE.sub('', stream.getvalue())

    text = drawn(progress(0.05))
    assert 'generation 3 of 12, 500 candidates, best 0.05 N m' in text
    assert '1:05 gone, 30 s to go' in text and '50%' in text and '[so far]' in text
    assert 'no candidate converged yet' in drawn(progress(math.inf))
    narrow = drawn(progress(0.05), 80)
    assert '30 s to go' in ' '.join(narrow.split())
    assert max(len(line.rstrip()) for line in re.split('[\r\n]', narrow)) <= 80


def test_notes_stay_beside_the_lines(monkeypatch):
    stream = io.StringIO()
    with Meter(stream=stream) as meter:
        meter(0.5, 'looking')
        meter.note('so far: backlash')
        meter(0.6, 'looking on')
    assert stream.getvalue().splitlines()[1:] == ['so far: backlash']
    monkeypatch.setattr(module, 'LINE_EVERY', 0.0)
    with Meter(quiet=True, stream=stream) as meter:
        meter.note('nothing')
        meter(0.5, 'nothing')
    assert 'nothing' not in stream.getvalue()


def test_a_line_says_what_takes_long_before_the_first_progress(monkeypatch):
    monkeypatch.setattr(module, 'PATIENCE', 0.01)
    stream = io.StringIO()
    with Meter(stream=stream) as meter:
        deadline = time.monotonic() + 5.0
        while not stream.getvalue() and time.monotonic() < deadline:
            time.sleep(0.01)
        assert stream.getvalue() == f'{module.WAIT}\n'
        meter.show(progress(0.5))
    monkeypatch.setattr(module, 'PATIENCE', 0.05)
    quick = io.StringIO()
    with Meter(stream=quick) as meter:
        meter.show(progress(0.5))
        time.sleep(0.1)
    assert module.WAIT not in quick.getvalue()
