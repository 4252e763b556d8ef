# SPDX-License-Identifier: Apache-2.0
"""Bags from the reference: a simulated log with what a real log does to it."""

from collections.abc import Mapping, Sequence

import numpy as np

from checks.reference.plant import Unmodelled
from checks.reference.twin import twin_of
from ros2_ident.machine.machine import Machine
from ros2_ident.simulate.bag import make_streams, Nuisance, nuisance_of, SimulatedBag
from ros2_ident.simulate.motions import Motion


def simulate_bag(
    machine: Machine,
    parameters: Mapping[str, float],
    motion: Motion,
    seed: int = 0,
    nuisance: Nuisance | None = None,
    effects: Sequence[Unmodelled] = (),
) -> SimulatedBag:
    """Simulate a log and make streams of it.

    Args:
        parameters: Parameters by name, see its `plant`, as `tripod_plant` and `axis_plant`.
        nuisance: What lies between machine and log; by the machine file's noise where not given.

    Raises:
        IdentError: UNKNOWN_MODEL for a machine that has no reference here.
    """
    twin = twin_of(machine)
    log = twin.simulate(machine, parameters, motion.position, motion.velocity, effects)
    rng = np.random.default_rng(seed)
    streams = make_streams(log, motion, nuisance or nuisance_of(machine), rng)
    return SimulatedBag(streams, log)


def draw_parameters(machine: Machine, rng: np.random.Generator) -> dict[str, float]:
    """Draw one machine's parameters from the inner part of its box, as real machines differ.

    Friction is drawn for each drive by itself, the gear's stiffness spreads by a twentieth about a
    common value (never below a third of its box: softer gears are another machine), the rest is
    common.
    """
    drives = machine.drives
    drawn = {}
    for name, (low, high, _) in machine.bounds.items():
        begin = low + (0.35 if name == 'gear_stiffness' else 0.1) * (high - low)
        end = low + (0.5 if name in ('measurement_delay', 'gear_damping_ratio') else 0.9) * (
            high - low
        )
        common = rng.uniform(begin, end)
        if len(drives) == 1 or name not in ('gear_stiffness', 'coulomb_torque', 'viscous_torque'):
            drawn[name] = float(common)
            continue
        for drive in drives:
            own = (
                common * rng.uniform(0.95, 1.05)
                if name == 'gear_stiffness'
                else rng.uniform(begin, end)
            )
            drawn[f'{drive}.{name}'] = float(own)
    return drawn
