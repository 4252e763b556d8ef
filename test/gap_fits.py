# SPDX-License-Identifier: Apache-2.0
"""Fits made of numbers, on which the rules of the diagnosis are tested one by one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from ros2_ident.effects import get_effect
from ros2_ident.gap.attribute import Round
from ros2_ident.gap.criteria import Rules
from ros2_ident.gap.explain import Explained, Explainer
from ros2_ident.gap.fits import Explanation
from ros2_ident.models import EffectAt

DRIVES = ('one', 'two')
SAMPLES = 1000
RULES = Rules(
    material=0.5,
    unknown=0.8,
    step=0.4,
    share=0.1,
    closed=0.6,
    rival=0.1,
    alike=0.02,
    most=3,
)
STRIBECK, FRICTION = EffectAt('stribeck', 'one'), EffectAt('asymmetric_friction', 'one')
DRAG, SPRING = EffectAt('quadratic_drag', 'two'), EffectAt('cable_spring', 'two')


class Attribution:
    """Fits by number: what `refit` returns is told beforehand."""

    def __init__(self):
        part = SimpleNamespace(drive=np.repeat([0, 1], SAMPLES), models=[self])
        self.case = SimpleNamespace(fit=part, check=part, drives=DRIVES)
        self.floor = np.ones(2)
        self.refits = {}
        self.errors = np.inf
        self.limits = {}
        self.machine, self.noise, self.thinned = None, 0.1, False

    def standing(self, before, after):
        return self.errors

    def scaled(self, at):
        """Return an effect's parameters, all in shares of one."""
        return [
            replace(p, low=-1.0, high=1.0, neutral=0.0) for p in get_effect(at.effect).parameters
        ]

    def stopped(self):
        return False

    def refit(self, effects, theta):
        return self.refits[tuple(effects)]


def size_of(effect):
    return len(get_effect(effect.effect).parameters)


def made(gap, check=None, effects=(), own=0.5):
    """Return a fit that leaves a mean square beyond the noise's on each of two drives."""
    fit = SAMPLES * (1.0 + np.array(gap, dtype=float))
    held = SAMPLES * (1.0 + np.array(gap if check is None else check, dtype=float))
    theta = np.array([1.0, 2.0] + [own] * sum(map(size_of, effects)))
    empty = np.empty(0)
    return Explanation(tuple(effects), theta, fit, held, *([empty] * 4))


def floor_of(variance, restless=()):
    """Return a floor whose noise has a variance that many times its innovation's."""
    noise = SimpleNamespace(variance=0.1 * variance, innovation=0.1)
    return SimpleNamespace(
        noise=(noise, noise),
        per_drive=np.ones(2),
        high=np.ones(2),
        restless=lambda drives, stated: {d: 10.0 * stated for d in drives if d in restless},
    )


def found(chain, rounds=(), rivals=(), rests=(), remaining=0.0, complete=True):
    return Explained(tuple(chain), tuple(rounds), tuple(rivals), tuple(rests), remaining, complete)


def of_round(base, *fitted):
    return Round(base, {}, {}, fitted)


def explainer_of(attribution):
    """Return the rules on fits by number, under a noise that stays what it is."""
    made_ = Explainer(attribution, floor_of(1.0), RULES)
    made_.with_new_floor = lambda chain, rounds: (chain, rounds)
    made_.less_noise = lambda chain, rounds, best: None
    made_.ends = lambda e, evidence: (e.theta - 0.1, e.theta + 0.1)
    return made_
