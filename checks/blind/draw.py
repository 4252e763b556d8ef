# SPDX-License-Identifier: Apache-2.0
"""Draws a case: machine, motions, effects, sizes, noise, and what is imperfect in every drive."""

from collections.abc import Callable, Sequence
import math

import numpy as np

from checks.blind.faults import draw_fault
from checks.blind.forms import draw_form, FORMS
from checks.blind.forms.form import Hidden, twins
from checks.blind.label import Label, MotionOrder, Part
from checks.blind.machines import draw_machine, machine_of, Plain
from checks.blind.planning import forms_of, Wanted
from checks.blind.probe import Left, Probe
from checks.blind.rough import draw_rough
from checks.reference.bag_making import draw_parameters
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine

FIT_SECONDS, CHECK_SECONDS = 8.0, 6.0
ORDINARY = ('multi_point', 'mixed', 'pick_and_place', 'multisine', 'reversals', 'dwell', 'chirp')
# Motions that excite little: kind and pace.
QUIET = (('creep', 1.0), ('multi_point', 0.12), ('dwell', 0.15))
# What the imperfections leave together, in units of the noise.
IMPERFECT = (0.05, 0.4)
HIDDEN_BELOW, SHOWN_ABOVE = 0.2, 1.0
# Sizes beyond which the ranges of forms end; a limit reaches down to what small motions need.
SMALLEST, LARGEST = -3.0, 1.15
REACH = {'torque_saturation': 3.5, 'position_dependent_stiffness': 1.0}
# Shorter bristles are a sign, a faster current loop is none, and both are slow to integrate.
LEAST = {'presliding': 0.0, 'current_loop_lag': -0.3}
# A drive near its limit would hide what else is in it.
UNLIMITED = 0.8
MACHINES = 20


