# SPDX-License-Identifier: Apache-2.0
"""The example of docs/extend.md works as it stands on the page."""

import importlib.util
from pathlib import Path
import re
import sys
from types import ModuleType

import pytest

from ros2_ident.effects import CATALOGUE, Effect, Hook

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / 'docs/extend.md').read_text(encoding='utf-8')
BLOCK = re.compile(r'^```python\n(.*?)^```$', re.MULTILINE | re.DOTALL)
NAME = 'ros2_ident.effects.rubber_buffer'


@pytest.fixture
def blocks() -> list[str]:
    return BLOCK.findall(PAGE)


@pytest.fixture
def example(blocks: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The page's effect, imported as if it lay among the others."""
    return _imported(NAME, blocks[2], tmp_path, monkeypatch)


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
    module = _imported('test_effect_rubber_buffer', blocks[3], tmp_path, monkeypatch)
    module.test_the_buffer_pushes_back_behind_its_place_only()
