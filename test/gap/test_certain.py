# SPDX-License-Identifier: Apache-2.0
"""What tells noise from a gap, and one cause from another, where a log is not as expected."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
import time
from types import SimpleNamespace

from gap_signals import floor_of
from gap_signals import motion as moves
from identify_cases import (
    axis,
    axis_data,
    AXIS_TRUTH,
    recording_of,
    theta_of,
    tripod,
    TRIPOD_TRUTH,
)
import numpy as np
import pytest
from scipy.signal import lfilter

from checks.reference.bag_making import simulate_bag
from checks.reference.effects import Effect
from ros2_ident.effects import CATALOGUE, get_effect
from ros2_ident.errors import IdentError
from ros2_ident.gap import case
from ros2_ident.gap.attribute import Attribution
from ros2_ident.gap.case import Case, recordings_of
from ros2_ident.gap.clock import Clock
from ros2_ident.gap.coordinates import coordinates, Motion
from ros2_ident.gap.criteria import Rules
from ros2_ident.gap.diagnose import _Passes, diagnose
from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.gap.explain import Explainer
from ros2_ident.gates import examine
from ros2_ident.gates.law import fit_law
from ros2_ident.identify.data import gather
from ros2_ident.models import EffectAt, make_model
from ros2_ident.models.orders import orders_shown
from ros2_ident.recording import Dataset
from ros2_ident.search.journal import Journal
from ros2_ident.simulate.bag import nuisance_of
from ros2_ident.simulate.motions import draw_motion


@cache
def recording(seed: int, effects: tuple[str, ...] = (), kind: str = 'mixed') -> Dataset:
    """Return a log of 5 s of the tripod."""
    put = tuple(EFFECTS[name] for name in effects)
    motion = draw_motion(kind, tripod(), 5.0, seed)
    bag = simulate_bag(
        tripod(), TRIPOD_TRUTH, motion, seed, replace(nuisance_of(tripod()), drop=0.0), put
    )
    return gather([recording_of(bag)], tripod()).datasets[0]


EFFECTS = {
    'ripple': Effect(
        'torque_ripple', ('drive_3',), {'torque': 0.035, 'phase': 0.6, 'order': 12.47}, 'same'
    ),
    'limit': Effect('torque_saturation', ('drive_2',), {'limit': 1.7}, 'same'),
    'low limit': Effect('torque_saturation', ('drive_2',), {'limit': 1.2}, 'same'),
}


def louder(data: Dataset, drive: int, size: float, seed: int) -> Dataset:
    """Return a log in which one drive's effort has more noise."""
    effort = np.array(data.effort)
    effort[drive] += size * np.random.default_rng(seed).standard_normal(effort.shape[1])
    return replace(data, effort=effort)


def diagnosed(*effects: str) -> Diagnosis:
    return diagnose(tripod(), [recording(1, effects)], [recording(2, effects)], seed=1)


def test_what_one_of_three_like_drives_has_more_than_the_others_is_no_noise() -> None:
    noise = 4.0 * tripod().effort_noise
    found = diagnose(
        tripod(), [louder(recording(1), 1, noise, 5)], [louder(recording(2), 1, noise, 6)], seed=1
    )
    assert (found.effect, found.where) == ('unknown', ('drive_2',))
    assert found.floor.per_drive == pytest.approx(3 * [tripod().effort_noise], rel=0.1)
    assert 'drive_2: nothing predicts what is left there' in found.floor.sentence


def test_noise_that_all_drives_have_alike_is_noise() -> None:
    noise = 4.0 * tripod().effort_noise
    fit, check = recording(1), recording(2)
    for drive in range(3):
        fit, check = louder(fit, drive, noise, drive), louder(check, drive, noise, 9 + drive)
    found = diagnose(tripod(), [fit], [check], seed=1)
    assert found.effect == 'none'
    assert found.floor.per_drive == pytest.approx(3 * [np.hypot(1.0, 4.0) * 0.01], rel=0.1)


def test_a_ripple_is_found_whose_order_is_none_of_the_starts() -> None:
    found = diagnosed('ripple')
    assert (found.effect, found.where, found.also) == ('torque_ripple', ('drive_3',), ())
    assert found.parameters['drive_3.torque_ripple.order'].value == pytest.approx(12.47, abs=0.02)