class Drawer:
    """Draws one case from the slow reference.

    Args:
        plain: Content of the machine file that the machine is drawn about.
    """

    generator = 'reference'
    pi_only = False
    probing: type[Probe] = Probe

    def __init__(self, plain: Plain, seed: int, wanted: Wanted) -> None:
        self.wanted = wanted
        self.rng = np.random.default_rng([seed, wanted.case])
        for _ in range(MACHINES):
            self.plain = draw_machine(plain, self.rng, self.pi_only)
            self.machine = machine_of(self.plain)
            self.parameters = draw_parameters(self.machine, self.rng)
            self.rough = draw_rough(self._limit(), self.rng, wanted.hard)
            self.motions = self._ordinary()
            if self._runs():
                break
        else:
            raise IdentError(
                ErrorCode.DIVERGED,
                f'no machine drawn for case {wanted.case} follows its motions; take another seed',
            )
        # Effects are seen through it: a mean hides the chatter of an encoder's steps.
        self.logger = self._logger() if wanted.sort != 'ideal' else []

    def _limit(self) -> float:
        limit = float(self.machine.numbers('torque_limit').max())
        return limit if math.isfinite(limit) else 100.0 * self.machine.effort_noise

    def _runs(self) -> bool:
        """Whether the machine follows its motions, and its drives stay off their limits."""
        try:
            self.probe = self._probe(self.motions)
            efforts = [self.probe.effort(i, ()) for i in range(2)]
        except IdentError:
            return False
        return max(float(np.abs(e).max()) for e in efforts) < UNLIMITED * self._limit()

    def _ordinary(self) -> tuple[MotionOrder, MotionOrder]:
        fit, check = (str(kind) for kind in self.rng.choice(ORDINARY, 2, replace=False))
        a, b = (int(x) for x in self.rng.integers(2**31, size=2))
        return MotionOrder(fit, FIT_SECONDS, a), MotionOrder(check, CHECK_SECONDS, b)

    def _quiet(self) -> tuple[MotionOrder, MotionOrder]:
        kind, pace = QUIET[int(self.rng.integers(len(QUIET)))]
        a, b = (int(x) for x in self.rng.integers(2**31, size=2))
        fit = MotionOrder(kind, FIT_SECONDS, a, pace)
        return fit, MotionOrder(kind, CHECK_SECONDS, b, pace)

    def _probe(self, motions: tuple[MotionOrder, MotionOrder]) -> Probe:
        drawn = [m.draw(self.machine) for m in motions]
        return self.probing(self.machine, self.parameters, drawn, self.rough.sigma)

    @staticmethod
    def known(machine: Machine) -> dict[str, list[str]]:
        """Return the names of the forms that a machine can have, by effect."""
        return forms_of(machine)

    def forms(self) -> dict[str, list[str]]:
        """Return those of the drawn machine."""
        return self.known(self.machine)

    def maker(self, effect: str, taken: Sequence[str] = ()) -> Callable[[float], Hidden]:
        """Return what gives an effect, at a place and of a form drawn now, a size.

        Args:
            taken: Drives with other effects; a generator may have to keep clear of them.
        """
        form = FORMS[str(self.rng.choice(self.forms()[effect]))]
        where = str(self.rng.choice(self.machine.drives))
        seed = int(self.rng.integers(2**31))
        return lambda size: draw_form(form, self.machine, where, size, seed)

    def _sized(
        self, effect: str, target: float, rounds: int = 4, taken: Sequence[str] = ()
    ) -> tuple[Hidden, float]:
        """Draw an effect and give it the size that leaves `target` after the nominal fit."""
        make = self.maker(effect, taken)
        top, bottom = REACH.get(effect, LARGEST), LEAST.get(effect, SMALLEST)
        size, best = 0.5, None
        for _ in range(rounds):
            hidden = make(size)
            try:
                left = self.probe.linear([*self.logger, hidden])
            except IdentError:  # it ran away
                size -= 0.4
                continue
            miss = abs(math.log(max(left, 1e-3) / target))
            if best is None or miss < best[0]:
                best = miss, hidden, left
            wish = size + math.log(target / max(left, 0.05)) / self.decades(hidden)
            wish = min(top, max(bottom, wish))
            if miss < 0.15 or abs(wish - size) < 0.01:
                break
            size = wish
        if best is None:
            return make(bottom), 0.0
        return best[1], best[2]

    def decades(self, hidden: Hidden) -> float:
        """Return how many powers of e lie between sizes 0 and 1 of an effect."""
        size = hidden.form.size
        return abs(math.log(size.high / size.low))

    def _first(
        self, names: Sequence[str], target: float, least: float, taken: Sequence[str]
    ) -> Hidden:
        """Return the first effect that leaves enough, else the one that leaves most."""
        best: tuple[float, Hidden] | None = None
        for name in names:
            hidden, left = self._sized(name, target, taken=taken)
            if best is None or left > best[0]:
                best = left, hidden
            if left >= least:
                break
        assert best is not None
        return best[1]

    def _listed(self) -> list[Hidden]:
        """Draw the effects that have to be found."""
        sort, wanted = self.wanted.sort, self.wanted
        if sort == 'hidden':
            return self._hidden()
        known = self.forms()
        names = [name for name in wanted.names if name in known]
        out: list[Hidden] = []
        for number, target in enumerate(wanted.sizes):
            alike = {twin for hidden in out for twin in twins(hidden.effect)}
            first = names[number : number + 1] + names[len(wanted.sizes) :]
            left = [name for name in first if name not in alike]
            least = min(0.6 * target, 1.2) if len(wanted.sizes) == 1 else 0.8
            places = [hidden.where for hidden in out]
            out.append(self._first(left, target, least, places))
        return out

    def _hidden(self) -> list[Hidden]:
        """Draw an effect that ordinary motions show and a quiet one does not."""
        best: tuple[float, Hidden, tuple[MotionOrder, MotionOrder], Probe] | None = None
        for name in self.wanted.names:
            if name not in self.forms():
                continue
            hidden, shown = self._sized(name, 2.0 * SHOWN_ABOVE, rounds=3)
            if shown < SHOWN_ABOVE:
                continue
            motions = self._quiet()
            probe = self._probe(motions)
            left = probe.linear([*self.logger, hidden])
            if best is None or left < best[0]:
                best = left, hidden, motions, probe
            if left < HIDDEN_BELOW:
                break
        if best is None:
            return []  # nothing could be shown at all: a case without an effect
        _, hidden, self.motions, self.probe = best
        return [hidden]

    def small_names(self, without: Sequence[str]) -> list[str]:
        """Return the effects that may be small in any drive: they fade with their size."""
        forms = self.forms()
        return [n for n in forms if n not in without and all(FORMS[f].fades for f in forms[n])]

    def _imperfections(self, effects: Sequence[Hidden]) -> list[Hidden]:
        """Draw what is imperfect in every drive, and scale it to a total that stays small."""
        names = self.small_names([effect.effect for effect in effects])
        total = self.rng.uniform(*IMPERFECT)
        shift, seeds = -0.4, self._imperfect_seeds(names)
        best: tuple[float, list[Hidden]] = (math.inf, self.logger)
        for _ in range(5):
            drawn = [*self.logger, *(make(size + shift) for make, size in seeds)]
            left = self._left(drawn)
            miss = abs(math.log(max(left, 1e-3) / total))
            if left <= IMPERFECT[1] and miss < best[0]:
                best = miss, drawn
            if miss < 0.3 and left <= IMPERFECT[1]:
                break
            shift += math.log(total / max(left, 0.02)) / 2.7
        return best[1]

    def _left(self, effects: Sequence[Hidden]) -> float:
        try:
            return self.probe.truth(effects).size
        except IdentError:
            return 10.0

    def _imperfect_seeds(
        self, names: Sequence[str]
    ) -> list[tuple[Callable[[float], Hidden], float]]:
        """Return two makers for each drive, of effects that differ, with a size for each."""
        own = [n for n in names if FORMS[self.forms()[n][0]].place == 'drive']
        whole = [n for n in names if n not in own]
        out = []
        for drive in self.machine.drives:
            for name in self.rng.choice(own, 2, replace=False):
                form = FORMS[str(self.rng.choice(self.forms()[str(name)]))]
                out.append((self._at(form.name, drive), float(self.rng.uniform(-0.5, 0.2))))
        if whole and self.rng.random() < 0.5:
            form = FORMS[self.forms()[str(self.rng.choice(whole))][0]]
            out.append((self._at(form.name, 'all'), float(self.rng.uniform(-0.6, 0.0))))
        return out

    def _at(self, form: str, where: str) -> Callable[[float], Hidden]:
        seed = int(self.rng.integers(2**31))
        return lambda size: draw_form(FORMS[form], self.machine, where, size, seed)

    def _logger(self) -> list[Hidden]:
        """Return what the logger's mean makes of the effort, on every drive alike."""
        if self.rough.smoothing == 1:
            return []
        time = 0.5 * self.rough.smoothing * self.rough.period
        form = FORMS['log.mean']
        return [Hidden(form, d, {'time': time}, math.nan, 0) for d in self.machine.drives]

    def draw(self) -> tuple[Label, list[Hidden]]:
        """Return the case's label, but for what its logs' noise turns out to be, and its effects.

        The effects are the imperfections and those that have to be found.
        """
        effects = self._listed()
        small = [] if self.wanted.sort == 'ideal' else self._imperfections(effects)
        everything = [*small, *effects]
        fault = None
        if self.wanted.sort == 'fault':
            count = len(self.machine.drives)
            fault = draw_fault(self.wanted.names[0], self.rng, count, self.plain)
        alone = [self._size([effect]) for effect in effects]
        parts = tuple(part_of(e, rho) for e, rho in zip(effects, alone, strict=True))
        listed = alone[0] if len(alone) == 1 else self._size(effects)
        left_small, left_all = self._leaves(small), self._leaves(everything)
        label = Label(
            case=self.wanted.case,
            sort=self.wanted.sort,
            generator=self.generator,
            machine=self.plain,
            parameters=self.parameters,
            motions=self.motions,
            effects=parts,
            imperfections=tuple(part_of(e, None) for e in small),
            fault=fault,
            rough=self.rough,
            noise=(),
            rho=listed,
            rho_small=left_small.size,
            rho_all=left_all.size,
            share=_share(left_small, left_all) if effects else None,
            seed=int(self.rng.integers(2**31)),
        )
        return label, everything

    def _leaves(self, effects: Sequence[Hidden]) -> Left:
        return self.probe.truth(effects)

    def _size(self, effects: Sequence[Hidden]) -> float:
        return self._leaves([*self.logger, *effects]).size if effects else 0.0


def part_of(hidden: Hidden, rho: float | None) -> Part:
    """Return an effect as its label holds it."""
    return Part(hidden.effect, hidden.form.name, hidden.where, dict(hidden.values), rho)


def _share(small: Left, everything: Left) -> float | None:
    """Return what the machine without the listed effects does not leave, of what everything does.

    It is of the recording held out.
    """
    before = float(everything.check.sum())
    return 1.0 - float(small.check.sum()) / before if before > 0.0 else None
