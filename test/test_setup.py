# SPDX-License-Identifier: Apache-2.0
"""What is missing on a machine is said in one sentence with the remedy, and nothing is begun."""

from collections.abc import Callable
import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]
COMMANDS = ('bash', 'cat', 'cut', 'find', 'grep', 'sha256sum', 'sort')
PYTHON = f'exec {sys.executable} "$@"'
OLD_PYTHON = f'exec {sys.executable} -c "import sys; sys.version_info = (3, 8, 10)$2"'

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what the set-up reads."""
    tree = tmp_path / 'tree'
    shutil.copytree(ROOT / 'tools', tree / 'tools')
    shutil.copytree(ROOT / 'msg_defs', tree / 'msg_defs')
    for path in (ROOT / 'env.sh', *ROOT.glob('requirements*')):
        shutil.copy(path, tree)
    for name in ('setup.py', 'setup.cfg', 'package.xml', 'colcon_defaults.yaml'):
        shutil.copy(ROOT / name, tree)
    return tree


@pytest.fixture
def run(tree: Path, tmp_path: Path) -> Run:
    """Run a command in the tree, on a machine that has only the given programs."""
    folder = tmp_path / 'bin'
    folder.mkdir()

    def run(*command: str, env: dict[str, str] | None = None, **programs: str):
        for name in COMMANDS:
            (folder / name).symlink_to(str(shutil.which(name)))
        for name, script in programs.items():
            path = folder / name.replace('xx', '++')
            path.write_text(f'#!{shutil.which("sh")}\n{script}\n', encoding='utf-8')
            path.chmod(0o755)
        return subprocess.run(
            command,
            cwd=tree,
            env={'PATH': str(folder), **(env or {})},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    return run


def assert_one_sentence(result: subprocess.CompletedProcess[str], *parts: str) -> None:
    assert result.returncode == 1, result.stdout + result.stderr
    assert result.stdout == ''
    assert result.stderr.startswith('setup: ')
    assert result.stderr.count('\n') == 1, result.stderr
    for part in parts:
        assert part in result.stderr


TOOLS = {'cc': 'exit 0', 'cxx': 'exit 0', 'make': 'exit 0'}


@pytest.mark.parametrize(
    ('programs', 'parts'),
    [
        ({'python3': PYTHON, 'make': 'exit 0'}, ('no C++ compiler', 'build-essential')),
        ({'python3': PYTHON, 'make': 'exit 0', 'cc': 'exit 0'}, ('no C++ compiler',)),
        ({'python3': PYTHON, 'cc': 'exit 0', 'cxx': 'exit 0'}, ('make not found',)),
        ({**TOOLS, 'python3': OLD_PYTHON}, ('python3 is version 3.8.10', '3.11 to 3.13')),
        ({**TOOLS, 'python3': 'exit 127'}, ('python3 does not start', 'install it')),
        (TOOLS, ('python3 not found', 'install it')),
    ],
    ids=['no compiler', 'C only', 'no make', 'old Python', 'broken Python', 'no Python'],
)
def test_a_missing_tool_is_named_with_its_remedy(
    run: Run, tree: Path, programs: dict[str, str], parts: tuple[str, ...]
) -> None:
    assert_one_sentence(run('tools/setup.sh', **programs), *parts)
    assert not (tree / '.venv').exists()
    assert not (tree / 'build').exists()


@pytest.mark.parametrize(
    ('distribution', 'python', 'parts'),
    [
        ('humble', PYTHON, ('ROS 2 humble is sourced, not Jazzy',)),
        ('jazzy', 'exit 1', ('cannot import rclpy', 'PATH')),
        ('jazzy', 'exit 0', ('colcon not found', 'ros-dev-tools')),
    ],
)
def test_a_sourced_ros_has_to_be_whole(
    run: Run, distribution: str, python: str, parts: tuple[str, ...]
) -> None:
    result = run('tools/setup.sh', env={'ROS_DISTRO': distribution}, python3=python, **TOOLS)
    assert_one_sentence(result, *parts)


@pytest.mark.parametrize('shell', ['bash', 'sh', 'zsh'])
def test_the_shell_script_says_that_the_set_up_is_missing(tree: Path, shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f'{shell} is not installed')
    result = subprocess.run(
        [shell, '-c', '. ./env.sh || echo failed'],
        cwd=tree,
        env={'PATH': os.environ['PATH']},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.stdout == 'failed\n'
    assert result.stderr == f'env.sh: {tree} is not set up; run `make setup` there first.\n'
