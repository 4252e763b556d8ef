# SPDX-License-Identifier: Apache-2.0
"""What tells noise from a gap, and one cause from another, where a log is not as expected."""

from dataclasses import replace
from functools import cache

from identify_cases import theta_of, tripod, tripod_log, TRIPOD_TRUTH
import numpy as np
import pytest
from scipy.signal import lfilter

from checks.reference.effects import Effect
from ros2_ident.errors import IdentError
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.fitter import Fitter
from ros2_ident.gap.noise_floor import predictability
from ros2_ident.gap.recordings import recordings_of, Split
from ros2_ident.gates import examine
from ros2_ident.gates.law import fit_law
from ros2_ident.models import EffectAt
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion


@cache
def recording(seed: int, *effects: str) -> Dataset:
    """Return a log of 5 s of the tripod."""
    put = tuple(EFFECTS[name] for name in effects)
    motion = draw_motion('mixed', tripod(), 5.0, seed)
    return tripod_log(motion, seed, put)


EFFECTS = {
    **{
        f'gain {i}': Effect('position_gain_error', (f'drive_{i}',), {'share': share})
        for i, share in enumerate((0.3, 0.34, 0.4), 1)
    },
    'low limit': Effect('torque_saturation', ('drive_2',), {'limit': 1.2}),
}


def louder(data: Dataset, drive: int, size: float, seed: int) -> Dataset:
    """Return a log in which one drive's effort has more noise."""
    effort = np.array(data.effort)
    effort[drive] += size * np.random.default_rng(seed).standard_normal(effort.shape[1])
    return replace(data, effort=effort)


def test_what_one_of_three_like_drives_has_more_than_the_others_is_no_noise() -> None:
    noise = 4.0 * tripod().effort_noise
    joint = Split(recordings_of(tripod(), [louder(recording(1), 1, noise, 5)])).whole
    names = [p.name for p in joint.with_effects(()).parameters]
    # Without the catalogue: what the motion predicts is enough.
    theta = theta_of(names, TRIPOD_TRUTH)
    floor = predictability(joint.with_effects(()), theta, lambda: True)
    assert floor.per_drive == pytest.approx(3 * [tripod().effort_noise], rel=0.1)


def test_a_limit_that_the_file_does_not_know_is_no_other_gain() -> None:
    logs = [recording(seed, 'low limit') for seed in (1, 2)]
    assert fit_law(tripod(), logs[0], 'drive_2').limit == pytest.approx(1.2, abs=0.02)
    report = examine(tripod(), logs)
    assert not report.contradictions
    assert report.of('limited')[0].sentence == (
        'drive_2: the effort stays at about 1.2 N m wherever the control law asks for more; '
        'something limits it there'
    )
    assert not examine(tripod(), [recording(1)]).of('limited')


@pytest.mark.parametrize('limit', [1.0, 0.8, 0.5, 0.3])
def test_a_limit_that_a_drive_hardly_leaves_is_told(limit: float) -> None:
    put = Effect('torque_saturation', ('drive_2',), {'limit': limit})
    log = tripod_log(draw_motion('mixed', tripod(), 5.0, 1), 1, (put,))
    assert log.effort is not None
    # it shows in no sum of squares: where it leaves one the law asks for much within a cycle
    assert np.mean(np.abs(log.effort[1]) > 0.9 * limit) > 0.4
    assert fit_law(tripod(), log, 'drive_2').limit == pytest.approx(limit, abs=0.02)


def test_gains_that_differ_from_drive_to_drive_are_no_number_of_the_file() -> None:
    logs = [recording(seed, 'gain 1', 'gain 2', 'gain 3') for seed in (1, 2)]
    found = diagnose(tripod(), logs[:1], logs[1:], seed=1)
    named = {(found.effect, *found.where), *((at.effect, at.where) for at in found.also)}
    assert named == {('position_gain_error', drive) for drive in tripod().drives}
    # One gain for all closes nearly as much, so that it is given beside them.
    assert 'position_gain' in {constant.key for constant in found.facts.constants}


def test_a_log_in_other_units_that_makes_everything_diverge_is_told_with_the_remedy() -> None:
    def scaled(data: Dataset) -> Dataset:
        fields = ('position', 'velocity', 'command_position', 'command_velocity')
        return replace(data, **{name: 1e3 * getattr(data, name) for name in fields})

    with pytest.raises(IdentError, match='diverges') as error:
        diagnose(tripod(), [scaled(recording(1))], [scaled(recording(2))], seed=1)
    assert 'mm' in str(error.value) or 'unit' in str(error.value)


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
    case = Split(recordings_of(tripod(), [replace(plain, effort=effort)]))
    fits = Fitter(case, np.full(3, size))
    names = [p.name for p in case.fit.with_effects(()).parameters]
    base = fits.refit((), theta_of(names, TRIPOD_TRUTH))
    best = fits.refit((at,), np.append(base.theta, 0.0))
    assert abs(best.theta[-1] - bias) < 0.05
    # Taken one by one, the samples say that it is there in any case.
    assert best.cost < base.cost - 400.0
    errors = fits.standing(base, best)
    assert low <= errors < high
