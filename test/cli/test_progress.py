# SPDX-License-Identifier: Apache-2.0
"""Progress on a terminal, which is a pty here, and elsewhere."""

import os
import pty
import re
import subprocess
import sys

from identify_cases import AXIS_FILE, ROOT

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
