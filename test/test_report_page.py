# SPDX-License-Identifier: Apache-2.0
"""The page on a result directory, without a browser: what it holds and what it leaves out."""

from dataclasses import replace
from html.parser import HTMLParser
import json
import math
import re

from bokeh.models import GlyphRenderer
import numpy as np
import pytest
from report_cases import (
    diagnosed,
    identified,
    long_signals,
    write_diagnosed,
    write_identified,
)

from ros2_ident.cli.main import main
from ros2_ident.cli.report import print_page
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.result import Outcome
from ros2_ident.report.files import write_result
from ros2_ident.report.page import write_report
from ros2_ident.report.page.effort import effort_plot, extremes
from ros2_ident.report.page.plots import one_a_cell
from ros2_ident.report.page.sentences import number, of_diagnosis, of_identification
from ros2_ident.report.signals import load_signals, write_signals

SECTIONS = ['answer', 'effort', 'parameters', 'search', 'correlations', 'gap', 'provenance']
LIMIT = 5_000_000


class Page(HTMLParser):
    """What a page holds, as a browser would find it before any script runs."""

    def __init__(self, path):
        super().__init__()
        self.sections, self.values, self.links, self.pictures = [], {}, [], []
        self.text = ''
        self._plot = self._code = False
        self.feed(path.read_text(encoding='utf-8'))

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if tag == 'section':
            self.sections.append(attrs['id'])
        if 'data-of' in attrs:
            self.values[attrs['data-of']] = attrs['data-value']
        self.links += [attrs[name] for name in ('src', 'href', 'data', 'action') if name in attrs]
        self._plot = tag == 'script' and attrs.get('class') == 'plot'
        self._code = tag in ('script', 'style')

    def handle_endtag(self, tag):
        self._plot = self._code = False

    def handle_data(self, data):
        if self._plot:
            self.pictures.append(json.loads(data)['target_id'])
        elif not self._code:
            self.text += ' '.join(data.split()) + ' '


@pytest.fixture(scope='module')
def both(tmp_path_factory):
    folder = tmp_path_factory.mktemp('run')
    write_identified(folder)
    write_diagnosed(folder)
    return write_report(folder)


def test_every_section_is_there_and_every_picture(both):
    page = Page(both)
    assert page.sections == SECTIONS
    assert page.pictures == [
        'effort-plot',
        'generations-plot',
        'costs-plot',
        'correlations-plot',
        'waterfall-plot',
        'ranking-plot',
        'maps-plot',
        'gap-effort-plot',
    ]
    assert both.stat().st_size < LIMIT


def test_the_page_needs_nothing_else(both):
    """The library names addresses in its code; the policy forbids the browser to follow them."""
    page = Page(both)
    assert {link for link in page.links if not link.startswith('#')} == {'data:,'}
    assert "default-src 'none'" in both.read_text()


def test_the_numbers_of_the_table_are_those_of_the_files(both):
    page = Page(both)
    result = json.loads((both.parent / 'result.json').read_text())
    diagnosis = json.loads((both.parent / 'diagnosis.json').read_text())
    for name, entry in [*result['parameters'].items(), *diagnosis['parameters'].items()]:
        assert float(page.values[name]) == entry['value']
        for key in ('value', 'low', 'high'):
            assert f' {number(entry[key])} ' in page.text
    assert number(result['cost']['refined']) in page.text
    assert f'seed {result["seed"]} ' in page.text and f'seed {diagnosis["seed"]} ' in page.text
    assert result['provenance']['machine_sha256'] in page.text
    assert diagnosis['verdict']['sentence'] in page.text
    for finding in diagnosis['localisation']:
        assert finding['sentence'].replace('^2', '²').replace('^3', '³') in page.text


def test_what_a_file_holds_cannot_be_read_as_html(both):
    assert 'Record a motion with <slow> reversals.' in Page(both).text


def test_a_directory_with_an_identification_only(tmp_path):
    write_identified(tmp_path)
    page = Page(write_report(tmp_path))
    assert page.sections == SECTIONS
    assert 'This directory holds no diagnosis; ident diagnose' in page.text
    assert 'waterfall-plot' not in page.pictures


def test_a_directory_with_a_diagnosis_only(tmp_path):
    write_diagnosed(tmp_path)
    page = Page(write_report(tmp_path))
    assert page.sections == ['answer', 'gap', 'provenance']
    assert 'holds a diagnosis and no identification; ident identify' in page.text
    assert page.pictures == ['waterfall-plot', 'ranking-plot', 'maps-plot', 'gap-effort-plot']


