# SPDX-License-Identifier: Apache-2.0
"""One frequency or one speed tells no effect from something else that does the same there."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

from ros2_ident.cli.main import main
from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.result import Cause, Diagnosis
from ros2_ident.gap.result import NOISE as NOISE_DOES
from ros2_ident.models import Machine, machine_from_mapping
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import low_pass
from ros2_ident.report.diagnosis import load_diagnosis
from ros2_ident.words.verdict import advice, sentence

CYCLE, NOISE = 0.002, 0.1
BOUNDS = {
    'moving_mass': [0.0, 40.0, 'kg'],
    'coulomb_friction': [0.0, 30.0, 'N'],
    'viscous_friction': [0.0, 90.0, 'N s/m'],
    'constant_force': [-20.0, 20.0, 'N'],
}


def cart(more: Mapping[str, Any], **controller: str) -> Machine:
    """Return a cart's machine with these parameters beside its own."""
    return machine_from_mapping(
        {
            'machine': 'linear_axis',
            'drives': ['cart'],
            'controller': {'cycle': CYCLE, **controller},
            'parameters': {**BOUNDS, **more},
        }
    )


CART = cart({'measurement_delay': [0.0, 0.004, 's']})


def diagnosed(place: np.ndarray, width: float, late: float = 0.0) -> Diagnosis:
    """Diagnose a cart of which friction takes a speed `width` [m/s], and is `late` [s]."""
    rng = np.random.default_rng(5)
    speed, time = np.gradient(place, CYCLE), CYCLE * np.arange(place.size)
    then = np.interp(time - late, time, speed)
    force = 6.5 * np.gradient(speed, CYCLE) + 5.0 * np.tanh(then / width) + 12.0 * then + 0.7
    force += NOISE * rng.standard_normal(place.size)
    place = place + 1e-6 * rng.standard_normal(place.size)
    log = Dataset(('cart',), CYCLE, 0, None, None, place[None], None, force[None])
    return diagnose(CART, [log], seed=1)


def test_one_frequency_gives_a_tie_and_several_a_name() -> None:
    time = CYCLE * np.arange(6000)
    one = diagnosed(0.2 * np.sin(9.0 * time), 0.03)
    assert one.facts.cause == Cause.UNKNOWN and one.also == ()
    ties = {(x.effect, x.like[:1]) for x in one.facts.ties}
    assert ('degressive_friction', ('parameters',)) in ties
    assert 'that this motion cannot tell' in sentence(one)
    assert next(advice(one)).startswith('Tell them apart: ')
    several = 0.1 * (np.sin(0.7 * time) + np.sin(2.3 * time) + 0.4 * np.sin(9.0 * time))
    named = diagnosed(several, 0.2)
    assert (named.effect, named.where) == ('degressive_friction', ('cart',))
    assert named.probability > 0.5


def test_reversals_that_are_all_alike_do_not_tell_way_from_time() -> None:
    time = CYCLE * np.arange(6000)
    triangle = 0.1 * scipy.signal.sawtooth(2.0 * np.pi * time / 1.5, 0.5)
    rounded = scipy.ndimage.uniform_filter1d(triangle, 60)
    alike = diagnosed(scipy.ndimage.uniform_filter1d(rounded, 60), 0.002, 0.012)
    assert alike.facts.cause == Cause.UNKNOWN and alike.also == ()
    (tie,) = [tie for tie in alike.facts.ties if tie.effect == 'presliding']
    assert 'time since reversal' in tie.like and tie.closed > 0.95
    assert 'the time since reversal do about as well' in sentence(alike)


def test_what_drifts_under_a_logged_effort_hides_no_effect() -> None:
    """The parameters make a thousandth of its change as well: a drift, which tells nothing."""
    rng, time = np.random.default_rng(5), CYCLE * np.arange(3000)
    place = 0.1 * (np.sin(0.7 * time) + np.sin(2.3 * time) + 0.4 * np.sin(5.0 * time))
    speed = np.gradient(place, CYCLE)
    force = 6.5 * np.gradient(speed, CYCLE) + 5.0 * np.tanh(speed / 0.002) + 0.7
    force += 12.0 * speed + 1.0 * np.abs(speed)
    place = place + 1e-5 * rng.standard_normal(place.size)
    log = Dataset(('cart',), CYCLE, 0, None, None, place[None], None, force[None])
    found = diagnose(cart({}, law='effort'), [log], output='position', seed=1)
    assert (found.effect, found.where) == ('asymmetric_friction', ('cart',))
    assert found.probability > 0.9 and found.facts.ties == ()


def pressed(law: Callable[[np.ndarray, np.ndarray], np.ndarray], *near: str) -> Diagnosis:
    """Diagnose a cart with a force that depends on its place, in shares of its stroke."""
    rng, time = np.random.default_rng(5), CYCLE * np.arange(6000)
    place = 0.1 * (np.sin(0.7 * time) + np.sin(2.3 * time) + 0.4 * np.sin(9.0 * time))
    speed = np.gradient(place, CYCLE)
    force = 6.5 * np.gradient(speed, CYCLE) + 12.0 * speed + 0.7
    force += law((place - place.min()) / np.ptp(place), np.tanh(speed / 0.002))
    force += NOISE * rng.standard_normal(place.size)
    place += 1e-6 * rng.standard_normal(place.size)
    log = Dataset(('cart',), CYCLE, 0, None, None, place[None], None, force[None])
    return diagnose(CART, [log], without=sorted(set(CATALOGUE) - {*near}), seed=1)


