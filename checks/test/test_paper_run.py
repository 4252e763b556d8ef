# SPDX-License-Identifier: Apache-2.0
"""The paper's page: complete and repeatable, and its numbers are those of the trials."""

from dataclasses import replace

import numpy as np
import pytest

from checks.paper import run
from checks.paper.belt import (
    belt_machine,
    eigenfrequencies_over_position,
    identify,
    local_minima,
    OURS,
    PAPER_SETTINGS,
    step_reference,
    Trial,
    TRUTH,
)
from checks.paper.page import belt_section
from checks.paper.tripod_runs import Plan
from ros2_ident.models.belt_drive.model import BeltDrive
from ros2_ident.search import GeneticSettings

# A log of the least length that still moves, and a search that only has to run through.
QUICK = Plan(
    seconds=1.5,
    close=(0.8, 1.2),
    genetic=GeneticSettings(initial_population=64, survivors=4, children=4, generations=3),
)


@pytest.fixture(scope='module')
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp('paper')
    seen = []
    page = run.run(folder, lambda part, text: seen.append((part, text)), seeds=1, plan=QUICK)
    return folder, page.read_text(encoding='utf-8'), seen


def test_page_and_pictures_are_written(out):
    folder, page, _ = out
    for number in range(4, 14):
        if number == 10:
            continue  # a photograph of their robot
        assert f'paper/figure_{number}.png' in page
        assert (folder / 'paper' / f'figure_{number}.png').stat().st_size > 10_000
    assert page.count('\n## ') == 2
    assert not set('{}').intersection(page)
    assert 'nan' not in page.replace('resonance', '')


def test_progress_rises_to_one(out):
    parts = [part for part, _ in out[2]]
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert all(text for _, text in out[2])


def test_settings_are_those_of_table_2():
    for (survivors, distance), settings in PAPER_SETTINGS.items():
        assert settings.evaluations == 1000 + 11 * 8 * survivors
        assert settings.min_distance == distance
        assert settings.range_reduction == 0.5
        assert settings.first_step == 1.0
        assert settings.first_generation == 'uniform'
    assert OURS.evaluations <= 2760


def test_figure_4_is_in_the_papers_range():
    first = eigenfrequencies_over_position(np.linspace(0.0, 0.7, 29))[:, 0]
    assert first.min() == pytest.approx(67.9, abs=0.1)
    assert first.max() == pytest.approx(81.7, abs=0.1)
    assert (np.diff(first) < 0.0).all()


def test_the_cost_has_many_local_minima():
    assert local_minima(BeltDrive(belt_machine(), *step_reference())) > 30


def test_recorded_candidates_are_all_of_them():
    belt = BeltDrive(belt_machine(), *step_reference(duration=0.2))
    trial = identify(belt, TRUTH, PAPER_SETTINGS[8, 0.0], 0, record=True)
    assert len(trial.points) == len(trial.costs) == trial.evaluations == 1704
    assert trial.costs.min() == trial.cost


def stand_in(found, count):
    none = np.empty((0, 2))
    near, far = TRUTH * 1.001, TRUTH * np.array([1.2, 1.1])
    return [
        Trial(TRUTH, near if i < found else far, 0.0, 100, none, np.empty(0)) for i in range(count)
    ]


def findings(harm):
    base = run.BeltFindings(
        frequencies=(67.9, 81.7),
        modes=(75.4, 272.8, 400.3),
        minima=41,
        largest_torque=0.2,
        close_torque=0.06,
        rates={},
    )
    full = stand_in(90, 100), stand_in(90, 100)
    rates = dict.fromkeys(PAPER_SETTINGS, full)
    rates[8, 0.5] = stand_in(20 if harm else 90, 100), full[1]
    return replace(base, rates=rates)


def test_numbers_are_those_of_the_trials():
    harmless, harmful = belt_section(findings(False)), belt_section(findings(True))
    assert '| 8 | 0.5 | 100 | 90 % (83 to 94) |' in harmless
    assert '| 8 | 0.5 | 100 | 20 % (13 to 29) |' in harmful
    assert 'farther than 10 % from EA | 80 of 80 |' in harmful
    assert "as near as the paper's run | 0 of 100 |" in harmful
