# SPDX-License-Identifier: Apache-2.0
"""One table before and after a change: what a diagnosis names of machines drawn fresh and sealed.

Each case is a machine file of `config/` as it stands, its parameters drawn, 8 s of pick and place
to fit and 6 s to check. Rows, taking turns, so that the first N cases hold all of them:

    white     one effect, white noise
    rough     one effect, noise of AR 0 to 0.9, small faults on every drive
    null      nothing missing, AR 0 to 0.99, small faults in every other case
    pair      two effects
    every     the same effect on every drive, own sizes
    constant  a number of the machine file is wrong: of a tripod, and of a servo without effort
    outside   a cause that the catalogue lacks

Right is: `score.right` (effect and place; `none`; `unknown`), of a pair
both in the first two, of `every` the effect first and on every drive, of `constant` the constant
named, its true value in the interval.

Example: python -m checks.blind --generator suspects --seed 7 --cases 64 --out build/suspects
"""

from collections.abc import Callable, Mapping, Sequence
import copy
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from checks.blind import seal
from checks.blind.case import CHECK, FIT, MACHINE, write_case
from checks.blind.draw import CHECK_SECONDS, Drawer, FIT_SECONDS, MACHINES
from checks.blind.forms import draw_form, FORMS
from checks.blind.forms.form import Hidden
from checks.blind.label import MotionOrder, to_mapping
from checks.blind.machines import file_text, machine_of, Plain, read_plain
from checks.blind.planning import Wanted
from checks.blind.probe import Probe
from checks.blind.rough import Rough
from checks.blind.run import Generator, numbered, order_of
from checks.blind.score import alike, found_names, hits_of_pair, holds, right
from checks.blind.store import read_json, Store
from checks.blind.truth import answer_of
from checks.reference.bag_making import draw_parameters
from checks.reference.plant import Log, Plant
from checks.reference.twin import twin_of
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import replacing_directory, write_text
from ros2_ident.machine.machine import Machine
from ros2_ident.recording import Stream, write_bag
from ros2_ident.simulate.bag import make_streams, Nuisance
from ros2_ident.simulate.motions import Motion

ROWS = {'white': 12, 'rough': 12, 'null': 8, 'pair': 8, 'every': 8, 'constant': 8, 'outside': 8}
SORTS = {'null': 'none', 'pair': 'pair', 'outside': 'outside', 'constant': 'ideal'}
# What the wanted effects leave behind a nominal fit, in units of the noise.
SIZES = {
    'white': (0.7, 6.0),
    'rough': (0.7, 6.0),
    'pair': (1.0, 6.0),
    'every': (1.5, 6.0),
    'outside': (1.0, 8.0),
}
LEAST_SHARE = 0.5
TRIPOD, SERVO = (Path(__file__).parents[2] / f'config/{m}.yaml' for m in ('tripod', 'xl330'))
# A constant of the true machine is off by so much, as a share, either way.
CONSTANTS = {
    'tripod': {
        'controller.velocity_gain': (0.04, 0.12),
        'controller.position_gain': (0.04, 0.12),
        'controller.integral_gain': (0.1, 0.3),
        'controller.velocity_feedforward': (0.03, 0.08),
        'drive.gear_factor': (0.03, 0.08),
        'drive.rail_mass': (0.15, 0.5),
        'geometry.rod_length': (0.01, 0.04),
        'geometry.rail_radius': (0.02, 0.06),
    },
    'servo': {
        'drive.load_mass': (0.15, 0.6),
        'drive.load_length': (0.05, 0.15),
        'drive.torque_constant': (0.05, 0.15),
        'controller.position_gain': (0.05, 0.15),
    },
}
# Of a servo's data sheet: sought beside them, its load could be anything.
SHEET = {'torque_constant': 0.4, 'resistance': 4.0, 'armature': 2e-3}
COUNT = 2.0 * math.pi / 4096  # rad, of a servo's encoder


