# SPDX-License-Identifier: Apache-2.0
"""One folder speaks ROS."""

from pathlib import Path
import subprocess
import sys

ROOT = Path(__file__).parents[2]
ROS = ('rclpy', 'ros2_ident_msgs', 'sensor_msgs', 'std_msgs', 'rcl_interfaces', 'diagnostic_msgs')


def test_every_other_module_imports_without_ros() -> None:
    modules = sorted(
        '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__')
        for path in (ROOT / 'ros2_ident').rglob('*.py')
        if 'ros' not in path.relative_to(ROOT).parts and path.stem != '__main__'
    )
    assert len(modules) > 20
    script = (
        'import importlib, sys\n'
        f'for name in {ROS}:\n'
        '    sys.modules[name] = None\n'
        f'for name in {modules}:\n'
        '    importlib.import_module(name)\n'
    )
    ran = subprocess.run(
        [sys.executable, '-c', script],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr[-2000:]