def test_a_force_that_a_smooth_function_of_the_place_makes_is_no_end_stop() -> None:
    near = 'end_stop', 'cable_spring', 'torque_ripple', 'position_dependent_friction'
    stops = pressed(lambda u, way: 5.0 * way + 20.0 * (u - np.clip(u, 0.2, 0.8)), *near)
    assert (stops.effect, stops.also) == ('end_stop', ()), sentence(stops)
    low, high = (stops.parameters[f'cart.end_stop.{name}'].value for name in ('lower', 'upper'))
    assert (low, high) == pytest.approx((-0.135, 0.135), abs=0.01)
    smooth = pressed(lambda u, way: 5.0 * way + 20.0 * (u - 0.5) ** 2, *near)
    assert smooth.facts.cause == Cause.UNKNOWN
    assert [(tie.effect, tie.like) for tie in smooth.facts.ties] == [('end_stop', ('position',))]


def test_what_coulomb_friction_makes_up_for_leaves_a_slope_as_well_known_as_it_is() -> None:
    found = pressed(lambda u, way: 5.0 * way * (0.5 + u), 'position_dependent_friction')
    slope, place, friction = (
        found.parameters[f'cart.{name}']
        for name in (
            'position_dependent_friction.slope',
            'position_dependent_friction.middle',
            'coulomb_friction',
        )
    )
    for value in (slope, friction):
        assert value.noise_high - value.noise_low < 0.05 * value.value
        assert value.lower_bound < value.low < value.value < value.high < value.upper_bound
    assert (place.low, place.high) == (place.lower_bound, place.upper_bound)


def rough(folder: Path, *, late: float, smooth: bool = False, soft: bool = False) -> str:
    """Write 30 s of a motor that a rough torque drives; stamps are up to `late` s late.

    Of a `soft` gear six tenths of the mass hang on a spring, at 12 Hz with the motor held.
    """
    rng, step = np.random.default_rng(1), 1e-4
    keep, inertia, viscous = np.exp(-60.0 * np.pi * step), 1.05e-4, 6e-4
    asked = np.repeat(rng.normal(0.0, 0.28, 6000), 50)
    net = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], asked)
    load, omega = 0.6 * inertia if soft else 0.0, 2.0 * np.pi * 12.0
    spring = load * np.array([0.1 * omega, omega**2]) if soft else np.array([1.0])
    swing = np.array([load, *spring]) if soft else spring
    den = np.polyadd(np.polymul([inertia - load, viscous], swing), [*(load * spring), 0.0])
    b, a, _ = scipy.signal.cont2discrete((swing, den), step)
    speed = scipy.signal.lfilter(b[0], a, net)
    torque = net + 0.018 * np.tanh(speed)
    uneven = np.where(rng.random(7500) < 0.82, 0.0, rng.uniform(0.002, 0.008, 7500))
    at = (np.cumsum(0.0042 + uneven) / step).astype(int)
    at = at[at < net.size]
    if smooth:
        torque = low_pass(torque[None], step, 4.0, 2)[0]
    stamp = np.sort(step * at + rng.uniform(0.0, late, at.size))
    place = 2.0 * np.pi / 16384 * np.round(step * np.cumsum(speed)[at] * 16384 / (2.0 * np.pi))
    # What is smoothed is the file: its noise, too.
    logged = torque[at] + (0.0 if smooth else 0.02) * rng.standard_normal(at.size)
    path = folder / 'log.csv'
    rows, names = np.column_stack([stamp, place, logged]), 'time [s],position [rad],torque [Nm]'
    np.savetxt(path, rows, '%.7f', ',', header=names, comments='')
    return str(path)


@pytest.mark.parametrize(
    ('late', 'named'),
    [(0.0025, ''), (0.004, ''), (0.0, 'effort_smoothing'), (0.0025, 'gear_flexibility')],
)
def test_errors_of_the_motion_are_told_from_what_smooths_an_effort(
    tmp_path: Path, late: float, named: str
) -> None:
    kinds = {'smooth': named == 'effort_smoothing', 'soft': named == 'gear_flexibility'}
    log, machine = rough(tmp_path, late=late, **kinds), str(tmp_path / 'machine.yaml')
    assert main(['new-machine', '--kind', 'linear_axis', '--bag', log, '--out', machine]) == 0
    asked = f'diagnose {log} --machine {machine} --out {tmp_path} --no-report --quiet'
    main(asked.split())
    found = load_diagnosis(tmp_path).found
    assert found.effect == named or (not named and found.facts.cause == Cause.UNKNOWN)
    if not named:
        assert {x.effect for x in found.facts.ties if NOISE_DOES in x.like} >= {
            'effort_smoothing',
            'gear_flexibility',
        }
        assert 'errors of the recorded positions and of their stamps' in sentence(found)
