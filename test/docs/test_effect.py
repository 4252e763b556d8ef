# SPDX-License-Identifier: Apache-2.0
"""The example of docs/adding_an_effect.md works as it stands on the page."""

import importlib.util
import inspect
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from types import ModuleType

import pytest

from ros2_ident.effects import CATALOGUE, Effect, Hook

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / 'docs/adding_an_effect.md').read_text(encoding='utf-8')
BLOCK = re.compile(r'^```python\n(.*?)^```$', re.MULTILINE | re.DOTALL)
NAME = 'ros2_ident.effects.rubber_buffer'


def simulate_the_buffer() -> None:
    """Run in a process of its own; see test_one_file_is_enough_for_a_simulation."""
    import numpy as np

    from ros2_ident.models import EffectAt, load_machine, make_model
    from ros2_ident.recording import Dataset

    machine = load_machine('config/emps.yaml')
    time = np.arange(400) * 1e-3
    position = 0.1 * (1.0 - np.cos(2.0 * np.pi * time))[None]
    velocity = 0.2 * np.pi * np.sin(2.0 * np.pi * time)[None]
    still = np.zeros_like(position)
    data = Dataset(('emps_axis',), 1e-3, 0, position, velocity, None, None, still)
    model = make_model(machine, data, effects=[EffectAt('rubber_buffer', 'emps_axis')])
    theta = [95.0, 200.0, 20.0, 0.0]
    plain = make_model(machine, data).simulate(np.array([theta]))[0, 0]
    off, on = model.simulate(np.array([[*theta, 0.0, 0.1], [*theta, 1e4, 0.1]]))[:, 0]
    np.testing.assert_array_equal(off, plain)
    outside = np.flatnonzero(position[0] < 0.099)
    np.testing.assert_allclose(on[outside], plain[outside], rtol=1e-9, atol=1e-9)
    # at the turning point, 0.08 m into the buffer: 1e4 N/m^2 times 0.08^2 m^2
    assert 40.0 < np.max(on - plain) < 90.0, np.max(on - plain)
    print([p.name for p in model.parameters][4:])


@pytest.fixture
def blocks() -> list[str]:
    return BLOCK.findall(PAGE)


@pytest.fixture
def example(blocks: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The page's effect, imported as if it lay among the others."""
    return _imported(NAME, blocks[0], tmp_path, monkeypatch)


def _imported(name: str, source: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    path = folder / f'{name.rpartition(".")[2]}.py'
    path.write_text(source, encoding='utf-8')
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


def test_the_page_names_every_hook() -> None:
    assert re.findall(r'^\| `([A-Z_]+)` \|', PAGE, re.MULTILINE) == [hook.name for hook in Hook]


def test_the_example_is_an_effect_that_the_catalogue_lacks(example: ModuleType) -> None:
    effect = example.EFFECT
    assert isinstance(effect, Effect)
    assert effect.id == 'rubber_buffer'
    assert effect.id not in CATALOGUE
    assert set(effect.confusable) <= set(CATALOGUE)
    for parameter in effect.parameters:
        assert parameter.low <= parameter.neutral <= parameter.high


def test_the_example_passes_its_own_test(
    example: ModuleType, blocks: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = _imported('test_effect_rubber_buffer', blocks[1], tmp_path, monkeypatch)
    module.test_the_buffer_pushes_back_behind_its_place_only()


def test_one_file_is_enough_for_a_simulation(blocks: list[str], tmp_path: Path) -> None:
    """In a copy of the package; there the kernels are compiled anew."""
    without = shutil.ignore_patterns('__pycache__')
    shutil.copytree(ROOT / 'ros2_ident', tmp_path / 'ros2_ident', ignore=without)
    shutil.copytree(ROOT / 'config', tmp_path / 'config')
    (tmp_path / 'ros2_ident/effects/rubber_buffer.py').write_text(blocks[0], encoding='utf-8')
    script = f'{inspect.getsource(simulate_the_buffer)}\nsimulate_the_buffer()'
    ran = subprocess.run(
        [sys.executable, '-c', script],
        cwd=tmp_path,
        env={
            **os.environ,
            'PYTHONPATH': str(tmp_path),
            'NUMBA_CACHE_DIR': str(tmp_path / 'numba'),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    names = 'emps_axis.rubber_buffer.stiffness', 'emps_axis.rubber_buffer.place'
    assert ran.stdout == f'{list(names)}\n'
