# SPDX-License-Identifier: Apache-2.0
"""The documentation site is built without a warning, and holds every page and module."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]


def test_the_site_is_built_strictly_and_whole(tmp_path: Path) -> None:
    pytest.importorskip('mkdocs', reason='mkdocs is not installed')
    done = subprocess.run(
        ['bash', 'tools/docs.sh', '--site-dir', str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, 'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert 'WARNING' not in done.stderr
    for page in ROOT.glob('docs/*.md'):
        assert (tmp_path / f'{page.stem}.html').is_file(), page.name
    api = (tmp_path / 'api/ros2_ident.search.html').read_text(encoding='utf-8')
    assert 'id="ros2_ident.search.refine.refine"' in api
    # words of a docstring, and its sections, and links between pages that lie in two folders
    assert 'Returns:' in api
    text = (tmp_path / 'index.html').read_text(encoding='utf-8')
    assert 'href="readme.html"' in text
    assert 'href="tutorial.html"' in text
    assert '.md"' not in text