def order(seed: int) -> list[tuple[str, int]]:
    """Return (row, number within it) of all cases; every prefix holds the rows in proportion."""
    turns = [(i + 0.5) / n for n in ROWS.values() for i in range(n)]
    named = [(row, i) for row, n in ROWS.items() for i in range(n)]
    return [named[k] for k in np.argsort(turns, kind='stable')]


@dataclass(frozen=True)
class Alike:
    """A form on every drive, each with its own numbers; looks like one that is hidden."""

    parts: tuple[Hidden, ...]
    where: str = 'each'

    form = property(lambda self: self.parts[0].form)
    effect = property(lambda self: self.parts[0].effect)
    values = property(
        lambda self: {f'{p.where}.{k}': v for p in self.parts for k, v in p.values.items()}
    )

    def apply(self, plant: Plant) -> None:
        """Write it into a plant."""
        for part in self.parts:
            part.apply(plant)


class Other(Probe):
    """A machine whose file is wrong: its logs are of `true`, what is fitted to them is not."""

    true: Machine

    def _simulate(self, motion: Motion, effects: Sequence[Any]) -> Log:
        courses = motion.position, motion.velocity
        twin = twin_of(self.machine)
        return twin.simulate(self.true, self.parameters, *courses, effects, 1e-6, 1e-7)


