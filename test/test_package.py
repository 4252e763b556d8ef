# SPDX-License-Identifier: Apache-2.0
"""The package as others see it: manifests agree, and what is installed is found."""

import ast
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from ros2_ident.errors import ErrorCode

ROOT = Path(__file__).parents[1]
ROS = {'launch', 'launch_ros', 'rclpy'}
CONSTANT = re.compile(r'^(?P<type>\w+) (?P<name>[A-Z][A-Z0-9_]*)=(?P<value>\S+)', re.MULTILINE)


def test_manifests_and_set_up_script_agree_on_the_version() -> None:
    outer = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    inner = ElementTree.parse(ROOT / 'msg_defs/package.xml').findtext('version')
    script = subprocess.run(
        [sys.executable, 'setup.py', '--version'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()[-1]
    assert outer == inner == script


def test_the_message_holds_the_same_error_codes_as_the_library() -> None:
    text = (ROOT / 'msg_defs/msg/ErrorCode.msg').read_text(encoding='utf-8')
    assert {match['name']: int(match['value']) for match in CONSTANT.finditer(text)} == {
        code.name: code.value for code in ErrorCode
    }


# Where the distribution, and where rosdep's key, is called otherwise than the module. rosdep has
# no key for those that another one brings.
DISTRIBUTIONS = {'jinja2': 'Jinja2', 'markupsafe': 'MarkupSafe', 'yaml': 'PyYAML'}
KEYS = {
    'bokeh': 'python3-bokeh-pip',
    'llvmlite': 'python3-numba',
    'lz4': 'python3-rosbags-pip',
    'mcap': 'mcap-ros2-support',
    'markupsafe': 'python3-jinja2',
    'rosbags': 'python3-rosbags-pip',
    'zstandard': 'python3-rosbags-pip',
}
# What is said to be installed where it is asked for: extras.
OPTIONAL = {'distributed', 'google', 'h5py', 'mujoco', 'pinocchio', 'pyarrow'}
OPTIONAL |= {'mujoco_usd_converter', 'pxr', 'urdf_usd_converter', 'usdex'}


def imported(*folders: str) -> set[str]:
    """Return the modules from elsewhere that sources import or find, also inside functions."""
    found = set()
    for path in (path for folder in folders for path in (ROOT / folder).rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module)
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == 'find_spec':
                found |= {x.value for x in node.args if isinstance(x, ast.Constant)}
    tops = {name.partition('.')[0] for name in found}
    return tops - set(sys.stdlib_module_names) - {'ros2_ident'}


def set_up() -> tuple[set[str], set[str]]:
    """Return the set-up script's requirements, and those of the extra `test`."""
    script = (
        'import setuptools, json; from distutils.core import run_setup;'
        "made = run_setup('setup.py', stop_after='init');"
        "print(json.dumps([made.install_requires, made.extras_require['test']]))"
    )
    said = subprocess.run(
        [sys.executable, '-c', script], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    needed, tests = json.loads(said.splitlines()[-1])
    return {re.split('[<>=]', x)[0] for x in needed}, set(tests)


def depends(kind: str) -> set[str]:
    return {str(x.text) for x in ElementTree.parse(ROOT / 'package.xml').findall(f'{kind}_depend')}


def test_what_is_imported_is_declared_and_nothing_else() -> None:
    modules = imported('ros2_ident', 'launch') - OPTIONAL
    # What has a dot-free name of its own in a ROS distribution is declared under that name.
    ros = {x for x in modules if (x.endswith(('_msgs', '_srvs', '_interfaces')) or x in ROS)}
    others = modules - ros
    assert {DISTRIBUTIONS.get(x, x) for x in others} == set_up()[0]
    assert ros | {KEYS.get(x, f'python3-{x}') for x in others} == depends('exec')


def test_requirements_name_what_the_set_up_script_names() -> None:
    lines = (ROOT / 'requirements.in').read_text(encoding='utf-8')
    package, tools = lines.split('# tests, linters')
    assert {x for x in package.splitlines() if x and x[0] != '#'} == set_up()[0]
    assert set_up()[1] <= set(tools.splitlines())


def test_what_the_tests_import_is_declared() -> None:
    found = [*(ROOT / 'test').iterdir(), *(ROOT / 'tools').glob('*.py')]
    own = {path.stem for path in found}
    # What is optional but `pin` and `distributed`: without it tests are skipped.
    skipped = OPTIONAL - {'distributed', 'pinocchio'}
    modules = imported('test') - own - skipped - {'checks', 'conftest'}
    known = depends('exec') | depends('test')
    names = {x: {x, KEYS.get(x, f'python3-{x}')} for x in modules}
    assert not [x for x, keys in names.items() if not keys & known]


def test_a_release_holds_three_packages_side_by_side_and_asks_pip_for_nothing(
    tmp_path: Path,
) -> None:
    words = [str(ROOT / 'tools/release_tree.sh'), str(tmp_path)]
    subprocess.run(words, env={**os.environ, 'LIBRARIES': 'no'}, check=True)
    found = {path.parent.name: ElementTree.parse(path) for path in tmp_path.glob('*/package.xml')}
    vendor = 'ros2_ident_vendor'
    assert found.keys() == {'ros2_ident', 'ros2_ident_msgs', vendor}
    assert len({tree.findtext('version') for tree in found.values()}) == 1
    ours = {str(x.text) for x in found['ros2_ident'].iter() if x.tag.endswith('_depend')}
    pip = {key for key in KEYS.values() if key.endswith('-pip')} | {KEYS['mcap']}
    assert ours == depends('exec') - pip | {vendor}
    assert (tmp_path / 'ros2_ident/ros2_ident/cli/main.py').exists()
    assert (tmp_path / 'ros2_ident_msgs/action/Identify.action').exists()
    assert 'Forthcoming' not in (tmp_path / 'ros2_ident/CHANGELOG.rst').read_text()


@pytest.mark.ros
def test_both_packages_and_their_programs_are_in_the_ament_index() -> None:
    from ament_index_python.packages import get_package_prefix, get_package_share_directory

    prefix = Path(get_package_prefix('ros2_ident'))
    for program in ('ident', 'identifier', 'replay'):
        assert (prefix / 'lib/ros2_ident' / program).stat().st_mode & 0o111
    share = Path(get_package_share_directory('ros2_ident'))
    assert (share / 'package.xml').exists()
    assert (share / 'config/tripod.yaml').exists()
    messages = Path(get_package_share_directory('ros2_ident_msgs'))
    assert (messages / 'action/Identify.action').exists()


def test_colcon_finds_both_packages_in_a_workspace(tmp_path: Path) -> None:
    if shutil.which('colcon') is None:
        pytest.skip('colcon is not installed; `make test` brings it')
    (tmp_path / 'src').mkdir()
    (tmp_path / 'src/ros2_ident').symlink_to(ROOT)
    (tmp_path / 'src/ros2_ident_msgs').symlink_to('ros2_ident/msg_defs')
    words = ['colcon', '--log-base', str(tmp_path / 'log'), 'list', '--names-only']
    found = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert sorted(found.stdout.split()) == ['ros2_ident', 'ros2_ident_msgs']
