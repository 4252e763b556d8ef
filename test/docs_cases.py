# SPDX-License-Identifier: Apache-2.0
"""Fenced blocks of the documentation: commands, what they print, and a clone to run them in."""

from dataclasses import dataclass
from functools import cache
import os
from pathlib import Path
import re
import shlex
import subprocess

from forked import forked
import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob('*.md'), *ROOT.glob('docs/*.md'), ROOT / 'bags/README.md'])
FENCE = re.compile(
    r'^(?:<!-- (?P<mark>not run|printed by|not printed): (?P<reason>[^>]*?) -->\n)?'
    r'```(?P<language>\w*)\n(?P<text>.*?)^```$',
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """A fenced block: its page, its text, and the mark above it with its reason."""

    page: str
    text: str
    mark: str
    reason: str

    @property
    def commands(self) -> list[list[str]]:
        """Its commands as words."""
        lines = self.text.replace('\\\n', ' ').splitlines()
        return [words for line in lines if (words := shlex.split(line, comments=True))]


@cache
def blocks(language: str) -> tuple[Block, ...]:
    """All blocks of a language, '' for those that say none."""
    return tuple(
        Block(page.relative_to(ROOT).as_posix(), m['text'], m['mark'] or '', m['reason'] or '')
        for page in PAGES
        for m in FENCE.finditer(page.read_text(encoding='utf-8'))
        if m['language'] == language
    )


def run_pages() -> list[str]:
    """Pages with commands that are run."""
    return list(dict.fromkeys(b.page for b in blocks('bash') if b.mark != 'not run'))


def fill_clone(folder: Path) -> Path:
    """Make a folder look like this one, but for what it has built."""
    for path in ROOT.iterdir():
        if path.name not in ('build', 'log', '.git'):
            (folder / path.name).symlink_to(path)
    (folder / 'build').mkdir()
    return folder


@cache
def run_of(page: str, clone: Path) -> subprocess.CompletedProcess[str]:
    """What the commands of a page print, both streams in one."""
    if not (ROOT / 'install/.stamp').is_file():
        pytest.skip('the tree is not set up, so that there is no env.sh to begin with')
    script = ['set -euo pipefail', '. ./env.sh', f'export PYTHONPATH={ROOT}:${{PYTHONPATH:-}}']
    script += [f'ident() {{ {shlex.join(forked())} -m ros2_ident.cli.main "$@"; }}']
    script += [b.text for b in blocks('bash') if b.page == page and b.mark != 'not run']
    return subprocess.run(
        ['bash', '-c', '\n'.join(script)],
        cwd=clone,
        env={**os.environ, 'HOME': str(clone / 'build')},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=500,
    )
