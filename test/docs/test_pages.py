# SPDX-License-Identifier: Apache-2.0
"""Links of the pages lead somewhere, and the pages name what there is."""

from pathlib import Path
import re

import effects_page
import pytest
import reference_pages

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob('*.md'), *ROOT.glob('docs/*.md'), ROOT / 'bags/README.md'])
LINK = re.compile(r'\]\(([^)#\s]*)(?:#([^)\s]*))?\)')


def anchors(page: Path) -> set[str]:
    """What links into a page may name: its headings, lower case, without punctuation."""
    headings = re.findall(r'^#+ (.*)$', page.read_text(encoding='utf-8'), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target, anchor in LINK.findall(page.read_text(encoding='utf-8')):
        if '://' in target:
            continue
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), f'{page.name}: {target} is not there'
        if anchor:
            assert anchor in anchors(path), f'{page.name}: {target} has no heading {anchor}'


def test_the_index_lists_every_page() -> None:
    text = (ROOT / 'docs/index.md').read_text(encoding='utf-8')
    for page in ROOT.glob('docs/*.md'):
        assert page.name == 'index.md' or f'({page.name})' in text, (
            f'docs/index.md has no line on {page.name}; add one'
        )


def test_the_architecture_names_every_folder_and_module() -> None:
    text = (ROOT / 'docs/architecture.md').read_text(encoding='utf-8')
    for path in (ROOT / 'ros2_ident').iterdir():
        if path.is_dir() and (path / '__init__.py').exists():
            assert f'| `{path.name}/` |' in text, (
                f'docs/architecture.md has no row on {path.name}/'
            )
        elif path.suffix == '.py' and path.name != '__init__.py':
            assert f'| `{path.name}` |' in text, f'docs/architecture.md has no row on {path.name}'


@pytest.mark.parametrize('tool', [effects_page, reference_pages], ids=lambda tool: tool.__name__)
def test_pages_are_made_from_the_code(tool) -> None:
    for path, text in tool.generated(ROOT).items():
        assert path.read_text(encoding='utf-8') == text, (
            f'{path.name} is out of date; run python tools/{tool.__name__}.py'
        )
