# SPDX-License-Identifier: Apache-2.0
"""List what ros2_ident/ defines and only tests, checks and benchmarks use; fail if there is any.

By mypy's typed trees: a method is used where one of its own, a base or a derived class is called,
or one of its name of an object of unknown type.
"""

from collections.abc import Iterator
from pathlib import Path
import re
import sys

from mypy import build, nodes
from mypy.config_parser import parse_config_file
from mypy.find_sources import create_source_list
from mypy.options import Options
from mypy.traverser import NameAndMemberCollector
from mypy.types import get_proper_type, Instance, Type, TypeType, UnionType

ROOT = Path(__file__).parents[1]
# Full names that others use, and who.
OUTSIDE = {
    r'cli\.arguments\.\w+': 'cli/commands.yaml',
    r'cli\.\w+\.run': 'cli.main, which imports a command by its name',
    r'identify\.run\.identify': 'users, as docs/extend.md',
    r'kernel\.drive\._(flags_of|closed_loop)': 'numba.extending.overload',
    r'lanes\._(\w+Type\.\w+|\w+Model|\w*Template.*|neg)': 'numba, which registers it',
    r'machine\.file\._Loader\.compose_node': 'yaml',
    r'recording\.scan\._Chunks\.\w+': 'rosbags',
    r'report\.page\.(answer\.Answer\.closing|steps\.Step\.signs)': "the page's templates",
}


def unused() -> Iterator[tuple[str, int, str]]:
    """Yield file, line and full name of each function, class and method without a use."""
    options = Options()
    parse_config_file(options, lambda: None, str(ROOT / 'pyproject.toml'))
    options.exclude, options.follow_imports = [], 'skip'
    # The native parser leaves out the bodies of kernels.
    options.incremental = options.native_parser = False
    options.export_types = options.preserve_asts = options.check_untyped_defs = True
    found = build.build(create_source_list([str(ROOT / 'ros2_ident')], options), options)
    files = [file for name, file in found.files.items() if name.startswith('ros2_ident')]
    text = '\n'.join(Path(file.path).read_text(encoding='utf-8') for file in files)
    # Named in strings: MODULE:NAME.
    full = {f'{module}.{name}' for module, name in re.findall(r'(ros2_ident[\w.]+):(\w+)', text)}
    bare = set[str]()
    for file in files:
        uses = NameAndMemberCollector()
        file.accept(uses)
        full |= {x.fullname for x in (*uses.name_exprs, *uses.member_exprs)}
        for member in uses.member_exprs:
            owners = list(_owners(found.types.get(member.expr)))
            bare |= set() if owners else {member.name}
            full |= {f'{base.fullname}.{member.name}' for x in owners for base in x.mro}
    for file in files:
        for name, symbol, owner in file.local_definitions():
            node = symbol.node.func if isinstance(symbol.node, nodes.Decorator) else symbol.node
            short = name.rpartition('.')[2]
            if name in full or re.match('__|_(asdict|make|replace)$', short):
                continue
            if isinstance(node, nodes.TypeInfo):
                used = bool(re.search(rf"(: |-> |[\[|] ?)'?{short}\b", text))  # as a type
            elif isinstance(node, nodes.FuncBase) and owner is not None:
                used = short in bare or any(f'{x.fullname}.{short}' in full for x in owner.mro)
            else:
                used = not isinstance(node, nodes.FuncBase)
            if not used and not any(re.fullmatch(rf'ros2_ident\.{x}', name) for x in OUTSIDE):
                yield str(Path(file.path).relative_to(ROOT)), node.line, name


def _owners(found: Type | None) -> Iterator[nodes.TypeInfo]:
    found = get_proper_type(found)
    for item in found.items if isinstance(found, UnionType) else [found]:
        item = item.item if isinstance(item, TypeType) else get_proper_type(item)
        if isinstance(item, Instance):
            yield item.type


if __name__ == '__main__':
    sys.exit('\n'.join(f'{path}:{line}: no use of {name}' for path, line, name in unused()) or 0)
