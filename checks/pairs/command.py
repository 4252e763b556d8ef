# SPDX-License-Identifier: Apache-2.0
"""Draw pairs of logs and seal their labels; compare them; score.

    python -m checks.pairs draw build/pairs --count 12 --seed 1
    python -m checks.pairs run build/pairs

`draw` writes `seals.json`: hashes of the labels, which are opened after all pairs are compared.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
import json
from pathlib import Path
import time
from typing import Any

from checks.blind.seal import close, unseal
from checks.pairs.draw import draw_reference, draw_tripod
from ros2_ident import jobs
from ros2_ident.arrays import plain
from ros2_ident.change.result import Comparison
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_text
from ros2_ident.models import load_machine
from ros2_ident.report.schema import read


def _arm(folder: Path, case: int, seed: int) -> dict[str, Any]:
    # MuJoCo need not be there for the others.
    from checks.pairs.arms import draw_arm

    return draw_arm(folder, case, seed)


# What draws a pair into a folder and returns its label, by the machine.
MACHINES: dict[str, Callable[[Path, int, int], dict[str, Any]]] = {
    'emps': partial(draw_reference, machine='emps'),
    'tripod': partial(draw_reference, machine='tripod'),
    'mujoco': draw_tripod,
    'arm': _arm,
}


def _drawn(place: Path, machine: str, case: int, count: int, seed: int) -> dict[str, Any]:
    """Return the label of the pair drawn: where a simulation lost the machine, of another one."""
    while True:
        try:
            return MACHINES[machine](place, case, seed)
        except IdentError as error:
            if error.code is not ErrorCode.DIVERGED:
                raise
            case += count


def draw(folder: Path, machines: Sequence[str], count: int, seed: int) -> None:
    """Draw pairs of machines in turns into a folder, and seal their labels."""
    seals = {}
    for case in range(count):
        place = folder / f'{case:02d}'
        place.mkdir(parents=True, exist_ok=True)
        label = _drawn(place, machines[case % len(machines)], case, count, seed)
        seals[f'{case:02d}'] = close(plain(label), seed)
        print(case, 'drawn', flush=True)
    hashes = {name: seal['sha256'] for name, seal in seals.items()}
    write_text(folder / 'boxes.json', json.dumps(seals, indent=1) + '\n')
    write_text(
        folder / 'seals.json', json.dumps({'seed': seed, 'sha256': hashes}, indent=1) + '\n'
    )


def run(folder: Path) -> None:
    """Compare every pair, then open the labels and score."""
    for place in sorted(x for x in folder.iterdir() if x.is_dir()):
        if (place / 'found.json').exists():
            continue
        begun = time.monotonic()
        request = jobs.Request(load_machine(place / 'machine.yaml'), bags=(str(place / 'before'),))
        try:
            found = plain(vars(jobs.compare(request, [str(place / 'after')]).result))
            text = json.dumps(found, default=lambda x: plain(vars(x)))
        except IdentError as error:
            text = json.dumps({'error': error.message})
        write_text(place / 'found.json', text + '\n')
        print(place.name, f'{time.monotonic() - begun:.0f} s', flush=True)
    for line in scored(folder):
        print(line)


def scored(folder: Path) -> Iterator[str]:
    """Yield a line for each pair, and the counts; names that are not believed do not count."""
    seals = json.loads((folder / 'boxes.json').read_text(encoding='utf-8'))
    seed = json.loads((folder / 'seals.json').read_text(encoding='utf-8'))['seed']
    right = {'none': [0, 0], 'exact': [0, 0], 'drive': [0, 0], 'inside': [0, 0]}
    for case, seal in seals.items():
        label = unseal(seal, seed)
        found = json.loads((folder / case / 'found.json').read_text(encoding='utf-8'))
        believed = 'error' not in found and read(Comparison, found).believed
        changes = found['changes'] if believed else []
        said = [(c['suspect'], list(c['ties'])) for c in changes]
        names = [s['name'] for s, _ in said]
        if label['kind'] == 'none':
            right['none'][1] += 1
            right['none'][0] += not names
        else:
            first = {(x['name'], x['where']) for s, ties in said[:1] for x in (s, *ties)}
            # A number of the machine file and the effect that it is wrong are one.
            stated = {n for n, w in first if not w}
            exact = (label['name'], label['where']) in first
            exact = exact or label['name'].removesuffix('_error') in stated
            right['exact'][1] += 1
            right['exact'][0] += exact
            right['drive'][1] += 1
            place = label['where'] or label['name'].rpartition('.')[0]
            right['drive'][0] += any(place in (w, n.rpartition('.')[0]) for n, w in first)
            sized = label.get('sized', label['name'])
            sizes = [x for c in changes[:1] for x in c['sizes'] if x['name'] == sized]
            if sizes:
                right['inside'][1] += 1
                right['inside'][0] += sizes[0]['low'] <= label['change'] <= sizes[0]['high']
        sizes = [[f'{x["name"]} {x["value"]:.4g} [{x["low"]:.4g}, {x["high"]:.4g}]'
                  for x in c['sizes']] for c in changes]  # fmt: skip
        yield f'{case} {label} -> {names} {sizes} ties {[[t["name"] for t in x] for _, x in said]}'
    yield str({k: f'{a} of {b}' for k, (a, b) in right.items()})


def main() -> None:
    """Draw or run."""
    parser = argparse.ArgumentParser(
        prog='python -m checks.pairs',
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('what', choices=['draw', 'run'])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--count', type=int, default=12)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--machines', nargs='+', choices=MACHINES, default=['emps', 'tripod'],
        help='that take turns; mujoco, a tripod, and arm are by MuJoCo (build/peers)',
    )  # fmt: skip
    args = parser.parse_args()
    if args.what == 'draw':
        draw(args.folder, args.machines, args.count, args.seed)
    else:
        run(args.folder)