class TableDrawer(Drawer):
    """Draws one case of a tripod."""

    def __init__(
        self, row: str, number: int, case: int, seed: int, seconds: tuple[float, float]
    ) -> None:
        self.row, self.rng = row, np.random.default_rng([seed, case])
        self.plain, self.constant = read_plain(TRIPOD), None
        self.machine = machine_of(self.plain)
        self.rough, self.logger = self._rough(number), []
        if row == 'constant':
            self.constant, self.true = wrong(self.plain, number // 2, self.rng, seed)
        self.wanted = self._wish(number, case, seed)
        self.small = row == 'rough' or (row == 'null' and number % 2 == 1)
        for _ in range(MACHINES):
            self.parameters = draw_parameters(self.machine, self.rng)
            starts = self.rng.integers(2**31, size=2)
            both = [
                MotionOrder('pick_and_place', s, int(n))
                for s, n in zip(seconds, starts, strict=True)
            ]
            self.motions = both[0], both[1]
            if self._runs():
                return
        raise IdentError(ErrorCode.DIVERGED, f'case {case} follows no motion; take another seed')

    def _rough(self, number: int) -> Rough:
        """Return noise by the row; the machine file states 0.01 N m of all."""
        memory = float(self.rng.uniform(0.0, 0.9))
        memory *= self.row == 'rough' or number % 2 == 1
        if self.row == 'white' or self.row == 'outside':
            memory = 0.0
        if self.row == 'null':
            memory = (0.0, 0.5, 0.9, 0.99)[number // 2 % 4]
        ends = (0.004, 0.025) if self.row == 'rough' else (0.01, 0.01)
        sigma = float(np.exp(self.rng.uniform(*np.log(ends))))
        return Rough(sigma, (memory,) if memory else (), stated=0.01 / sigma)

    def _wish(self, number: int, case: int, seed: int) -> Wanted:
        forms = self.forms()
        names = [n for n in forms if (n in CATALOGUE) != (self.row == 'outside')]
        if self.row == 'every':
            names = [n for n in names if all(FORMS[f].place == 'drive' for f in forms[n])]
        # Every name comes round before one comes twice; the rows begin at places of their own.
        begin = 12 * (self.row == 'rough') + number * (1 + (self.row == 'pair'))
        drawn = [str(n) for n in np.random.default_rng([seed, 0]).permutation(names)]
        names = [drawn[(begin + i) % len(drawn)] for i in range(len(drawn))][:6]
        low, high = np.log(SIZES.get(self.row, (1.0, 1.0)))
        count = {'pair': 2, 'null': 0, 'constant': 0}.get(self.row, 1)
        sizes = tuple(float(x) for x in np.exp(self.rng.uniform(low, high, count)))
        return Wanted(case, SORTS.get(self.row, 'single'), tuple(names), sizes, False)

    def _probe(self, motions: tuple[MotionOrder, MotionOrder]) -> Probe:
        drawn = [m.draw(self.machine) for m in motions]
        kind = Other if self.constant else Probe
        probe = kind(self.machine, self.parameters, drawn, self.rough.sigma)
        if isinstance(probe, Other):
            probe.true = machine_of(self.true)
        return probe

    def maker(self, effect: str, taken: Sequence[str] = ()) -> Callable[[float], Any]:
        """Return what gives an effect a size: as any, or on every drive at `LEAST_SHARE` to 1."""
        if self.row != 'every':
            return super().maker(effect, taken)
        form = FORMS[str(self.rng.choice(self.forms()[effect]))]
        decades = abs(math.log(form.size.high / form.size.low))
        drives = self.machine.drives
        less = self.rng.uniform(math.log(LEAST_SHARE), 0.0, len(drives)) / decades
        own = list(zip(drives, less, self.rng.integers(2**31, size=len(drives)), strict=True))
        return lambda size: Alike(
            tuple(draw_form(form, self.machine, d, size + x, int(n)) for d, x, n in own)
        )

    def _imperfections(self, effects: Sequence[Hidden]) -> list[Hidden]:
        return super()._imperfections(effects) if self.small else []


def wrong(
    stated: Plain, number: int, rng: np.random.Generator, seed: int
) -> tuple[dict[str, Any], Plain]:
    """Return a constant of a machine file, and the file of a machine that has another."""
    ranges = CONSTANTS[stated['machine']]
    drawn = np.random.default_rng([seed, 1]).permutation(list(ranges))
    key = str(drawn[number % len(ranges)])
    off = float(rng.uniform(*ranges[key])) * float(rng.choice([-1.0, 1.0]))
    part, name = key.split('.')
    true = copy.deepcopy(stated)
    true[part][name] = float(f'{stated[part][name] * (1.0 + off):.6g}')
    return {'name': name, 'stated': stated[part][name], 'true': true[part][name]}, true


def write_servo(
    folder: Path, number: int, case: int, seed: int, seconds: tuple[float, float]
) -> dict[str, Any]:
    """Write a case of a servo without effort whose file has a wrong constant; return its label."""
    rng = np.random.default_rng([seed, case])
    plain = read_plain(SERVO)
    plain['drive'] |= SHEET
    plain['parameters'] = {k: v for k, v in plain['parameters'].items() if k not in SHEET}
    constant, true = wrong(plain, number // 2, rng, seed)
    machine, other = machine_of(plain), machine_of(true)
    parameters = draw_parameters(machine, rng)
    nuisance = Nuisance(period=1e-3, position_step=COUNT)
    with replacing_directory(folder, replace=True) as new:
        new.mkdir()
        for name, time in zip((FIT, CHECK), seconds, strict=True):
            motion = MotionOrder('pick_and_place', time, int(rng.integers(2**31))).draw(machine)
            courses = motion.position, motion.velocity
            log = twin_of(other).simulate(other, parameters, *courses, (), 1e-8, 1e-9)
            seen = replace(log, position=log.carriage)
            streams = make_streams(seen, motion, nuisance, rng)
            state = replace(streams['/joint_states'], velocity=None)
            goal: Stream = replace(streams['/joint_command'], velocity=None)
            write_bag(new / name, {'/joint_states': state, '/joint_command': goal})
        write_text(new / MACHINE, file_text(plain))
    return {'machine': plain, 'parameters': parameters, 'constant': constant, 'effects': []}


def draw(
    store: Store, case: int, seed: int, seconds: tuple[float, float] = (FIT_SECONDS, CHECK_SECONDS)
) -> dict[str, Any]:
    """Write a case's bags; return its label."""
    row, number = order(seed)[case - 1]
    folder = store.case(case)
    if row == 'constant' and number % 2:
        return {'row': row} | write_servo(folder, number, case, seed, seconds)
    drawer = TableDrawer(row, number, case, seed, seconds)
    label, effects = drawer.draw()
    label = write_case(folder, store.clean(case), drawer, label, effects)
    return {'row': row, 'constant': drawer.constant} | to_mapping(label)


def judged(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Whether a diagnosis is right by the rule of its row."""
    found = found_names(answer)
    if label['row'] == 'pair':
        return hits_of_pair(answer, 2) == 2
    if label['row'] == 'every':
        true = label['effects'][0]['effect']
        places = {drive for name, where in found if alike(name, true) for drive in where}
        whole = {'all', 'each'} & places or places >= set(label['machine']['drives'])
        return bool(found) and alike(found[0][0], true) and bool(whole)
    if label['row'] == 'constant':
        wanted = label['constant']['name']
        said = {n for n, _ in found} | {c['effect'] for c in answer.get('confusable', [])}
        named = any(name.removesuffix('_error').endswith(wanted) for name in said if found)
        # What the file states is no parameter unless it was found wrong, or ties with an effect.
        named |= wanted in answer['parameters']
        true, stated = (label['constant'][key] for key in ('true', 'stated'))
        # As a number of the file, as a factor on it, or as a difference.
        ends = {wanted: true, f'{wanted}_error.factor': true / stated}
        ends |= {f'{wanted}_error.error': true - stated}
        there = [
            (x, ends[e]) for n, x in answer['parameters'].items() for e in ends if n.endswith(e)
        ]
        return named and any(holds({**x, 'true': value}) for x, value in there)
    return right(answer)


def row(store: Store, case: int, label: Mapping[str, Any]) -> dict[str, Any]:
    """Return what came of a case."""
    out = asked(label, {}) | {'case': case}
    out['effects'] = [{**e, 'where': [e['where']]} for e in label['effects']]
    out |= read_json(store.case(case) / 'run.json') or {}
    found = read_json(store.case(case) / 'diagnosis' / 'diagnosis.json')
    if found is None:
        return out | {'right': False}
    out |= answer_of(found) | {'parameters': found['parameters']}
    return out | {'right': judged(label, out)}


def told(store: Store, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the cases as lines, and the table."""
    out = []
    for r in rows:
        true = [[e['effect'], *e['where']] for e in r['effects']] or r['constant']
        said = found_names(r) if 'verdict' in r else r['error']
        out.append(
            f'{r["case"]:3d} {r["row"]:9s}{"right" if r["right"] else "WRONG"} {true}: {said}'
        )
    out += [f'{name:9s}{text}' for name, text in figures(rows).items()]
    used = [r['cpu_seconds'] for r in rows if r.get('cpu_seconds')] or [math.nan]
    median, most = np.quantile(used, (0.5, 0.95))
    return [*out, f'processor seconds: median {median:.1f}, 95 % {most:.1f}']


def asked(label: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a row says of its label."""
    keys = ('row', 'sort', 'constant', 'rough', 'rho_all', 'noise')
    return {key: label.get(key) for key in keys}


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return how many cases of each row are right."""
    own = {name: [r['right'] for r in rows if r['row'] == name] for name in ROWS}
    return {name: f'{sum(hits):3d} of {len(hits)}' for name, hits in own.items()}


def _draw(store: Store, case: int, seed: int) -> dict[str, str]:
    return seal.close(draw(store, case, seed), seed)


def _orders(store: Store, case: int) -> dict[int, dict[str, str]]:
    return {case: order_of(store, case) | {'threads': '1'}}


GENERATOR = Generator(numbered, _draw, _orders, row, told)
