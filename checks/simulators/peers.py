# SPDX-License-Identifier: Apache-2.0
"""Simulators, each with the packages that bring it, in environments of their own."""

from dataclasses import dataclass
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from ros2_ident.errors import ErrorCode

# Seconds that an installation, and the run of a simulator, may take.
_INSTALL, _RUN = 3600, 1800
# Folder of descriptions in the package `example-robot-data`.
_ROBOTS = 'lib/python*/site-packages/cmeel.prefix/share/example-robot-data/robots'


@dataclass(frozen=True)
class Peer:
    """A simulator.

    Attributes:
        title: On the page.
        packages: From PyPI.
        target: Of `ident export --to`.
        alone: Packages of which nothing but their own files is installed, whatever they ask for.
    """

    title: str
    packages: tuple[str, ...]
    target: str
    alone: tuple[str, ...] = ()


PEERS = {
    'mujoco': Peer('MuJoCo', ('mujoco',), 'mjcf'),
    'warp': Peer('MuJoCo Warp', ('mujoco-warp',), 'mjcf'),
    'pinocchio': Peer('pinocchio', ('pin',), 'pinocchio'),
    'drake': Peer('Drake', ('drake',), 'drake'),
    'pybullet': Peer('PyBullet', ('pybullet', 'numpy'), 'pybullet'),
    'dart': Peer("DART, Gazebo's engine", ('dartpy', 'numpy'), 'gazebo'),
    'sapien': Peer('SAPIEN', ('sapien',), 'sapien'),
    'genesis': Peer('Genesis', ('genesis-world', 'torch'), 'genesis'),
    'newton': Peer('Newton', ('newton[sim]',), 'newton'),
    'usd': Peer('Newton, of USD', ('newton[sim,importers]',), 'usd'),
    # With all that it asks for, of Python 3.12, it is tens of GB; its configuration needs these.
    'isaac': Peer(
        'Isaac Lab',
        ('lazy_loader', 'numpy', 'pyyaml', 'torch', 'warp-lang'),
        'isaac',
        ('isaaclab',),
    ),
}


def robots(folder: Path, python: str) -> Path:
    """Return the folder of `example-robot-data`'s descriptions, which is installed for that."""
    _environment(folder, python, ('example-robot-data',))
    return next(folder.glob(_ROBOTS))


def asked(name: str, folder: Path, python: str, device: str, request: Any) -> dict[str, Any]:
    """Return what a simulator answers to a request, see `runs/common.py`.

    Args:
        name: Of `PEERS`.
        folder: Its environment, made where it is not there.
        python: What makes it.
        device: Where it runs, if it can: `cpu`, `cuda:0`.
        request: The cases.

    Raises:
        IdentError: NO_DATA where it does not install, or ends.
    """
    own = _environment(folder, python, PEERS[name].packages, PEERS[name].alone)
    script, out = Path(__file__).parent / f'runs/in_{name}.py', folder / 'answer.json'
    out.unlink(missing_ok=True)
    with (folder / 'run.log').open('w') as log:
        subprocess.run(
            [str(own), str(script), str(out), device], input=json.dumps(request), text=True,
            stdout=log, stderr=log, timeout=_RUN, check=False, env=_alone(),
        )  # fmt: skip
    if not out.is_file():
        raise ErrorCode.NO_DATA.error(f'{name} gives no answer; see {folder / "run.log"}')
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def _alone() -> dict[str, str]:
    """Return the environment variables without the folders of our own packages."""
    return {name: value for name, value in os.environ.items() if name != 'PYTHONPATH'}


def _environment(
    folder: Path, python: str, packages: tuple[str, ...], alone: tuple[str, ...] = ()
) -> Path:
    """Return the interpreter of an environment with the newest of some packages."""
    own, done = folder / 'bin/python', folder / 'installed'
    if not done.is_file():
        subprocess.run([python, '-m', 'venv', '--clear', str(folder)], check=True, env=_alone())
        pip = [str(own), '-m', 'pip', 'install', '--quiet', '--upgrade']
        bare = [('--no-deps', '--ignore-requires-python', *alone)] if alone else []
        for words in (packages, *bare):
            found = subprocess.run(
                [*pip, *words], capture_output=True, text=True, timeout=_INSTALL, check=False,
                env=_alone(),
            )  # fmt: skip
            if found.returncode:
                last = found.stderr.strip().splitlines()[-1]
                raise ErrorCode.NO_DATA.error(f'{words[-1]} does not install ({last})')
        done.write_text(sys.version)
    return own
