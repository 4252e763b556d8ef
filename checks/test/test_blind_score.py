# SPDX-License-Identifier: Apache-2.0
import math

from blind_rows import effect, fault, gate, row, table
import numpy as np
import pytest

from checks.blind.page import went_wrong, write_page
from checks.blind.score import (
    calibration,
    confusable_set,
    fault_named,
    right,
    Score,
    score,
    sentences,
)
from checks.share import share_interval


def by_name() -> dict[str, Score]:
    return {s.name: s for s in score(table())}


def test_wilson_is_the_textbook_one() -> None:
    assert all(math.isnan(end) for end in share_interval(0, 0))
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3: 81 of 263 and 0 of 20.
    assert share_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert share_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)


@pytest.mark.parametrize(
    ('name', 'value', 'count'),
    [
        ('false alarms, no effect', 1 / 3, 3),
        ('detected at rho 0.7 (rho 0.55 to 0.9)', 0.0, 1),
        ('detected at rho 3 (rho from 2.4)', 2 / 3, 3),
        # A crash is a miss, the twin of the bias is the bias.
        ('exact effect first, rho from 1.5', 0.5, 4),
        ('effect or its class', 0.75, 4),
        ('confusable set holds the effect', 1.0, 3),
        ('mean size of the set', 5 / 3, 3),
        ('drive right', 1.0, 3),
        ('pairs: one of them first', 1.0, 2),
        ('pairs: both in the first two', 0.5, 2),
        ('pairs: exactly the two', 0.5, 2),
        ('outside the catalogue, flagged', 1.0, 1),
        ('known effects flagged as unknown', 0.0, 4),
        ('not testable, recognised', 0.5, 2),
        ('triples: all in the first three', 1.0, 1),
        ('bookkeeping faults, named before physics', 0.5, 4),
        ('95 % intervals hold the truth, machines imperfect', 2 / 3, 3),
        # An interval that does not exist holds nothing.
        ('95 % intervals hold the truth, noise AR 0.9 or 0.99, stated off by 2.5', 0.5, 2),
        ('95 % intervals hold the truth, machines ideal', 0.5, 2),
        ('share closed, within 0.05 of the truth', 1.0, 3),
        ('its interval covers the truth', 1.0, 3),
        ('diagnoses that failed', 1 / 14, 14),
    ],
)
def test_every_figure_is_what_counting_gives(name: str, value: float, count: int) -> None:
    found = by_name()[name]
    assert found.value == pytest.approx(value)
    assert found.count == count


def test_levels_are_judged_only_where_cases_ask() -> None:
    empty = {s.name: s for s in score([row(1, 'none', [], ('none', ''))])}
    assert empty['exact effect first, rho from 1.5'].reached is None
    assert empty['false alarms, no effect'].reached is True
    assert any('no case' in line for line in sentences(list(empty.values())))


def test_none_is_right_only_where_nothing_material_is_there() -> None:
    small, large = effect('stribeck', 'drive_1', 0.2), effect('stribeck', 'drive_1', 2.0)
    assert right(row(1, 'single', [small], ('none', '')))
    assert not right(row(1, 'single', [large], ('none', '')))
    assert not right(row(1, 'single', [large], ('stribeck', 'drive_2')))
    assert right(row(1, 'single', [large], ('stribeck', 'drive_1')))


def test_the_verdict_counts_once_in_its_set() -> None:
    found = confusable_set(
        row(1, 'single', [], ('stribeck', 'drive_1'), rivals=(('stribeck', 'drive_1'),))
    )
    assert found == [('stribeck', ('drive_1',))]


def test_calibrated_probabilities_have_no_error() -> None:
    rng = np.random.default_rng(1)
    rows = []
    for i in range(4000):
        p = float(rng.uniform(0.05, 0.95))
        good = rng.random() < p
        truth = effect('stribeck', 'drive_1' if good else 'drive_2', 2.0)
        rows.append(row(i, 'single', [truth], ('stribeck', 'drive_1'), p))
    brier, error, bins = calibration(rows)
    assert error < 0.03
    assert brier == pytest.approx(0.1825, abs=0.02)  # mean of p (1 - p)
    assert sum(n for _, _, n in bins) == 4000
    assert math.isnan(calibration([])[0])


def test_page_shows_what_is_missed(tmp_path) -> None:
    rows = table()
    about = {
        'command': 'python -m checks.blind --cases 20 --seed 3',
        'cases': 20,
        'seed': 3,
        'manifest': 'abc',
        'diagnosed': [{'commit': 'cafe', 'sources': 'f00'}, {'commit': 'beef', 'sources': 'ba5'}],
    }
    page = write_page(tmp_path / 'blind.md', rows, score(rows), about)
    text = page.read_text()
    assert 'python -m checks.blind --cases 20 --seed 3' in text
    assert 'at cafe (sources `f00`), then beef' in text and 'of no single commit' in text
    assert '18 of 20 sealed cases' in text
    assert '**missed**' in text and '## Not reached' in text
    for picture in ('detection', 'reliability', 'confusion'):
        assert (tmp_path / 'blind' / f'{picture}.png').stat().st_size > 1000
    wrong = [r['case'] for r in rows if went_wrong(r)]
    assert wrong == [2, 4, 8, 12, 16, 17]


def test_levels_are_those_of_the_generator() -> None:
    rows = [r | {'generator': 'mujoco'} for r in table()]
    name = 'exact effect first, rho from 1.5'
    assert {s.name: s.level for s in score(rows)}[name] == '88 %'
    assert by_name()[name].level == '90 %'


def test_a_fault_named_beside_a_wrong_gain_is_named() -> None:
    wrong = row(
        1,
        'fault',
        [],
        ('velocity_gain_error', 'drive_1'),
        fault=fault('constant', 'velocity gain'),
        gates=[gate('law', 'the velocity gain is 4.4 in the file and 8.6 in the log')],
    )
    assert fault_named(wrong) and right(wrong)
    beside = wrong | {'also': [{'effect': 'stribeck', 'where': ['drive_2']}]}
    assert not fault_named(beside) and not right(beside)
