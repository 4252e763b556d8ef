# SPDX-License-Identifier: Apache-2.0
"""A drive that is told its effort: does it make it, and at which instants does it not?"""

from types import SimpleNamespace
from typing import Any

from identify_cases import joint
import numpy as np
import pytest

from ros2_ident.gap.contradictions import of_events, unexplained
from ros2_ident.gap.result import Facts, Misfit
from ros2_ident.gap.verdict import BOOKKEEPING, Verdict
from ros2_ident.gates import examine, Gate, GateReport
from ros2_ident.gates.asked import Asked, Event, fit_asked
from ros2_ident.identify.data import gather
from ros2_ident.recording import Dataset, Recording, Stream

CYCLE, SECONDS, NOISE = 0.002, 12.0, 0.03
TIME = np.arange(0.0, SECONDS, CYCLE)
LATE, INERTIA = 0.008, 0.05
KNEE = joint('knee', NOISE)


def asked_for(time: np.ndarray) -> np.ndarray:
    out: np.ndarray = 2.0 * np.sin(2.9 * time) + 0.8 * np.sin(9.1 * time + 1.0)
    return out


def recording(
    *pushes: tuple[float, float],
    factor: float = 1.0,
    jitter: float = 0.0,
    held: tuple[float, float] = (0.0, 0.0),
    limit: float = np.inf,
    **command: Any,
) -> Recording:
    """Return a log with pushes (instant, size); between two instants the drive makes nothing."""
    random = np.random.default_rng(4)
    angle, change = np.sin(1.7 * TIME), -(1.7**2) * np.sin(1.7 * TIME)
    effort = factor * asked_for(TIME - LATE) + 0.1 - INERTIA * change
    effort[(held[0] <= TIME) & (held[1] > TIME)] = 0.0
    effort = np.clip(effort, -limit, limit)
    for instant, size in pushes:
        effort += size * np.exp(-(((TIME - instant) / 0.12) ** 2))
    effort += random.normal(0.0, NOISE, TIME.size)
    stamp = np.round(TIME * 1e9).astype(np.int64)
    late = random.uniform(0.0, jitter, TIME.size)
    return Recording(
        Stream(
            ('knee',),
            stamp + np.round(late * 1e9).astype(np.int64),
            position=angle[:, None],
            effort=effort[:, None],
        ),
        command=Stream(('knee',), stamp, effort=asked_for(TIME)[:, None], **command),
        source='a',
    )


def told(found: Recording) -> Asked | None:
    return fit_asked(KNEE, dataset(found), 'knee')


def dataset(found: Recording) -> Dataset:
    return gather((found,), KNEE).datasets[0]


def test_a_drive_makes_what_it_is_asked_for() -> None:
    found = told(recording(factor=0.97))
    assert found is not None
    assert found.late == pytest.approx(LATE, abs=CYCLE)
    assert found.factor == pytest.approx(0.97, abs=0.01)
    assert found.pushes == ()
    report = examine(KNEE, [dataset(recording())])
    assert [g.level for g in report.of('asked')] == ['ok']
    assert not report.of('not_asked')


def test_what_nobody_asked_for_is_told_with_instant_and_size() -> None:
    found = told(recording((3.46, 0.5), (8.31, -0.3)))
    assert found is not None
    assert [p.time for p in found.pushes] == pytest.approx([3.46, 8.31], abs=0.02)
    assert [p.effort for p in found.pushes] == pytest.approx([0.5, -0.3], abs=0.06)
    # What drives make besides is told as without pushes.
    assert found.factor == pytest.approx(1.0, abs=0.01)
    assert found.share > 0.9 and found.certain > 10.0


def test_stamps_that_scatter_are_no_pushes() -> None:
    found = told(recording(jitter=0.0019))
    assert found is not None and found.pushes == ()


def test_a_factor_that_is_off_is_said() -> None:
    (gate,) = examine(KNEE, [dataset(recording(factor=1.3))]).of('asked')
    assert gate.level == 'warn' and 'torque constants' in gate.sentence
    assert gate.number == pytest.approx(1.3, abs=0.02)


def test_a_drive_that_is_limited_is_not_pushed() -> None:
    # The command asks for up to 2.8 N m: twice for more than 2.77, often for more than 2.2.
    for limit in (2.77, 2.2):
        report = examine(KNEE, [dataset(recording(limit=limit))])
        (gate,) = report.of('limited')
        assert gate.number == pytest.approx(limit, abs=0.1)
        assert not report.of('not_asked') and report.of('asked')


def test_a_drive_that_does_something_else_is_not_called_pushed() -> None:
    assert told(recording(held=(2.0, 8.0))) is None


def test_pushes_are_said_of_every_recording() -> None:
    logs = [dataset(recording()), dataset(recording((5.0, 0.6)))]
    report = examine(KNEE, logs)
    (gate,) = report.of('not_asked')
    assert gate.sentence.startswith('recording 2: knee: effort that was not commanded')
    assert '5.00 s (+0.6 N m)' in gate.sentence
    assert gate.level == 'warn'


MISFIT = Misfit('knee', 'effort', 1.0, 0.5, 9.0, extended=False)


def verdict(effect: str) -> Verdict:
    return Verdict(effect, ('all',), 0.5, (), (), (), 0.3, facts=Facts(misfit=MISFIT))


def test_pushes_come_before_what_a_model_misses() -> None:
    pushes = (Event('knee', 2, 1.5, 0.7), Event('knee', 2, 4.25, -0.4))
    asked = Asked('knee', 0.01, 1.0, 0.02, pushes, 0.9, 0.2, 12.0, 400)
    report = GateReport(asked=((), (asked,)))
    found = of_events(verdict('stribeck'), report)
    assert (found.effect, found.where, found.named) == ('unknown', ('knee',), ())
    assert found.facts.events == pushes
    assert not found.facts.misfit and found.probability > 0.9
    # A wrong unit or sign makes all efforts wrong.
    assert of_events(verdict(BOOKKEEPING), report).effect == BOOKKEEPING
    assert of_events(verdict('none'), GateReport(asked=((),))).effect == 'none'


@pytest.mark.parametrize(
    ('before', 'after', 'events'),
    [(0.0, 0.0, 2), (0.0, 0.5, 2), (0.0, 0.9, 0), (-0.4, 0.75, 0), (1.0, 1.0, 2), (0.9, 1.0, 2)],
)
def test_efforts_that_what_was_found_makes_are_none_that_somebody_added(
    before: float, after: float, events: int
) -> None:
    """Share of them that the models make without and with it; where both do, it says nothing."""
    # a drive that is limited makes less than its law asks for
    pushes = (Event('knee', 1, 0.3, -0.8, 0.4), Event('knee', 1, 0.7, -0.8))
    effort = np.zeros((1, 1000))
    effort[0, 290:410] = effort[0, 690:711] = -0.8
    model: Any = SimpleNamespace(
        cycle=0.001, places=('knee',), outputs=(SimpleNamespace(quantity='effort'),),
        measured=effort, simulate=lambda theta: theta[:, :, None] * effort[None],
    )  # fmt: skip
    gate = Gate('not_asked', 'knee', 'warn', 0.3, 's', 'knee: effort that was not commanded')
    asked = Asked('knee', 0.0, np.nan, 0.02, pushes, 0.9, 0.2, 12.0, 400)
    report = GateReport((gate,), asked=((asked,),))
    left = unexplained(report, [(model, np.array([before]))], [(model, np.array([after]))])
    assert len(left.pushes) == events
    assert bool(left.gates) == bool(events)
