# SPDX-License-Identifier: Apache-2.0
"""Pairs of logs of a machine on which a parameter or an effect changed, or nothing."""

from pathlib import Path
from typing import Any

import numpy as np

from checks.blind.draw import Drawer
from checks.blind.forms.form import Hidden
from checks.blind.machines import file_text, read_plain
from checks.blind.planning import Wanted
from checks.blind.probe import Probe
from checks.blind.rough import record
from ros2_ident.effects import CATALOGUE
from ros2_ident.files import write_text
from ros2_ident.recording import write_bag

ROOT = Path(__file__).parents[2]
# Sizes of the changes, RMS of what they do to the effort in units of its noise.
SIZES = (1.5, 6.0)
# Share of the pairs in which nothing changed, and of those with another motion after.
UNCHANGED, MOVED = 0.4, 0.5
# Share of the changes that are effects.
EFFECTS = 0.5


def kind_of(rng: np.random.Generator) -> tuple[str, float, int]:
    """Draw the kind of a change, its size, and which motion is the one after."""
    kind = 'none' if rng.random() < UNCHANGED else 'parameter'
    kind = 'effect' if kind != 'none' and rng.random() < EFFECTS else kind
    size = float(np.exp(rng.uniform(*np.log(SIZES))))
    return kind, size, int(rng.random() < MOVED)


class Pair(Drawer):
    """Draws a machine with its imperfections, and what changes on it."""

    def write(self, folder: Path) -> dict[str, Any]:
        """Write the logs of both sides and the machine file; return the label."""
        label, before, after, probe = self.changed()
        for name, of, effects, motion in (
            ('before', self.probe, before, 0), ('after', probe, after, label['motion']),
        ):  # fmt: skip
            log = of.log(motion, effects)
            streams, _, _ = record(log, of.motions[motion], self.rough, self.rng)
            write_bag(folder / name, streams)
        stated = dict(self.plain)
        if self.rough.stated:
            stated['effort_noise'] = float(f'{self.rough.sigma * self.rough.stated:.3g}')
        write_text(folder / 'machine.yaml', file_text(stated))
        return label

    def changed(self) -> tuple[dict[str, Any], list[Hidden], list[Hidden], Probe]:
        """Return label, effects before and after, and the machine after."""
        rng = self.rng
        kind, size, which = kind_of(rng)
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
        step, rms = float(self.rng.choice([-1.0, 1.0])) * 0.05 * abs(base[name]), size
        for _ in range(3):
            step = max(-0.9 * abs(base[name]), step * size / max(rms, 1e-9))
            after = type(self.probe)(
                self.machine, base | {name: base[name] + step}, self.probe.motions,
                self.rough.sigma,
            )  # fmt: skip
            effort = after.effort(which, small) - self.probe.effort(which, small)
            rms = float(np.sqrt(np.mean(effort**2, axis=1)).max() / self.rough.sigma)
            if abs(rms / size - 1.0) < 0.1:
                break
        label |= {'name': name, 'where': '', 'size': rms, 'value': base[name], 'change': step}
        return after

    def _values(self) -> dict[str, float]:
        """Return the true parameters, each by its full name."""
        names = (p.name for p in self.probe.model(0).parameters)
        return dict(zip(names, self.probe.theta.tolist(), strict=True))


def draw_reference(folder: Path, case: int, seed: int, machine: str) -> dict[str, Any]:
    """Draw a pair of a machine by the slow reference, and return its label."""
    text = read_plain(ROOT / f'config/{machine}.yaml')
    wanted = Wanted(case, 'single', (), (), case % 5 == 4)
    return Pair(text, seed, wanted).write(folder)


def draw_tripod(folder: Path, case: int, seed: int) -> dict[str, Any]:
    """Draw a pair of a tripod by MuJoCo, in its own forms of the effects."""
    # It need not be there for the others.
    from checks.generators.mujoco_cases import MujocoDrawer

    class MujocoPair(Pair, MujocoDrawer):
        """Draws a pair by MuJoCo."""

    text = read_plain(ROOT / 'config/tripod.yaml')
    return MujocoPair(text, seed, Wanted(case, 'single', (), (), case % 5 == 4)).write(folder)
