# SPDX-License-Identifier: Apache-2.0
"""What mkdocs needs besides the files of docs/: pages from elsewhere, the API, and the order.

Links between the pages are relative to the source tree, so that they work there, too.
"""

from pathlib import Path
import re
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
# Pages that lie outside docs/, and their names on the site.
OUTSIDE = {
    'README.md': 'readme.md',
    'CONTRIBUTING.md': 'contributing.md',
    'QUALITY_DECLARATION.md': 'quality.md',
    'SECURITY.md': 'security.md',
    'bags/README.md': 'bags.md',
}
LINK = re.compile(r'\[([^\]]*)\]\(([^)#\s:]+)(#[^)\s]*)?\)')


def on_config(config: Any) -> Any:
    """Take the order of the pages from docs/index.md: its headings, and below each its links."""
    nav: list[Any] = [{'Start': 'index.md'}]
    index = (ROOT / 'docs/index.md').read_text(encoding='utf-8')
    for part in re.split(r'^## ', index, flags=re.MULTILINE)[1:]:
        title, _, text = part.partition('\n')
        pages: list[Any] = [page_of(ROOT / 'docs', link) for _, link, _ in LINK.findall(text)]
        if title == 'Reference':
            pages.append({'Python': list(api_pages())})
        nav.append({title: pages})
    config.nav = nav
    return config


def api_pages() -> dict[str, str]:
    """Return the pages on the Python interface, one for each folder of the package."""
    pages = {}
    for folder in sorted(path.parent for path in (ROOT / 'ros2_ident').rglob('__init__.py')):
        name = '.'.join(folder.relative_to(ROOT).parts)
        modules = sorted(path.stem for path in folder.glob('[a-z]*.py'))
        only_its_text = '    options: {members: false, show_root_heading: false}'
        parts = [f'# {name}', f'::: {name}\n{only_its_text}']
        parts += [f'::: {name}.{module}' for module in modules]
        pages[f'api/{name}.md'] = '\n\n'.join(parts) + '\n'
    return pages


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in docs/."""
    for source, name in OUTSIDE.items():
        text = (ROOT / source).read_text(encoding='utf-8')
        files.append(File.generated(config, name, content=text))
    for name, text in api_pages().items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(text: str, page: Any, **_: Any) -> str:
    """Turn links between files of the source tree into links between pages."""
    source = {name: path for path, name in OUTSIDE.items()}.get(page.file.src_uri)
    folder = (ROOT / source).parent if source else (ROOT / 'docs' / page.file.src_uri).parent

    def link(match: re.Match[str]) -> str:
        words, target, anchor = match.groups()
        page = page_of(folder, target)
        if not page and (folder / target).is_file() and not target.endswith('.png'):
            return words  # a file of the source tree that is no page
        if page and words.endswith('.md'):
            words = title_of((folder / target).resolve())
        return f'[{words}]({page or target}{anchor or ""})'

    return LINK.sub(link, text)


def title_of(path: Path) -> str:
    """Return a page's first heading."""
    return path.read_text(encoding='utf-8').partition('# ')[2].partition('\n')[0]


def page_of(folder: Path, link: str) -> str:
    """Return the page that a link means; empty where it leads to a file that is no page."""
    path = (folder / link).resolve()
    if not path.is_relative_to(ROOT):
        return ''
    name = path.relative_to(ROOT).as_posix()
    if name.startswith('docs/'):
        return name.removeprefix('docs/')
    return OUTSIDE.get(name, '')