def test_a_result_of_an_older_version(tmp_path):
    write_result(tmp_path, identified())
    (tmp_path / 'history.npz').unlink()
    (tmp_path / 'result.json').unlink()
    page = Page(write_report(tmp_path))
    assert 'No simulated effort was kept' in page.text
    assert page.pictures == ['generations-plot', 'correlations-plot']


def test_a_diagnosis_without_its_effort(tmp_path):
    write_diagnosed(tmp_path)
    (tmp_path / 'diagnosis.npz').unlink()
    data = json.loads((tmp_path / 'diagnosis.json').read_text())
    for name in ('maps', 'provenance', 'settings'):
        del data[name]
    (tmp_path / 'diagnosis.json').write_text(json.dumps(data))
    page = Page(write_report(tmp_path))
    assert page.pictures == ['waterfall-plot', 'ranking-plot']


def test_a_run_in_which_every_candidate_diverged(tmp_path):
    good = identified()
    write_identified(tmp_path)
    lost = replace(
        good,
        outcome=Outcome.DIVERGED,
        message='Every candidate diverged; narrow the bounds in the machine file.',
        parameters=tuple(
            replace(p, value=math.nan, low=math.nan, high=math.nan, identifiable=False)
            for p in good.parameters
        ),
        correlation=np.full_like(good.correlation, math.nan),
        cost=replace(good.cost, ga=math.inf, refined=math.nan),
        residuals=(),
        history=replace(
            good.history,
            best_costs=np.full(good.history.best_costs.shape, math.inf),
            costs=np.full(good.history.costs.shape, math.inf),
        ),
    )
    write_identified(tmp_path, lost)
    assert not (tmp_path / 'signals.npz').exists()
    page = Page(write_report(tmp_path))
    assert page.pictures == []
    assert 'Every candidate diverged; narrow the bounds' in page.text
    assert 'there is no cost to show' in page.text


def test_a_cancelled_run_and_a_diagnosis_cut_short(tmp_path):
    good = identified()
    message = 'The run was cancelled; the values are the best found until then.'
    cut = replace(
        good,
        outcome=Outcome.CANCELLED,
        message=message,
        parameters=tuple(
            replace(p, low=math.nan, high=math.nan, identifiable=False) for p in good.parameters
        ),
        correlation=np.full_like(good.correlation, math.nan),
        cost=replace(good.cost, refined=math.nan),
    )
    write_identified(tmp_path, cut)
    found = diagnosed()
    write_diagnosed(
        tmp_path,
        replace(
            found, effect='unknown', where=(), probability=0.0, ranking=(), localisation=(),
            steps=found.steps[:1], complete=False,
        ),
    )
    page = Page(write_report(tmp_path))
    assert message in page.text
    assert 'The diagnosis was cut short' in page.text
    assert 'The correlations are not known' in page.text
    assert page.pictures == [
        'effort-plot', 'generations-plot', 'costs-plot', 'waterfall-plot', 'gap-effort-plot',
    ]


def test_parameters_at_a_bound_or_not_told_apart_are_said():
    good = identified()
    first, *rest = good.parameters
    close = np.eye(len(good.parameters))
    close[0, 1] = close[1, 0] = -0.99
    doubtful = replace(
        good,
        parameters=(replace(first, value=first.upper_bound, at_bound=True), *rest),
        correlation=close,
    )
    said = of_identification(doubtful)
    assert said[0].level == 'doubtful'
    warnings = [s.text for s in said if s.level == 'warning']
    assert any(f'{first.name} is at its upper bound' in text for text in warnings)
    assert any(f'{first.name} with {rest[0].name} (−0.99)' in text for text in warnings)
    clear = [s.text for s in of_identification(replace(good, correlation=np.eye(4)))]
    assert not any('hardly tells apart' in text for text in clear)
    assert any('No parameter is known better than' in text for text in clear)


def test_a_diagnosis_says_what_moves_and_what_cannot_be_seen(both):
    data = json.loads((both.parent / 'diagnosis.json').read_text())
    said = of_diagnosis(data)
    assert said[0].text.endswith('Probability 93 %.')
    assert any('drive_1.coulomb_torque by −38 %' in s.text for s in said)
    assert any(s.text.startswith('This motion cannot show: ') for s in said)


def test_the_bar_beside_a_diagnosis_is_green_only_where_nothing_is_to_be_careful_about(both):
    data = json.loads((both.parent / 'diagnosis.json').read_text())
    assert of_diagnosis(data)[0].level == 'doubtful'
    assert of_diagnosis({**data, 'complete': False})[0].level == 'bad'
    nothing = {
        **data,
        'complete': True,
        'verdict': {**data['verdict'], 'effect': 'none'},
        'gates': [],
        'confusable': [],
    }
    assert of_diagnosis(nothing)[0].level == 'good'


