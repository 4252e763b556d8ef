# SPDX-License-Identifier: Apache-2.0
"""What one room knows alone is named in no other."""

import ast
from collections.abc import Iterator
from pathlib import Path

from ros2_ident.effects import CATALOGUE
from ros2_ident.kernel import rows
from ros2_ident.models.registry import KINDS

PACKAGE = Path(__file__).parents[1] / 'ros2_ident'
WITHOUT_IDS = ('gap', 'models', 'kernel', 'identify', 'report', 'cli', 'ros', 'search')


def words(rooms: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield every whole string of some rooms, with where it stands."""
    for room in rooms:
        for path in sorted((PACKAGE / room).rglob('*.py')):
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield node.value, f'{path.relative_to(PACKAGE)}:{node.lineno}'


def test_no_effect_is_named_outside_its_file() -> None:
    # A key of a machine file may be called like the effect of the same physics.
    named = [
        f'{place} {word}'
        for word, place in words(WITHOUT_IDS)
        if word in CATALOGUE and not place.startswith('models/drives/keys.py')
    ]
    assert not named, named


def test_a_row_of_the_kernel_is_not_named_like_an_effect() -> None:
    assert not {*rows.MACHINE_ROWS, *rows.DRIVE_ROWS} & set(CATALOGUE)


def test_no_kind_of_machine_is_named_outside_its_folder_and_the_list_of_kinds() -> None:
    rooms = tuple(path.name for path in PACKAGE.iterdir() if (path / '__init__.py').is_file())
    kinds = set(KINDS)
    own = {'models/kinds.py'} | {f'models/{kind}/' for kind in kinds}
    named = [
        f'{place} {word}'
        for word, place in words(rooms)
        if word in kinds and not place.startswith(tuple(own))
    ]
    assert not named, named
