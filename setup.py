# SPDX-License-Identifier: Apache-2.0
"""Build description of ros2_ident, an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = 'ros2_ident'
SHARED = ('config', 'launch', 'bags')


def shared_files() -> list[tuple[str, list[str]]]:
    """List the files below the shared folders, each with its folder under share/ros2_ident."""
    folders: dict[str, list[str]] = {}
    for top in SHARED:
        for path in sorted(Path(top).rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                folders.setdefault(f'share/{NAME}/{path.parent.as_posix()}', []).append(str(path))
    return sorted(folders.items())


setup(
    name=NAME,
    version='0.1.0',
    description='Identifies drive parameters from recorded drive data and finds what the '
    'simulation is still missing.',
    maintainer='ros2_ident developers',
    maintainer_email='maintainers@ros2-ident.invalid',
    license='Apache-2.0',
    python_requires='>=3.11',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={f'{NAME}.report.page': ['*.css', '*.html', '*.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared_files(),
    ],
    install_requires=[
        'argcomplete',
        'bokeh',
        'Jinja2',
        'llvmlite',
        'lz4',
        'MarkupSafe',
        'matplotlib',
        'mcap',
        'numba',
        'numpy',
        'PyYAML',
        'rich',
        'rosbags',
        'scipy',
        'zstandard',
    ],
    extras_require={
        'arms': ['pin'],
        'cluster': ['distributed'],
        'mujoco': ['mujoco>=3.3'],
        'test': [
            'distributed',
            'hypothesis',
            'import-linter',
            'pin',
            'pytest',
            'pytest-timeout',
            'pytest-xdist',
            'selenium',
        ],
    },
    zip_safe=False,
    entry_points={
        'console_scripts': [
            f'ident = {NAME}.cli.main:main',
            f'identifier = {NAME}.ros.identifier:main',
            f'replay = {NAME}.ros.replay:main',
        ],
    },
)
