# SPDX-License-Identifier: Apache-2.0
"""The page on a result directory, without a browser: what it holds and what it leaves out."""

from dataclasses import asdict, replace
from html.parser import HTMLParser
import json
import math

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
from ros2_ident.cli.runs import page_line
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.result import Cause, Facts
from ros2_ident.gates import Gate
from ros2_ident.identify.result import Outcome
from ros2_ident.recording import LIVE
from ros2_ident.report.diagnosis import from_mapping, load_diagnosis, to_mapping
from ros2_ident.report.estimate import read_estimate
from ros2_ident.report.page import write_report
from ros2_ident.report.page.answer import of_diagnosis, of_identification
from ros2_ident.report.page.numbers import (
    from_to,
    number,
    plus_minus,
)
from ros2_ident.report.page.several import write_comparison
from ros2_ident.report.signals import load_signals, write_signals

DIAGNOSED = ['where', 'gap', 'time', 'values']
IDENTIFIED = ['effort', 'parameters', 'search', 'correlations']
LIMIT = 5_000_000


class Page(HTMLParser):
    """What a page holds, as a browser would find it before any script runs."""

    def __init__(self, path):
        super().__init__()
        self.sections, self.values, self.links, self.pictures = [], {}, [], []
        self.text = ''
        self._code = False
        self.feed(path.read_text(encoding='utf-8'))

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if attrs.get('class') == 'drawn' and 'id' in attrs:
            self.pictures.append(attrs['id'])
        if tag == 'section':
            self.sections.append(attrs['id'])
        if 'data-of' in attrs:
            self.values[attrs['data-of']] = attrs['data-value']
        self.links += [attrs[name] for name in ('src', 'href', 'data', 'action') if name in attrs]
        self._code = tag in ('script', 'style')

    def handle_endtag(self, tag):
        self._code = False

    def handle_data(self, data):
        if not self._code:
            self.text += ' '.join(data.split()) + ' '


@pytest.fixture(scope='module')
def both(tmp_path_factory):
    folder = tmp_path_factory.mktemp('run')
    write_identified(folder)
    write_diagnosed(folder)
    return write_report(folder)


def test_every_section_is_there_and_every_picture(both):
    page = Page(both)
    assert page.sections == ['answer', *DIAGNOSED, *IDENTIFIED, 'about', 'provenance']
    assert page.pictures == [
        'gap-effort-plot',
        'effort-plot',
        'costs-plot',
    ]
    assert both.stat().st_size < LIMIT
    assert '<p class="state"><i></i>Clear answer</p>' in both.read_text()


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


@pytest.mark.parametrize(
    ('write', 'lost', 'sections', 'pictures', 'text'),
    [
        (
            write_identified, (), IDENTIFIED,
            ['effort-plot', 'costs-plot'],
            'ident diagnose test --machine MACHINE.yaml --out ',
        ),
        # a result of an older version
        (
            write_identified, ('history.npz', 'signals.npz'), IDENTIFIED,
            [], 'No simulated effort was kept',
        ),
        (write_diagnosed, (), [*DIAGNOSED, 'about'], ['gap-effort-plot'], 'of the effort'),
        (
            write_diagnosed, ('diagnosis.npz',), [*DIAGNOSED, 'about'], [],
            'Nothing simulated was kept',
        ),
    ],
)  # fmt: skip
def test_a_page_shows_what_the_directory_holds(tmp_path, write, lost, sections, pictures, text):
    write(tmp_path)
    for name in lost:
        (tmp_path / name).unlink()
    page = Page(write_report(tmp_path))
    assert page.sections == ['answer', *sections, 'provenance']
    assert page.pictures == pictures
    assert text in page.text


def unknown(**more):
    """Return the parameters of a run that determined none."""
    none = {'low': math.nan, 'high': math.nan, 'state': 'not determined', **more}
    return tuple(replace(p, **none) for p in identified().parameters)