def test_the_page_keeps_room_for_a_picture_until_it_is_drawn(both):
    text = both.read_text()
    for name in Page(both).pictures:
        (height,) = re.findall(f'<div id="{name}" style="min-height: ([0-9]+)px">', text)
        assert int(height) > 80, name


def test_no_line_ends_before_a_percent_sign(both):
    said = re.findall('<p class="(?:headline|plain|warning)">(.*?)</p>', both.read_text())
    assert said and not any(' %' in text for text in said)


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (231680.4, '231680'),
        (8.89412e-5, '8.8941·10⁻⁵'),
        (-3.1625, '−3.1625'),
        (0.0, '0'),
        (99999.99, '100000'),
        (1.5e9, '1.5·10⁹'),
        (math.nan, '–'),
        (None, '–'),
    ],
)
def test_numbers_for_people(value, text):
    assert number(value) == text


def test_long_logs_of_many_drives_stay_below_the_limit(tmp_path):
    write_identified(tmp_path)
    write_diagnosed(tmp_path)
    signals = long_signals(300_000, drives=6)
    for name in ('signals.npz', 'diagnosis.npz'):
        write_signals(tmp_path / name, signals)
    page = write_report(tmp_path)
    assert 0.5 * LIMIT < page.stat().st_size < LIMIT
    assert Page(page).text.count('of 300000 samples') == 2


def test_thinning_keeps_the_extremes():
    signals = long_signals()
    rows = signals.recordings[0].measured
    kept = extremes(rows, 500)
    assert 61_800 in kept
    assert kept.size <= 2 * 500 * len(rows)
    assert rows[:, kept].min(axis=1) == pytest.approx(rows.min(axis=1))
    holes = np.where(np.arange(rows.shape[1]) % 2, rows, np.nan)
    assert np.isfinite(holes[0, extremes(holes[:1], 500)]).all()
    assert extremes(rows[:, :400], 500).tolist() == list(range(400))


@pytest.mark.filterwarnings('error')
def test_a_drive_without_samples_and_one_that_diverged():
    signals = long_signals(2000)
    (log,) = signals.recordings
    log.measured[1] = np.nan
    log.simulated[0, 2, 1000:] = np.inf
    drawn = effort_plot(signals).plot.select({'type': GlyphRenderer})
    curves = [renderer.data_source.data for renderer in drawn]
    sizes = [len(c['x']) for c in curves if 'x' in c]
    assert 0 in sizes and max(sizes) >= 1000
    assert all(np.isfinite(c['y']).all() for c in curves if 'y' in c)


def test_one_dot_stands_for_many():
    x, y = np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 1e-9, 1.0, 0.5])
    assert one_a_cell(x, y).tolist() == [1, 2, 3]
    assert one_a_cell(np.ones(3), np.ones(3)).tolist() == [2]


def test_signals_come_back_as_they_were(tmp_path):
    signals = long_signals(1000)
    back = load_signals(write_signals(tmp_path / 'signals.npz', signals))
    assert (back.unit, back.drives, back.models) == (signals.unit, signals.drives, signals.models)
    for one, two in zip(back.recordings, signals.recordings, strict=True):
        assert one.title == two.title
        assert (one.time == two.time).all()
        assert (one.measured == two.measured).all() and (one.simulated == two.simulated).all()


def test_other_files_are_refused(tmp_path):
    path = tmp_path / 'signals.npz'
    path.write_bytes(b'no')
    with pytest.raises(IdentError, match='is damaged') as caught:
        load_signals(path)
    assert caught.value.code is ErrorCode.BAD_VALUES
    np.savez(path, schema='ros2_ident.signals', version=2)
    with pytest.raises(IdentError, match='of version 2 and this package reads'):
        load_signals(path)
    with pytest.raises(IdentError, match='holds neither result.json nor diagnosis.json') as caught:
        write_report(tmp_path)
    assert caught.value.code is ErrorCode.NO_DATA
    (tmp_path / 'diagnosis.json').write_text('{"schema": 7, "verdict": {}}')
    with pytest.raises(IdentError, match='is no diagnosis of version 1'):
        write_report(tmp_path)


def test_the_command(tmp_path, capsys):
    write_identified(tmp_path / 'run')
    assert main(['report', str(tmp_path / 'run'), '--page', str(tmp_path / 'x' / 'y.html')]) == 0
    assert (tmp_path / 'x' / 'y.html').exists()
    print_page(tmp_path / 'run', wanted=True)
    assert f'page: {tmp_path / "run" / "report.html"}' in capsys.readouterr().out
    print_page(tmp_path / 'run', wanted=False)
    assert not (tmp_path / 'run' / 'report.html').exists()
    assert main(['report', str(tmp_path / 'nowhere')]) == 2
    assert 'give a directory that `ident identify`' in capsys.readouterr().err
