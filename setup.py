# SPDX-License-Identifier: Apache-2.0
"""Build description: ros2_ident for colcon, or ros2-ident, the wheel without ROS.

tools/wheel_backend.py asks for the wheel; colcon and debhelper run this file themselves.
"""

import os
from pathlib import Path
from typing import Any

from setuptools import find_packages, setup

NAME = 'ros2_ident'
SHARED = ('config', 'launch', 'bags')
# The oldest of each that the tests of the wheel run with are those of Ubuntu 24.04.
CORE = [
    'argcomplete',
    'llvmlite>=0.42',
    'lz4',
    'mcap>=1',
    'numba>=0.59',
    'numpy>=1.26',
    'PyYAML',
    'rich',
    'rosbags>=0.10',
    'scipy>=1.11',
    'zstandard',
]
PAGE = ['bokeh>=3.5', 'Jinja2', 'MarkupSafe', 'matplotlib']
EXTRAS = {
    'arms': ['pin'],
    'dask': ['distributed'],
    'lerobot': ['pyarrow'],
    'mujoco': ['mujoco>=3.3'],
    'protobuf': ['protobuf'],
    'tables': ['h5py', 'pyarrow'],
    'usd': ['mujoco-usd-converter', 'urdf-usd-converter'],
}
# What `ident example` copies: folders of this tree as packages without code, in the wheel only.
EXAMPLES = {
    f'{NAME}.examples.config': ('config', ['*.yaml', '*.urdf']),
    f'{NAME}.examples.bags.axis_reversals': ('bags/axis_reversals', ['*']),
}


def shared_files() -> list[tuple[str, list[str]]]:
    """List the files below the shared folders, each with its folder under share/ros2_ident."""
    folders: dict[str, list[str]] = {}
    for top in SHARED:
        for path in sorted(Path(top).rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                folders.setdefault(f'share/{NAME}/{path.parent.as_posix()}', []).append(str(path))
    return sorted(folders.items())


def parts() -> dict[str, Any]:
    """Return what the wheel and colcon's package differ in."""
    found = find_packages(include=[NAME, f'{NAME}.*'])
    files = {
        'report.page': ['*.css', '*.html', '*.js'],
        'cli': ['*.yaml'],
        'machine': ['*.yaml'],
        'recording': ['maps/*.yaml'],
        'export': ['texts/*.txt'],
    }
    data = {f'{NAME}.{room}': names for room, names in files.items()}
    main = f'{NAME}.cli.main:main'
    if os.environ.get('ROS2_IDENT_WHEEL'):
        extras = {**EXTRAS, 'page': PAGE}
        return {
            'name': 'ros2-ident',
            'packages': [name for name in found if not name.startswith(f'{NAME}.ros')]
            + list(EXAMPLES),
            'package_dir': {name: folder for name, (folder, _) in EXAMPLES.items()},
            'package_data': data | {name: files for name, (_, files) in EXAMPLES.items()},
            'install_requires': CORE,
            'extras_require': {**extras, 'all': sum(extras.values(), [])},
            'entry_points': {'console_scripts': [f'ident = {main}', f'ros2-ident = {main}']},
        }
    return {
        'name': NAME,
        'packages': found,
        'package_data': data | {f'{NAME}.ros': ['*.yaml']},
        'data_files': [
            ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
            (f'share/{NAME}', ['package.xml']),
            *shared_files(),
        ],
        'install_requires': CORE + PAGE,
        'extras_require': {
            **EXTRAS,
            'test': [
                'distributed',
                'h5py',
                'hypothesis',
                'import-linter',
                'pin',
                'protobuf',
                'pyarrow',
                'pytest',
                'pytest-timeout',
                'pytest-xdist',
                'selenium',
            ],
        },
        'entry_points': {
            'console_scripts': [
                f'ident = {main}',
                f'identifier = {NAME}.ros.identifier:main',
                f'replay = {NAME}.ros.replay:main',
            ],
        },
    }


setup(
    version='0.1.0',
    description='Identifies drive parameters from recorded drive data and finds what the '
    'simulation is still missing.',
    maintainer='ros2_ident developers',
    maintainer_email='maintainers@ros2-ident.invalid',
    license='Apache-2.0',
    python_requires='>=3.11',
    zip_safe=False,
    **parts(),
)