def test_orders_are_told_from_a_residual_and_chance_shows_none() -> None:
    at = EffectAt('torque_ripple', 'drive_3')
    model = make_model(tripod(), recording(1)).extended((at,))
    theta = np.array([TRIPOD_TRUTH[p.name.rpartition('.')[2]] for p in model.parameters[:-3]])

    def simulated(points: np.ndarray) -> np.ndarray:
        return model.residuals(np.hstack([np.repeat(theta[None], len(points), axis=0), points]))

    neutral = simulated(np.array([[0.0, 0.0, 1.0]]))[0]
    ripple = simulated(np.array([[0.02, 0.01, 12.47]]))[0] - neutral
    noise = 0.01 * np.random.default_rng(1).standard_normal(ripple.size)
    none = np.empty((ripple.size, 0))

    def shown(residual: np.ndarray, clear: bool) -> tuple[float, ...]:
        return orders_shown(model, at, lambda p: simulated(p) - neutral, residual, none, clear)

    assert shown(ripple + noise, True)[0] == pytest.approx(12.47, abs=0.06)
    assert shown(noise, True) == ()
    assert len(shown(noise, False)) == 3


def test_a_limit_that_the_file_does_not_know_is_found() -> None:
    found = diagnosed('limit')
    assert (found.effect, found.where, found.also) == ('torque_saturation', ('drive_2',), ())


def test_a_limit_that_the_file_does_not_know_is_no_other_gain() -> None:
    logs = [recording(seed, ('low limit',)) for seed in (1, 2)]
    assert fit_law(tripod(), logs[0], 'drive_2').limit == pytest.approx(1.2, abs=0.02)
    report = examine(tripod(), logs)
    assert not report.contradictions
    assert report.of('limited')[0].sentence == (
        'drive_2: the effort stays at about 1.2 N m wherever the control law asks for more; '
        'something limits it there'
    )
    assert not examine(tripod(), [recording(1)]).of('limited')


@pytest.mark.parametrize('gain', ['velocity_gain', 'position_gain'])
def test_a_gain_that_every_drive_has_wrong_alike_is_one_of_the_file(gain: str) -> None:
    wrong = tripod().with_constants(**{gain: 0.7 * tripod().number(gain)})
    found = diagnose(wrong, [recording(1)], [recording(2)], seed=1)
    assert found.effect == 'bookkeeping'
    assert gain in found.sentence


def test_a_gain_that_one_drive_has_wrong_is_an_effect() -> None:
    usual = tripod().number('integral_gain')
    wrong = tripod().with_constants(integral_gain=(usual, 4.0 * usual, usual))
    found = diagnose(wrong, [recording(1)], [recording(2)], seed=1)
    assert (found.effect, found.where) == ('integral_gain_error', ('drive_2',))


def test_a_log_in_other_units_that_makes_everything_diverge_is_told_with_the_remedy() -> None:
    def scaled(data: Dataset) -> Dataset:
        fields = ('position', 'velocity', 'command_position', 'command_velocity')
        return replace(data, **{name: 1e3 * getattr(data, name) for name in fields})

    with pytest.raises(IdentError, match='diverges') as error:
        diagnose(tripod(), [scaled(recording(1))], [scaled(recording(2))], seed=1)
    assert 'mm' in str(error.value) or 'unit' in str(error.value)


def test_a_friction_that_lags_behind_the_motion_is_predicted() -> None:
    of: Motion = moves(drives=1)
    at = np.arange(of.position.shape[1])
    late = np.empty(at.size)
    value = 0.0
    for k, wanted in enumerate(np.tanh(of.velocity[0] / 0.005)):
        value += of.cycle / 0.05 * (wanted - value)
        late[k] = value
    found = {c.name: c.columns for c in coordinates(of, 0, at)}
    others = np.hstack([c for name, c in found.items() if name != 'lagging friction'])
    all_of_them = np.hstack([others, found['lagging friction']])

    def left(columns: np.ndarray) -> float:
        rest = late - columns @ np.linalg.lstsq(columns, late, rcond=None)[0]
        return float(rest.std() / late.std())

    assert left(all_of_them) < 0.6 * left(others)


def test_the_catalogue_says_which_parameter_is_an_order() -> None:
    roles = [p.role for p in get_effect('torque_ripple').parameters]
    assert roles == ['size', 'size', 'order']


def slow(data: Dataset, size: float, seed: int, memory: float = 0.99) -> Dataset:
    """Return a log with noise that forgets slowly."""
    effort = np.array(data.effort)
    white = np.random.default_rng(seed).standard_normal(effort.shape)
    coloured = lfilter([size * np.sqrt(1.0 - memory**2)], [1.0, -memory], white, axis=1)
    return replace(data, effort=effort + coloured)


