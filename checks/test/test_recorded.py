# SPDX-License-Identifier: Apache-2.0
"""Logs without a set-point and with nothing missing: no effect is named, values are right."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from checks.reference.bag_making import draw_parameters
from checks.reference.twin import twin_of
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.result import Diagnosis
from ros2_ident.identify.data import gather
from ros2_ident.machine.machine import Machine
from ros2_ident.models import load_machine, make_model
from ros2_ident.recording import Recording
from ros2_ident.simulate.bag import make_streams, nuisance_of
from ros2_ident.simulate.motions import draw_motion, Motion

CONFIG = Path(__file__).parents[2] / 'config'
MACHINES = ('emps', 'tripod', 'delta', 'double_pendulum')
# Rate of the log, Hz, and its length, s.
RATES = {25: 32.0, 100: 16.0, 1000: 8.0}
MOTIONS = {False: ('multi_point', 'multisine', 'mixed'), True: ('dwell',)}
# Steps of an encoder in the largest travel of a drive.
COUNTS = 40_000


@dataclass(frozen=True)
class Drawn:
    """A machine and what it does.

    Attributes:
        machine: The machine, its bounds about what it is.
        rate: Of the log, Hz.
        noise: Of the positions, in steps of their encoders.
    """

    machine: Machine
    values: Mapping[str, float]
    motion: Motion
    rate: int
    noise: float
    seed: int

    def recording(self) -> Recording:
        """Return its log, without a set-point."""
        motion, rng = self.motion, np.random.default_rng(self.seed)
        twin = twin_of(self.machine)
        log = twin.simulate(self.machine, self.values, motion.position, motion.velocity, ())
        step = np.ptp(log.position, axis=1, keepdims=True).max() / COUNTS
        noisy = log.position + self.noise * step * rng.standard_normal(log.position.shape)
        nuisance = replace(nuisance_of(self.machine), period=1.0 / self.rate, position_step=step)
        streams = make_streams(replace(log, position=noisy), self.motion, nuisance, rng)
        state = replace(streams['/joint_states'], velocity=None)
        return Recording(state, streams['/effort'])


def draw(number: int, seed: int, folder: Path) -> Drawn:
    """Draw a log; kinds, rates and rests take turns."""
    rng = np.random.default_rng([seed, number])
    name = MACHINES[number % len(MACHINES)]
    # Bands by the log, as of a machine file that states none.
    lines = (CONFIG / f'{name}.yaml').read_text().splitlines()
    path = folder / f'{name}.yaml'
    kept = [x for x in lines if not x.strip().startswith(('bandwidth', 'least_speed'))]
    path.write_text('\n'.join(kept))
    machine = load_machine(path)
    rate = list(RATES)[number // len(MACHINES) % len(RATES)]
    rest = bool(number // (len(MACHINES) * len(RATES)) % 2) ^ bool(number % 2)
    values = draw_parameters(machine, rng)
    values = {name: x for name, x in values.items() if '.link_' not in f'.{name}'}
    values |= {'measurement_delay': 0.0} if 'measurement_delay' in values else {}
    motion = draw_motion(str(rng.choice(MOTIONS[rest])), machine, RATES[rate], rng)
    return Drawn(machine, values, motion, rate, float(rng.integers(0, 4)), number)


def held(drawn: Drawn, found: Diagnosis) -> list[bool]:
    """Return of each parameter that is known whether its interval holds what is true."""
    dataset = gather((drawn.recording(),), drawn.machine).datasets[0]
    true = {**drawn.values, **make_model(drawn.machine, dataset).as_described(drawn.values)}
    told = ((true.get(n, true.get(n.rpartition('.')[2])), v) for n, v in found.parameters.items())
    return [v.low <= x <= v.high for x, v in told if x is not None]


@pytest.mark.parametrize('number', [7, 8])
def test_nothing_is_named_where_nothing_is_missing(number: int, tmp_path: Path) -> None:
    drawn = draw(number, 1, tmp_path)
    data = gather((drawn.recording(),), drawn.machine)
    found = diagnose(drawn.machine, data.datasets, labels=data.labels, seed=1)
    assert found.effect == 'none', (drawn.machine.kind, drawn.rate, drawn.noise)
    within = held(drawn, found)
    assert len(within) > 3 and sum(within) >= len(within) - 1
