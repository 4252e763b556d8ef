# SPDX-License-Identifier: Apache-2.0
"""The rooms of docs/architecture.md, as import-linter sees them."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

pytest.importorskip('importlinter', reason='import-linter is not installed; run `make setup`')

ROOT = Path(__file__).parents[1]
LINT = (
    'import sys; from importlinter.application.use_cases import lint_imports;'
    'from importlinter.configuration import configure; configure();'
    'sys.exit(0 if lint_imports(cache_dir=None) else 1)'
)


def lint(folder: Path) -> tuple[bool, str]:
    """Return whether the contracts hold for the package in a folder, and what is said."""
    ran = subprocess.run(
        [sys.executable, '-c', LINT],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': str(folder)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    said = ran.stdout + ran.stderr
    assert 'Contracts: ' in said, said
    return ran.returncode == 0, said


# Module, what is added to it, the contract it breaks.
WRONG = [
    # an import inside a function counts
    ('recording/grid.py', 'def f():\n    import ros2_ident.machine.file\n', 'A room imports'),
    ('excite/plan.py', 'import checks.share\n', 'The package knows'),
    ('gap/law.py', 'import matplotlib\n', 'gap/ knows'),
    ('report/schema.py', 'import ros2_ident.models.tripod.kernel\n', 'report/ knows'),
    ('cli/table.py', 'def f():\n    import rclpy\n', 'Only ros/'),
    ('models/registry_.py', 'import ros2_ident.search.driver\n', 'models/ know'),
    ('search/noise.py', 'import ros2_ident.recording\n', 'search/, kernel/'),
    ('recording/streams.py', 'def f():\n    import ros2_ident.recording.grid\n', 'No circles'),
]


def test_imports_that_are_not_allowed_are_found(tmp_path: Path) -> None:
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    for path in (p for top in ('checks', 'ros2_ident') for p in (ROOT / top).rglob('*.py')):
        target = tmp_path / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    for module, text, _ in WRONG:
        with (tmp_path / 'ros2_ident' / module).open('a', encoding='utf-8') as file:
            file.write(text)
    kept, said = lint(tmp_path)
    assert not kept
    lines = [line for line in said.splitlines() if 'BROKEN' in line]
    for _, _, broken in WRONG:
        assert any(line.startswith(broken) for line in lines), said
    # A room that no contract names.
    (tmp_path / 'ros2_ident/cellar.py').touch()
    assert 'cellar' in lint(tmp_path)[1]
