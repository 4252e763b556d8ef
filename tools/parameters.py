#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Bring config/identifier.yaml and docs/parameters.md up to date with the table of parameters."""

from collections.abc import Iterator
from pathlib import Path
import textwrap

from ros2_ident.files import write_text
from ros2_ident.ros.parameters import BY_NAME, literal

ROOT = Path(__file__).resolve().parents[1]
TEMPLATE, PAGE = ROOT / 'config/identifier.yaml', ROOT / 'docs/parameters.md'


def template() -> Iterator[str]:
    """Yield every parameter at its default, with what it does, as YAML."""
    groups: set[str] = set()
    for entry in BY_NAME.values():
        group, _, name = entry.name.rpartition('.')
        indent = '    '
        if group:
            if group not in groups:
                yield f'    {group}:'
                groups.add(group)
            indent += '  '
        text = entry.description + (f' ({entry.range})' if entry.range else '')
        yield from textwrap.wrap(
            text, 99, initial_indent=f'{indent}# ', subsequent_indent=f'{indent}# '
        )
        # rcl cannot tell the type of an empty list
        mark = '# ' if entry.default == () else ''
        yield f'{indent}{mark}{name}: {literal(entry.default)}'


def rows() -> Iterator[str]:
    """Yield the rows of the page's table."""
    for entry in BY_NAME.values():
        text = entry.description + (' Fixed when the node starts.' if entry.read_only else '')
        yield f'| `{entry.name}` | `{literal(entry.default)}` | {entry.range} | {text} |'


def generated() -> dict[Path, str]:
    """Return both files; what stands around the parameters stays."""
    head, mark, _ = TEMPLATE.read_text(encoding='utf-8').partition('  ros__parameters:\n')
    before, rule, rest = PAGE.read_text(encoding='utf-8').partition('| --- | --- | --- | --- |\n')
    after = rest.partition('\n\n')[2]
    return {
        TEMPLATE: '\n'.join([head + mark.rstrip('\n'), *template(), '']),
        PAGE: '\n'.join([before + rule.rstrip('\n'), *rows(), '', after]),
    }


if __name__ == '__main__':
    for path, text in generated().items():
        write_text(path, text, replace=True)
        print(path)
