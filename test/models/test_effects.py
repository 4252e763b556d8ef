# SPDX-License-Identifier: Apache-2.0
"""Every effect of the fast kernels against the slow reference's, written in other coordinates."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from checks.blind.forms import draw_form, FORMS
from checks.blind.forms.form import Hidden
from checks.reference.axis import simulate_axis
from checks.reference.effects import draw_effect, Effect, TWINS
from checks.reference.plant import Unmodelled
from checks.reference.tripod import simulate_tripod
from ros2_ident.effects import CATALOGUE, get_effect
from ros2_ident.models import EffectAt, load_machine, make_model
from ros2_ident.models.trials import trials
from ros2_ident.recording import Dataset
from ros2_ident.search.least_squares import least_squares
from ros2_ident.simulate.motions import draw_motion

CONFIG = Path(__file__).parents[2] / 'config'
MACHINE = load_machine(CONFIG / 'tripod.yaml')
AXIS = load_machine(CONFIG / 'emps.yaml')
TRUTH = {
    'measurement_delay': 0.025,
    'gear_stiffness': 6e4,
    'gear_damping_ratio': 0.4,
    'tool_mass': 1.76,
    'drive_inertia': 9e-5,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.05,
}
AXIS_TRUTH = {'moving_mass': 95.0, 'coulomb_friction': 20.0, 'viscous_friction': 215.0}
# What a tripod has no place for.
ON_AN_AXIS = {'gear_flexibility'}
# What neither has a place for; `models/test_servo.py` holds these against the reference.
ON_A_SERVO = {'directional_load_friction', 'quadratic_load_friction', 'stribeck_load_friction'}
# The same law on both sides. Steps of an encoder and a drive at its limit make the motion chaotic;
# the two drifts of friction are linear and exponential in time.
SAME = sorted(
    set(CATALOGUE)
    - ON_A_SERVO
    - {'encoder_quantisation', 'torque_saturation', 'friction_drift'}
    # Its instants are no parameters but read from the log; see gap/test_payload.py.
    - {'payload_turns'}
    # Of arms; see test_serial.py and test_joint_zero.py.
    - {'hand_load', 'joint_zero_error'}
)


def warming(effect: Effect) -> Hidden:
    """Return a drive that runs in with two time constants."""
    return draw_form(FORMS['drift.two_times'], MACHINE, effect.where[0], 0.8, 1)


def damped(effect: Effect) -> Effect:
    """Return bristles with LuGre's damping."""
    return replace(effect, values={**effect.values, 'damping': 1e-3})


# Another form of the law that the catalogue's has room for.
CONTAINED = {'friction_drift': warming, 'presliding': damped}


def closed(name: str, other: Callable[[Effect], Unmodelled] = lambda effect: effect) -> float:
    """Return the share of an effect's squared change of the torque that the kernel's repeats.

    The nominal parameters stay at the truth; only the effect's own are fitted.
    """
    machine, truth, simulate, kind = MACHINE, TRUTH, simulate_tripod, 'multi_point'
    if name in ON_AN_AXIS:
        machine, truth, simulate, kind = AXIS, AXIS_TRUTH, simulate_axis, 'reversals'
    drive = machine.drives[len(machine.drives) // 2]
    motion = draw_motion(kind, machine, 5.0, 3)
    twin = TWINS.get(name, name)
    effect = draw_effect(twin, np.random.default_rng(1), 0.8, (drive,), machine)
    log = simulate(machine, truth, motion.position, motion.velocity, [other(effect)])
    cycle = machine.number('cycle')
    data = Dataset(
        machine.drives, cycle, 0, motion.position, motion.velocity, None, None, log.effort
    )
    at = EffectAt(name, 'all' if get_effect(name).place == 'all' else drive)
    model = make_model(machine, data, effects=[at])
    own = len(get_effect(name).parameters)
    nominal = [truth.get(p.name.split('.')[-1], 0.0) for p in model.parameters[:-own]]

    def residuals(phi: np.ndarray) -> np.ndarray:
        phi = np.atleast_2d(phi)
        theta = np.hstack([np.repeat([nominal], len(phi), axis=0), phi])
        return model.residuals(theta).reshape(len(phi), -1)

    low, high = np.array([(p.low, p.high) for p in model.parameters[-own:]]).T
    off = [p.neutral for p in model.scaled(at)]
    starts = np.array([phi for group in trials(at, model) for phi in group])
    losses = np.mean(residuals(starts) ** 2, axis=1)
    best = starts[np.argsort(np.where(np.isfinite(losses), losses, np.inf))[:3]]
    left = min(least_squares(residuals, phi, low, high, iterations=20).loss for phi in best)
    return 1.0 - left / float(np.mean(residuals(np.array(off)) ** 2))


@pytest.mark.parametrize('name', SAME)
def test_an_effect_is_the_references(name: str) -> None:
    assert closed(name) > 0.9998


@pytest.mark.parametrize('name', CONTAINED)
def test_a_law_with_room_for_another_form_takes_it(name: str) -> None:
    assert closed(name, CONTAINED[name]) > 0.998
