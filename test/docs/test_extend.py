# SPDX-License-Identifier: Apache-2.0
"""The Python of docs/extend.md and docs/results.md works as it stands."""

import importlib.util
from pathlib import Path
import re
import sys
from types import ModuleType

import numpy as np
import pytest

from ros2_ident.effects import Hook
from ros2_ident.recording import Stream, write_bag

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / 'docs/extend.md').read_text(encoding='utf-8')
BLOCKS = re.findall(r'^```python\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)
MODEL, USE, EFFECT, CHECK = BLOCKS[:4]
TRUTH = {'inertia': 0.2, 'weight': 3.0, 'damping': 0.1}


def write_swing(path: Path, seed: int) -> None:
    time = np.arange(4000) * 0.002
    draw = np.random.default_rng(seed)
    waves = [(a, 6.0 * np.pi * f) for a, f in zip(*draw.random((2, 4)), strict=True)]
    angle = sum(a * np.sin(w * time) for a, w in waves)
    rate = sum(a * w * np.cos(w * time) for a, w in waves)
    bend = sum(-a * w * w * np.sin(w * time) for a, w in waves)
    torque = TRUTH['inertia'] * bend + TRUTH['weight'] * np.sin(angle) + TRUTH['damping'] * rate
    torque += 0.02 * draw.standard_normal(time.size)
    stamp = np.round(1e18 + time * 1e9).astype(np.int64)
    stream = Stream(('shaft',), stamp, position=angle[:, None], effort=torque[:, None])
    write_bag(path, {'/joint_states': stream})


@pytest.fixture
def swings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for number in (1, 2):
        write_swing(tmp_path / f'swing_{number}', number)
    (tmp_path / 'my_pendulum.py').write_text(MODEL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'my_pendulum', raising=False)
    return tmp_path


def test_the_example_finds_the_parameters(
    swings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space: dict[str, object] = {}
    exec(MODEL + USE, space)  # noqa: S102
    result = space['result']
    for estimate in result.parameters:  # type: ignore[attr-defined]
        assert estimate.low <= TRUTH[estimate.name] <= estimate.high
    assert 'is missing: the residual is noise' in capsys.readouterr().out


def test_a_bundled_machine_is_identified_and_diagnosed_in_python(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / 'docs/results.md').read_text(encoding='utf-8')
    (block,) = re.findall(r'^```python\n(.*?)^```$', page, re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(block, {})  # noqa: S102
    lines = capsys.readouterr().out.splitlines()
    assert (
        lines[0].startswith('emps_axis.moving_mass 95.1')
        and 'is missing: the residual is noise' in lines[-1]
    )


def test_the_page_names_every_hook() -> None:
    assert re.findall(r'^\| `([A-Z_]+)` \|', PAGE, re.MULTILINE) == [hook.name for hook in Hook]


def _imported(name: str, source: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    path = folder / f'{name.rpartition(".")[2]}.py'
    path.write_text(source, encoding='utf-8')
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


def test_the_effect_passes_its_own_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _imported('ros2_ident.effects.rubber_buffer', EFFECT, tmp_path, monkeypatch)
    module = _imported('test_effect_rubber_buffer', CHECK, tmp_path, monkeypatch)
    module.test_the_buffer_pushes_back_behind_its_place_only()
