# SPDX-License-Identifier: Apache-2.0
"""Draw pairs of logs and seal their labels; compare them; score.

    python -m checks.pairs draw build/pairs --count 12 --seed 1
    python -m checks.pairs run build/pairs

`draw` writes `seals.json`: hashes of the labels, which are opened after all pairs are compared.
"""

import argparse
from collections.abc import Iterator
import json
from pathlib import Path
import time
from typing import Any

import numpy as np

from checks.blind.draw import Drawer
from checks.blind.forms.form import Hidden
from checks.blind.machines import file_text, read_plain
from checks.blind.planning import Wanted
from checks.blind.probe import Probe
from checks.blind.rough import record
from checks.blind.seal import close, unseal
from ros2_ident import jobs
from ros2_ident.arrays import plain
from ros2_ident.change.result import Comparison
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import IdentError
from ros2_ident.files import write_text
from ros2_ident.models import load_machine
from ros2_ident.recording import write_bag
from ros2_ident.report.schema import read

ROOT = Path(__file__).parents[2]
MACHINES = ('emps', 'tripod')
# Sizes of the changes, RMS of what they do to the effort in units of its noise.
SIZES = (1.5, 6.0)
# Share of the pairs in which nothing changed, and of those with another motion after.
UNCHANGED, MOVED = 0.4, 0.5
# Share of the changes that are effects.
EFFECTS = 0.5


class Pair(Drawer):
    """Draws a machine with its imperfections, and what changes on it."""

    def changed(self) -> tuple[dict[str, Any], list[Hidden], list[Hidden], Probe]:
        """Return label, effects before and after, and the machine after."""
        rng = self.rng
        kind = 'none' if rng.random() < UNCHANGED else 'parameter'
        kind = 'effect' if kind != 'none' and rng.random() < EFFECTS else kind
        size = float(np.exp(rng.uniform(*np.log(SIZES))))
        which = int(rng.random() < MOVED)
        label: dict[str, Any] = {'kind': kind, 'size': size, 'motion': which}
        after, new = self.probe, list[Hidden]()
        if kind == 'effect':
            names = [n for n in self.forms() if n in CATALOGUE]
            name = str(rng.choice(names))
            hidden, left = self._sized(name, size)
            new = [hidden]
            label |= {'name': hidden.effect, 'where': hidden.where, 'size': left,
                      'values': dict(hidden.values)}  # fmt: skip
        small = self._imperfections(new)
        if kind == 'parameter':
            after = self._other(label, size, which, small)
        return label, small, [*small, *new], after

    def _other(self, label: dict[str, Any], size: float, which: int, small: list[Hidden]) -> Probe:
        """Return the machine of which one parameter is another number."""
        names = [p.name for p in self.probe.model(0).parameters if p.unit != 's']
        name = str(self.rng.choice(names))
        base = self._values()
        step = float(self.rng.choice([-1.0, 1.0])) * 0.05 * abs(base[name])
        for _ in range(3):
            after = Probe(
                self.machine, base | {name: base[name] + step}, self.probe.motions,
                self.rough.sigma,
            )  # fmt: skip
            effort = after.effort(which, small) - self.probe.effort(which, small)
            rms = float(np.sqrt(np.mean(effort**2, axis=1)).max() / self.rough.sigma)
            if abs(rms / size - 1.0) < 0.1:
                break
            step = max(-0.9 * abs(base[name]), step * size / max(rms, 1e-9))
        label |= {'name': name, 'where': '', 'size': rms, 'value': base[name], 'change': step}
        return after

    def _values(self) -> dict[str, float]:
        """Return the true parameters, each by its full name."""
        names = (p.name for p in self.probe.model(0).parameters)
        return dict(zip(names, self.probe.theta.tolist(), strict=True))


def draw(folder: Path, count: int, seed: int) -> None:
    """Draw pairs into a folder, and seal their labels."""
    seals = {}
    for case in range(count):
        text = read_plain(ROOT / f'config/{MACHINES[case % len(MACHINES)]}.yaml')
        drawn = Pair(text, seed, Wanted(case, 'single', (), (), case % 5 == 4))
        label, before, after, probe = drawn.changed()
        place = folder / f'{case:02d}'
        place.mkdir(parents=True, exist_ok=True)
        which = label['motion']
        for name, of, effects, motion in (
            ('before', drawn.probe, before, 0), ('after', probe, after, which),
        ):  # fmt: skip
            log = of.log(motion, effects)
            streams, _, _ = record(log, of.motions[motion], drawn.rough, drawn.rng)
            write_bag(place / name, streams)
        stated = dict(drawn.plain)
        if drawn.rough.stated:
            stated['effort_noise'] = float(f'{drawn.rough.sigma * drawn.rough.stated:.3g}')
        write_text(place / 'machine.yaml', file_text(stated))
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
            exact = (label['name'], label['where']) in first
            right['exact'][1] += 1
            right['exact'][0] += exact
            right['drive'][1] += 1
            place = label['where'] or label['name'].rpartition('.')[0]
            right['drive'][0] += any(place in (w, n.rpartition('.')[0]) for n, w in first)
            sizes = [x for c in changes[:1] for x in c['sizes'] if x['name'] == label['name']]
            if sizes:
                right['inside'][1] += 1
                right['inside'][0] += sizes[0]['low'] <= label['change'] <= sizes[0]['high']
        sizes = [[f'{x["name"]} {x["value"]:.4g} [{x["low"]:.4g}, {x["high"]:.4g}]'
                  for x in c['sizes']] for c in changes]  # fmt: skip
        yield f'{case} {label} -> {names} {sizes} ties {[[t["name"] for t in x] for _, x in said]}'
    yield str({k: f'{a} of {b}' for k, (a, b) in right.items()})


def main() -> None:
    """Draw or run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('what', choices=['draw', 'run'])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--count', type=int, default=12)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    if args.what == 'draw':
        draw(args.folder, args.count, args.seed)
    else:
        run(args.folder)


if __name__ == '__main__':
    main()
