# SPDX-License-Identifier: Apache-2.0
"""Whether the smallest change that would have shown is right.

    python -m checks.pairs.limits build/limits --machines emps tripod --count 8 --seed 1

Of pairs of which nothing changed, `ident diff` states that change for each suspect. The side after
is recorded anew with `SHARES` of it, and the suspect is named or not: the limit is where it is an
even chance.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from checks.blind.machines import file_text, read_plain
from checks.blind.planning import Wanted
from checks.blind.rough import record
from checks.pairs.draw import Pair, ROOT
from checks.reference.effects import Effect, kind_of
from ros2_ident import jobs
from ros2_ident.change.result import Comparison, Suspect, Visible
from ros2_ident.errors import IdentError
from ros2_ident.files import write_text
from ros2_ident.models import load_machine
from ros2_ident.recording import write_bag

# Of the size stated, and how many kinds of a pair are tried.
SHARES, KINDS = (0.67, 1.0, 1.5), 4
# What may change, as the suspect is called: parameters by their last name, then effects whose size
# is the same quantity here, by its name.
PARAMETERS = (
    'moving_mass', 'tool_mass', 'drive_inertia', 'coulomb_friction', 'coulomb_torque',
    'viscous_friction', 'viscous_torque', 'constant_force', 'velocity_gain',
)  # fmt: skip
EFFECTS = {
    'constant_force': 'force', 'command_delay': 'time', 'effort_bias': 'torque',
    'rod_mass': 'mass',
}  # fmt: skip


class Limited(Pair):
    """Draws a machine of which nothing changes, then the side after with one change."""

    def begin(self, folder: Path) -> None:
        """Write both sides, of which nothing changed, and the machine file."""
        self.folder, self.small = folder, self._imperfections([])
        self.which = int(self.rng.random() < 0.5)
        self._write('before', 0, None, 0.0)
        self._write('after', self.which, None, 0.0)
        stated = dict(self.plain)
        if self.rough.stated:
            stated['effort_noise'] = float(f'{self.rough.sigma * self.rough.stated:.3g}')
        write_text(folder / 'machine.yaml', file_text(stated))

    def again(self, name: str, what: Suspect, step: float) -> None:
        """Write the side after anew, with a change of a size."""
        self._write(name, self.which, what, step)

    def _write(self, name: str, which: int, what: Suspect | None, step: float) -> None:
        probe, effects = self.probe, list[Any](self.small)
        if what is not None and what.kind == 'effect':
            places = (what.where,)
            effects.append(Effect(what.name, places, {EFFECTS[what.name]: step}))
        elif what is not None and what.kind == 'parameter':
            values = self._values()
            values[what.name] += step
            motions = self.probe.motions
            probe = type(self.probe)(self.machine, values, motions, self.rough.sigma)
        streams, _, _ = record(
            probe.log(which, effects), probe.motions[which], self.rough, self.rng
        )
        write_bag(self.folder / name, streams)


def make_reference(folder: Path, case: int, seed: int, machine: str) -> Any:
    """Return what writes a pair of a machine by the slow reference."""
    pair = Limited(read_plain(ROOT / f'config/{machine}.yaml'), seed,
                   Wanted(case, 'single', (), (), False))  # fmt: skip
    pair.begin(folder)
    return pair


def make_arm(folder: Path, case: int, seed: int) -> Any:
    """Return what writes a pair of an arm by MuJoCo."""
    # MuJoCo need not be there for the others.
    from checks.pairs.arms import ArmSides

    return ArmSides(folder, case, seed)


def compared(folder: Path, after: str) -> Comparison:
    """Return the comparison of the side before with one after."""
    request = jobs.Request(load_machine(folder / 'machine.yaml'), bags=(str(folder / 'before'),))
    return jobs.compare(request, [str(folder / after)]).result


def told(found: Comparison, what: Suspect) -> tuple[str, str]:
    """Return whether a suspect is `named`, `tied` to it, `other` or `none`; and what is said."""
    if not found.changes:
        return 'none', ', '.join(x.text for x in found.apart)
    text = f'{"" if found.believed else "not believed: "}' + ' and '.join(
        '/'.join(f'{s.name}{f" of {s.where}" if s.where else ""}' for s in (c.suspect, *c.ties))
        for c in found.changes
    )
    if not found.believed:
        return 'none', text
    first = [(s.name, s.where) for s in (found.changes[0].suspect, *found.changes[0].ties)]
    own = what.name, what.where
    return ('named' if own == first[0] else 'tied' if own in first else 'other'), text


def tried(found: Comparison, rng: np.random.Generator) -> list[Visible]:
    """Return the suspects that are tried, each of another kind."""
    of = dict[str, list[Visible]]()
    for x in found.smallest:
        kind = x.suspect.name.rpartition('.')[2]
        known = PARAMETERS if x.suspect.kind == 'parameter' else EFFECTS
        if kind in known or x.suspect.name == 'hand_load':
            small = math.isnan(x.value) or x.size < 0.6 * abs(x.value)
            if x.suspect.kind != 'constant' and math.isfinite(x.size) and small:
                of.setdefault(kind, []).append(x)
    kinds = rng.permutation(sorted(of))[:KINDS].tolist()
    return [of[kind][int(rng.integers(len(of[kind])))] for kind in kinds]


def signed(what: Suspect) -> bool:
    """Return whether a suspect may be less than before, too."""
    return what.kind == 'parameter' or kind_of(what.name).size.signed


def study(
    folder: Path,
    make: Callable[[Path, int, int], Any],
    case: int,
    seed: int,
    shares: Sequence[float],
) -> None:
    """Try the limits of one pair; a line each goes into `tried.jsonl`."""
    folder.mkdir(parents=True, exist_ok=True)
    pair, rng = make(folder, case, seed), np.random.default_rng([seed, case, 1])
    plain = compared(folder, 'after')
    nothing = Suspect('parameter', 'nothing')
    rows = [{'what': 'nothing', 'share': 0.0, 'told': told(plain, nothing)}]
    print(folder.name, rows[0], flush=True)
    for one in tried(plain, rng):
        sign = float(rng.choice([-1.0, 1.0])) if signed(one.suspect) else 1.0
        for share in shares:
            step = sign * share * one.size
            name = f'{one.suspect.name}_{one.suspect.where}_{share}'
            try:
                pair.again(name, one.suspect, step)
                said = told(compared(folder, name), one.suspect)
            except IdentError as error:
                said = 'error', error.message
            where = one.suspect.where
            rows.append({'what': one.suspect.name, 'where': where, 'share': share,
                         'step': step, 'told': said})  # fmt: skip
            print(folder.name, rows[-1], flush=True)
    text = ''.join(json.dumps(row) + '\n' for row in rows)
    write_text(folder / 'tried.jsonl', text)


def scored(folder: Path) -> Iterator[str]:
    """Yield the counts by share of the size stated: all, and of each kind."""
    counts: dict[tuple[str, float], Counter[str]] = {}
    for file in sorted(folder.glob('*/tried.jsonl')):
        for row in map(json.loads, file.read_text(encoding='utf-8').splitlines()):
            for kind in ('all', row['what'].rpartition('.')[2]) if row['share'] else ('nothing',):
                counts.setdefault((kind, row['share']), Counter())[row['told'][0]] += 1
    for (kind, share), count in sorted(counts.items()):
        yield f'{kind:24} {share:4.2f} {dict(count)}'


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(
        prog='python -m checks.pairs.limits',
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('folder', type=Path)
    parser.add_argument('--count', type=int, default=8)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--shares', type=float, nargs='+', default=SHARES)
    parser.add_argument('--machines', nargs='+', default=['emps', 'tripod'],
                        choices=['emps', 'tripod', 'arm'])  # fmt: skip
    args = parser.parse_args(arguments)
    for case in range(args.count):
        machine = args.machines[case % len(args.machines)]
        place = args.folder / f'{machine}_{case:02d}'
        if not (place / 'tried.jsonl').exists():
            make = make_arm if machine == 'arm' else partial(make_reference, machine=machine)
            study(place, make, case, args.seed, args.shares)
    print(*scored(args.folder), sep='\n')


if __name__ == '__main__':
    main()