def test_a_run_in_which_every_candidate_diverged(tmp_path):
    good = identified()
    write_identified(tmp_path)
    lost = replace(
        good,
        outcome=Outcome.DIVERGED,
        parameters=unknown(value=math.nan),
        correlation=math.nan * good.correlation,
        cost=replace(good.cost, ga=math.inf, refined=math.nan),
        residuals=(),
        history=replace(
            good.history,
            best_costs=np.full_like(good.history.best_costs, math.inf),
            costs=np.full_like(good.history.costs, math.inf),
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
    cut = replace(
        good,
        outcome=Outcome.CANCELLED,
        parameters=unknown(),
        correlation=math.nan * good.correlation,
        cost=replace(good.cost, refined=math.nan),
    )
    write_identified(tmp_path, cut)
    found = diagnosed()
    write_diagnosed(
        tmp_path,
        replace(
            found,
            effect='unknown',
            where=(),
            probability=0.0,
            ranking=(),
            localisation=(),
            steps=found.steps[:1],
            complete=False,
            facts=Facts(Cause.CUT_SHORT, 'drive_1', 'N m'),
        ),
    )
    page = Page(write_report(tmp_path))
    assert 'The run was cancelled; the values are the best found until then' in page.text
    assert 'The run was cut short' in page.text
    assert 'The correlations are not known' in page.text
    assert page.pictures == ['gap-effort-plot', 'effort-plot', 'costs-plot']


def screen(said):
    """What a reader finds on the first screen, line by line."""
    steps = [f'{s.text} {[law.effect.id for law in s.laws]} {s.code}' for s in said.steps]
    gaps = [f'{gap.drive} {gap.note}' for gap in said.gaps]
    parts = (said.first, [said.headline], said.sure, gaps, said.closes, steps)
    return '\n'.join([said.state, *(line for part in parts for line in part), *said.careful])


def gate(text, level='warn', drive='drive_1', cause=''):
    return asdict(Gate('sign', drive, level, math.nan, '1', f'{drive}: {text}', cause=cause))


def at(effect, where='drive_1'):
    alone = {'probability': 0.1, 'gap_after': None, 'share': None, 'parameters': {}}
    return {'effect': effect, 'where': [where], **alone}


UNSURE = 'Answer with reservations'
OF_DIAGNOSIS = {
    'clear': ({}, 'good', ['Clear answer'], ['ident export']),
    'warning': ({'gates': [gate('odd.')]}, 'doubtful', [UNSURE], []),
    'rest': (
        {'evidence': {'remaining': 1.2}}, 'doubtful',
        [UNSURE, 'No effect of the catalogue explains the rest.'], [],
    ),
    'rival': (
        {'confusable': [at('stribeck'), at('backlash')]}, 'doubtful',
        [UNSURE], [],
    ),
    'cut short': ({'complete': False}, 'bad', ['No clear answer yet'], []),
    'contradiction': (
        {'gates': [gate('the gain is twice that.', 'fail')]}, 'bad',
        ['Correct this first:\ndrive_1: the gain is twice that.\n'], [],
    ),
    'refused': (
        {
            'gates': [{**gate('odd.', 'fail'), 'contradicts': True}], 'confusable': [],
            'verdict': {'effect': 'bookkeeping'}, 'facts': {'cause': 'log', 'contradictions': [0]},
        }, 'bad',
        ['\nLog and machine file contradict each other', '\ndrive_1: odd. No effect is named.\n',
         'ident check bags/fit --machine MACHINE'],
        ['ident diagnose'],
    ),
    # of another cause they stay apart, however alike their words are
    'like warnings': (
        {'gates': [gate('0 ms off.', cause='late'), gate('1 ms off.', 'warn', 'drive_2', 'late'),
                   gate('2 ms off.', 'warn', 'drive_3', 'early')]}, 'doubtful',
        ['\ndrive_1: 0 ms off. (likewise drive_2)\ndrive_3: 2 ms off.'], ['1 ms off'],
    ),
    'what only the log shows is not to be simulated': (
        {'also': [at('effort_delay', 'all')]}, 'good',
        ["Add to your simulation, together with the parameters below: ['stribeck']",
         "Correct how the log is made; a simulation of the machine does not need this: "
         "['effort_delay']"], [],
    ),
    'live': (
        {'provenance': {'source': LIVE}}, 'good',
        ['ident diagnose BAG --check NEW_BAG --machine MACHINE.yaml --out out_next'], [],
    ),
    'one command for a simulator': (
        {'settings': {'machine_file': 'my.yaml'}}, 'good',
        ['ident export out --out out_simulator'], [],
    ),
}  # fmt: skip


def found_in(said, level, there, absent):
    """Judge a first screen by what has to be on it and what may not."""
    text = screen(said)
    assert said.level == level, text
    assert [line for line in there if line not in text] == [], text
    assert [line for line in absent if line in text] == [], text


@pytest.mark.parametrize('case', OF_DIAGNOSIS)
def test_the_first_screen_of_a_diagnosis(both, case):
    changes, *wanted = OF_DIAGNOSIS[case]
    data = json.loads((both.parent / 'diagnosis.json').read_text())
    for key, value in changes.items():
        data[key] = {**data[key], **value} if isinstance(value, dict) else value
    found_in(of_diagnosis(from_mapping(data), 'out'), *wanted)


def of_identifications():
    """Yield changes of a good result, its level, what is to be found, and what is not."""
    good = identified()
    first, *rest = good.parameters
    apart, close = np.eye(4), np.eye(4)
    close[0, 1] = close[1, 0] = -0.99
    end = replace(first, value=first.upper_bound, at_bound=True)
    yield {'parameters': (end, *rest), 'correlation': close}, 'doubtful', [
        f'{first.name} (', 'lies at a bound: the true value',
        f'{first.name} and {rest[0].name} (−0.99)',
    ], []  # fmt: skip
    yield {'correlation': apart}, 'good', ['All 4 parameters are identified.'], [
        'hardly separates', 'ident export',
    ]  # fmt: skip
    loose = replace(first, state='not determined', hidden=True)
    lost = {'outcome': Outcome.NOT_IDENTIFIABLE, 'parameters': (loose, *rest)}
    yield lost, 'bad', [
        '\nThis data does not determine 1 of 4 parameters.\n'
        f'Not determined: {loose.name}; the model lacks something',
    ], []  # fmt: skip
    yield {**lost, 'rival': (1.0, 2.0, 3.0, 4.0)}, 'bad', ['\nThe cost has several minima '], []
    unseen = tuple(replace(x, rms=2.0 * x.rms, share=0.07) for x in good.residuals)
    yield {'validation': unseen, 'validated_on': 'bags/other'}, 'good', [
        'emps_axis held out 7 %', '\nHeld out: bags/other.\n',
    ], []  # fmt: skip
    yield {'validation': ()}, 'good', [], ['eld out']
    known = {'settings': {**good.settings, 'machine_file': 'my.yaml'}}
    yield known, 'good', ['ident export out --out out_simulator'], []


def test_the_first_screen_of_an_identification():
    for changes, *wanted in of_identifications():
        found_in(of_identification(replace(identified(), **changes), 'out'), *wanted)


@pytest.mark.parametrize(
    ('made', 'text'),
    [
        (number(231680.4), '231680'),
        (number(8.89412e-5), '8.8941·10⁻⁵'),
        (number(-3.1625), '−3.1625'),
        (number(0.0), '0'),
        (number(1.5e9), '1.5·10⁹'),
        (number(math.nan), '–'),
        (number(None), '–'),
        (plus_minus(0.99962, 0.99918, 1.00006, '1'), '0.99962 ± 0.00044'),
        (plus_minus(-0.93, -1.13, -0.73, 'N m'), '−0.93 ± 0.20 N m'),
        (plus_minus(2.4e-6, 2.09e-6, 2.71e-6, 'N m'), '(2.40 ± 0.31)·10⁻⁶ N m'),
        (plus_minus(2.0, 2.0, 2.0, '1'), '2 ± 0'),
        (plus_minus(-1.0999, -1.9, 0.324, 'N'), '−1.0999 [−1.9, 0.324] N'),
        (from_to(2.481, 1.192), '2.48 → 1.19'),
        (from_to(0.0339, 0.00997), '0.0339 → 0.0100'),
    ],
)
def test_numbers_for_people(made, text):
    assert made == text


def content(page):
    return load_diagnosis(page.parent)


def test_the_first_screen_answers_four_questions(both):
    """What is wrong, how sure, how far it closes in the machine's unit, what to do now."""
    said = of_diagnosis(content(both), 'runs/one')
    assert said.headline == 'Stribeck friction on drive_1 is missing in the simulation.'
    assert said.sure[0] == '93 % that this is the cause, and drive_1 the place.'
    first, second = said.gaps
    assert (first.drive, first.size, first.share) == (
        'drive_1',
        '0.0310 → 0.0101 N m',
        '10.3 → 3.4 %',
    )
    # drive_2 is at its noise floor: nothing there could close.
    assert (second.drive, second.after, second.note) == ('drive_2', None, 'noise only')
    (closes,) = said.closes
    assert closes == (
        '97 % of the gap’s power, its square less the noise’s, closes (95 % interval: 95 to 98 %).'
    )
    law, values, motion = said.steps
    (stribeck,) = law.laws
    assert stribeck.numbers == (('M_S', 'friction added at rest', '0.080 ± 0.010 N m'),)
    assert values.code == 'drive_1.coulomb_torque: 0.05  # N m; 0.08 before'
    assert motion.code == (
        'ident diagnose bags/fit --check NEW_BAG --machine MACHINE.yaml --out runs/one_next'
    )
    # The noise floor's multiples are detail, not the answer.
    everything = ' '.join([said.headline, *said.sure, *said.closes])
    assert 'times' not in everything


def test_a_diagnosis_is_read_back_as_it_was_written(both):
    made = diagnosed()
    assert to_mapping(replace(content(both).found, traces=made.traces)) == to_mapping(made)


def test_long_logs_of_many_drives_stay_below_the_limit(tmp_path):
    write_identified(tmp_path)
    write_diagnosed(tmp_path)
    signals = long_signals(50_000, drives=6)
    for name in ('signals.npz', 'diagnosis.npz'):
        write_signals(tmp_path / name, signals)
    page = write_report(tmp_path)
    assert 0.4 * LIMIT < page.stat().st_size < LIMIT
    assert Page(page).text.count('of 50000 samples') == 2


def test_other_files_are_refused(tmp_path):
    path = tmp_path / 'signals.npz'
    path.write_bytes(b'no')
    with pytest.raises(IdentError, match='is damaged') as caught:
        load_signals(path)
    assert caught.value.code is ErrorCode.BAD_VALUES
    np.savez(path, schema='ros2_ident.signals', version=1)
    with pytest.raises(IdentError, match='of version 1 and this package reads'):
        load_signals(path)
    with pytest.raises(IdentError, match='holds neither result.json nor diagnosis.json') as caught:
        write_report(tmp_path)
    assert caught.value.code is ErrorCode.NO_DATA
    (tmp_path / 'diagnosis.json').write_text('{"schema": 7, "verdict": {}}')
    with pytest.raises(IdentError, match='is no diagnosis of version 5'):
        write_report(tmp_path)


def test_the_command(tmp_path, capsys):
    write_identified(tmp_path / 'run')
    assert main(['report', str(tmp_path / 'run'), '--page', str(tmp_path / 'x' / 'y.html')]) == 0
    assert (tmp_path / 'x' / 'y.html').exists()
    page = tmp_path / 'run' / 'report.html'
    assert page_line(tmp_path / 'run', wanted=True) == f'page: {page}\n'
    assert page_line(tmp_path / 'run', wanted=False) == ''
    assert not (tmp_path / 'run' / 'report.html').exists()
    assert main(['report', str(tmp_path / 'nowhere')]) == 2
    assert 'give a directory that `ident identify`' in capsys.readouterr().err


def test_a_diagnosis_whose_parts_do_not_fit_together_is_refused(tmp_path):
    """Each has its type: a traceback came of drawing them."""
    write_diagnosed(tmp_path)
    path = tmp_path / 'diagnosis.json'
    data = json.loads(path.read_text())
    del data['maps'][0]['before'][0]['half'][0]
    path.write_text(json.dumps(data))
    with pytest.raises(IdentError, match=r'is incomplete or changed \(ValueError: .*; write it'):
        write_report(tmp_path)


@pytest.mark.parametrize('read', [write_report, read_estimate, lambda x: write_comparison([x, x])])
def test_a_diagnosis_that_was_changed_is_refused(tmp_path, read):
    write_diagnosed(tmp_path)
    path = tmp_path / 'diagnosis.json'
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {'parameters': {'x': 1}, 'also': 3}))
    with pytest.raises(IdentError, match=r'diagnosis.json: is incomplete or changed \(\w+Error'):
        read(tmp_path)
