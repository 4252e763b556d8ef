# SPDX-License-Identifier: Apache-2.0
"""A payload that is taken up and put down again and again: when, and how heavy."""

from dataclasses import replace

from identify_cases import theta_of, tripod, tripod_log, TRIPOD_TRUTH
import numpy as np
import pytest

from checks.blind.label import MotionOrder
from checks.reference import layout
from ros2_ident.gap.fitter import Fitter
from ros2_ident.gap.recordings import recordings_of, Split
from ros2_ident.gap.suspects.payload import find_pick_ups
from ros2_ident.models import EffectAt
from ros2_ident.recording import Dataset

MASS, NOISE = 0.5, tripod().effort_noise
TIMES = {1: (0.8, 1.9, 2.6, 3.9, 4.6, 5.4), 2: (0.5, 1.2, 2.2, 3.1, 4.0, 5.2)}


class Gripped:
    """A load in the reference's columns: from when to when, in turns."""

    def __init__(self, mass: float, times: tuple[float, ...]) -> None:
        self.mass, self.times = mass, times

    def apply(self, plant) -> None:
        plant.shared[layout.PAYLOAD] = self.mass
        plant.shared[layout.PAYLOAD_RAMP] = 0.06
        plant.shared[layout.PAYLOAD_FROM : layout.PAYLOAD_FROM + len(self.times)] = self.times


def recording(seed: int, mass: float = MASS) -> Dataset:
    motion = MotionOrder('multi_point', 6.0, seed, 0.5).draw(tripod())
    effects = [Gripped(mass, TIMES[seed])] if mass else []
    return tripod_log(motion, seed, effects)


def turns(*data: Dataset) -> tuple[np.ndarray, ...]:
    models = recordings_of(tripod(), data)
    joint = Split(models).whole.with_effects(())
    theta = theta_of([p.name for p in joint.parameters], TRIPOD_TRUTH)
    return find_pick_ups(joint, theta, np.full(3, NOISE))


def test_the_log_tells_when_a_payload_is_carried() -> None:
    data = recording(1), recording(2)
    found = turns(*data)
    for held, seed, one in zip(found, (1, 2), data, strict=True):
        jumps = np.flatnonzero(np.diff(held > 0.5)) * one.cycle
        assert jumps == pytest.approx(TIMES[seed], abs=0.1)


def test_without_a_payload_the_log_tells_of_none() -> None:
    assert turns(recording(1, 0.0), recording(2, 0.0)) == ()


def test_a_payload_shared_with_friction_on_one_drive_only_is_none() -> None:
    data = recording(1, 0.0)
    time = np.arange(data.cycles) * data.cycle
    pulses = 0.3 * ((time > 1.0) & (time < 2.0) | (time > 3.0) & (time < 4.0))
    effort = np.array(data.effort)
    effort[0] += pulses
    assert turns(replace(data, effort=effort)) == ()


def test_the_turns_give_the_payload_its_mass() -> None:
    case = Split(recordings_of(tripod(), [recording(1), recording(2)]))
    floor = np.full(3, NOISE)
    joint = case.whole.with_effects(())
    theta = theta_of([p.name for p in joint.parameters], TRIPOD_TRUTH)
    held = find_pick_ups(joint, theta, floor)
    at = EffectAt('payload_turns', 'all')
    fits = Fitter(case.carrying(held), floor)
    before = fits.refit((at,), np.append(theta, 0.0))
    # Again, with the instants sharper, as a diagnosis does.
    sharper = find_pick_ups(joint, before.theta[: theta.size], floor)
    found = Fitter(case.carrying(sharper), floor).refit((at,), before.theta)
    # Its interval does not know how sharp the instants are.
    assert found.theta[-1] == pytest.approx(MASS, rel=0.05)