@pytest.mark.parametrize(('bias', 'low', 'high'), [(0.0, 0.0, 3.5), (0.09, 4.0, np.inf)])
def test_a_constant_stands_out_of_slow_noise_only_where_it_is_there(
    bias: float, low: float, high: float
) -> None:
    size, at = 0.06, EffectAt('effort_bias', 'drive_1')
    plain = slow(recording(1), size, 4)
    effort = np.array(plain.effort)
    effort[0] += bias
    case = Case(recordings_of(tripod(), [replace(plain, effort=effort)]))
    fits = Attribution(case, np.full(3, size))
    names = [p.name.rpartition('.')[2] for p in case.fit.with_effects(()).parameters]
    base = fits.refit((), np.array([TRIPOD_TRUTH[n] for n in names]))
    best = fits.refit((at,), np.append(base.theta, 0.0))
    assert abs(best.theta[-1] - bias) < 0.05
    # Taken one by one, the samples say that it is there in any case.
    assert best.cost < base.cost - 400.0
    errors = fits.standing(base, best)
    assert low <= errors < high


@pytest.mark.parametrize(('share', 'held_out'), [(0.45, 'blocks'), (0.55, 'check bag')])
def test_what_one_recording_does_not_show_is_fitted_on_both(
    monkeypatch: pytest.MonkeyPatch, share: float, held_out: str
) -> None:
    # As where the first motion hardly excites some parameters, and the second one does.
    monkeypatch.setattr(
        _Passes,
        '_nominal_leaves',
        lambda self, both, begun: share * begun.explainer.size(begun.base),
    )
    machine = axis()
    motions = [draw_motion('mixed', machine, 3.0, seed) for seed in (1, 2)]
    springs = (Effect('cable_spring', ('emps_axis',), {'stiffness': 100.0, 'place': 0.1}, 'same'),)
    bags = [
        simulate_bag(machine, AXIS_TRUTH, m, seed, nuisance_of(machine), springs)
        for seed, m in enumerate(motions)
    ]
    fit, check = (gather([recording_of(bag)], machine).datasets[0] for bag in bags)
    others = sorted(set(CATALOGUE) - {'cable_spring'})
    found = diagnose(machine, [fit], [check], seed=1, without=others)
    assert found.held_out == held_out
    assert found.effect == 'cable_spring'


def test_what_happens_between_blocks_that_take_turns_counts_too() -> None:
    """A tenth of each second is in neither part, and there something pushed the axis."""
    data = axis_data().datasets[0]
    effort = np.array(data.effort)
    phase = data.cycle * np.arange(data.cycles)
    effort[0, (phase > 1.92) & (phase < 1.98)] += 20.0
    both = Case(recordings_of(axis(), [replace(data, effort=effort)]))
    floor = floor_of(1, axis().effort_noise)
    clock = Clock(0.0, lambda: False, None)
    passes = _Passes(None, (), Rules(), 1, clock, None, Journal(None, ''))
    names = tuple(p.name for p in both.fit.with_effects(()).parameters)
    theta = theta_of(names, AXIS_TRUTH)
    fits = Attribution(both, floor.per_drive)
    fitted = fits.refit((), theta)
    explainer = Explainer(fits, floor, Rules())
    assert explainer.size(fitted) < Rules().material
    begun = SimpleNamespace(explainer=explainer, base=SimpleNamespace(theta=theta))
    assert passes._nominal_leaves(both, begun) > 2.0


def test_threads_that_ask_for_models_side_by_side_do_not_disturb_each_other(monkeypatch):
    """Some are forgotten while others are made; a diagnosis of six joints ended by it."""

    class Slow(dict):
        def __iter__(self):
            keys = super().__iter__()
            time.sleep(1e-3)  # lets another thread in, between finding the oldest and taking it
            return keys

    monkeypatch.setattr(case, 'Joint', lambda part, key: key)
    part = case.Part((), (), _joints=Slow())

    def ask(number):
        return [part.with_effects((number, k)) for k in range(30)]

    with ThreadPoolExecutor(4) as pool:
        asked = list(pool.map(ask, range(4)))
    assert asked == [[(number, k) for k in range(30)] for number in range(4)]
    assert len(part._joints) == case._KEPT
