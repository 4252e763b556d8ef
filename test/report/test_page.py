# SPDX-License-Identifier: Apache-2.0
"""The page on a result directory, without a browser: what it holds and what it leaves out."""

from dataclasses import replace
from html.parser import HTMLParser
import json
import math
import re
from types import SimpleNamespace

from bokeh.models import GlyphRenderer
from bokeh.plotting import figure
import numpy as np
import pytest
from report_cases import (
    diagnosed,
    identified,
    long_signals,
    write_diagnosed,
    write_identified,
)

from ros2_ident.cli import table
from ros2_ident.cli.main import main
from ros2_ident.cli.report import page_line
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.export.estimate import read_estimate
from ros2_ident.gap.compose import _hidden_by_noise
from ros2_ident.gap.diagnosis import DriveGap, to_mapping
from ros2_ident.gap.maps import chosen
from ros2_ident.gap.verdict import PUSHED, RESTLESS
from ros2_ident.identify.result import Outcome
from ros2_ident.recording import LIVE
from ros2_ident.report.files import write_result
from ros2_ident.report.page import answer, charts, write_report
from ros2_ident.report.page.answer import of_diagnosis, of_identification
from ros2_ident.report.page.effort import effort_plot
from ros2_ident.report.page.numbers import (
    change,
    command,
    compared,
    equation,
    from_to,
    number,
    percent,
    plus_minus,
    precision,
    prose,
    shares,
)
from ros2_ident.report.page.plots import one_a_cell
from ros2_ident.report.page.sentences import hidden, joined, leading, moved
from ros2_ident.report.page.several import write_comparison
from ros2_ident.report.page.symbols import legend, MEANINGS
from ros2_ident.report.page.thin import breaks, extremes, worst_moments
from ros2_ident.report.signals import load_signals, write_signals
from ros2_ident.report.tables import write_tables

DIAGNOSED = ['where', 'gap', 'time', 'values']
IDENTIFIED = ['effort', 'parameters', 'search', 'correlations']
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
    assert page.sections == ['answer', *DIAGNOSED, *IDENTIFIED, 'about', 'provenance']
    assert page.pictures == [
        'gap-effort-plot',
        'effort-plot',
        'generations-plot',
        'costs-plot',
        'correlations-plot',
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
    assert page.sections == ['answer', *IDENTIFIED, 'provenance']
    assert f'ident diagnose test --machine MACHINE.yaml --out {tmp_path}' in page.text
    assert 'gap-effort-plot' not in page.pictures
    assert 'of the effort' in page.text


def test_a_directory_with_a_diagnosis_only(tmp_path):
    write_diagnosed(tmp_path)
    page = Page(write_report(tmp_path))
    assert page.sections == ['answer', *DIAGNOSED, 'about', 'provenance']
    assert page.pictures == ['gap-effort-plot']


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
    page = Page(write_report(tmp_path))
    assert page.pictures == []
    assert 'Nothing simulated was kept' in page.text


def test_a_run_in_which_every_candidate_diverged(tmp_path):
    good = identified()
    write_identified(tmp_path)
    lost = replace(
        good,
        outcome=Outcome.DIVERGED,
        message='Every candidate diverged; narrow the bounds in the machine file.',
        parameters=tuple(
            replace(p, value=math.nan, low=math.nan, high=math.nan, state='not determined')
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
            replace(p, low=math.nan, high=math.nan, state='not determined')
            for p in good.parameters
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
    assert 'The run was cut short' in page.text
    assert 'The correlations are not known' in page.text
    assert page.pictures == ['gap-effort-plot', 'effort-plot', 'generations-plot', 'costs-plot']


@pytest.mark.parametrize(
    ('low', 'high', 'row', 'first'),
    [
        (9.0, 11.0, '± 1', '± 10 %'),
        (9.0, 18.0, '-1 +8', '−10 %, +80 %'),
        (10.0, 12.0, '-0 +2', '−0 %, +20 %'),
    ],
)
def test_an_interval_that_reaches_further_to_one_side_is_told_side_by_side(low, high, row, first):
    estimate = replace(identified().parameters[0], value=10.0, low=low, high=high)
    assert table._row(estimate)[2] == row
    assert answer._known(estimate) == first


def test_what_is_too_slow_for_noise_is_not_called_noise(tmp_path):
    found = diagnosed()
    restless = replace(
        found, effect='unknown', where=('drive_2',), probability=0.7, ranking=(),
        sentence=f'drive_1: late. {RESTLESS}: 0.0101 N m on drive_2 are left.',
        steps=found.steps[:1],
        evidence={**found.evidence, 'size': 0.1},
        per_drive={n: replace(g, before=0.0101) for n, g in found.per_drive.items()},
    )
    write_diagnosed(tmp_path, restless)
    said = of_diagnosis(content(write_report(tmp_path)), 'out')
    assert said.headline.startswith('Something moves or pushes that the simulation of drive_2')
    assert '0.0101 N m on drive_2 are left.' in said.sure
    notes = {gap.drive: gap.note for gap in said.gaps}
    assert notes == {'drive_1': 'noise only', 'drive_2': 'too slow for noise'}


def test_efforts_that_nobody_asked_for_are_the_headline(tmp_path):
    found = diagnosed()
    made = 'drive_2 at 1.41 s (+0.73 N m). No effect of a machine does that.'
    gate = ('not_asked', 'warn', 'drive_2: made efforts that the command did not ask for: 1.41 s.')
    unasked = replace(
        found, effect='unknown', where=('drive_2',), probability=0.95, ranking=(), also=(),
        sentence=f'{PUSHED}: {made}', steps=found.steps[:1], gates=(gate,), advice=(),
    )
    write_diagnosed(tmp_path, unasked)
    said = of_diagnosis(content(write_report(tmp_path)), 'out')
    assert said.headline == 'Drive_2 made efforts that the command did not ask for.'
    assert said.state == 'The cause is beside the machine and its command'
    assert f'D{made[1:]}' in said.sure
    assert not any('did not ask for' in text for text in said.careful)
    assert said.steps[1].code.startswith('ident diagnose NEW_BAG --machine ')


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
    said = of_identification(doubtful, 'out')
    assert said.level == 'doubtful'
    assert any(f'{first.name} is at its upper bound' in text for text in said.careful)
    assert any(f'{first.name} and {rest[0].name} (−0.99)' in text for text in said.careful)
    clear = of_identification(replace(good, correlation=np.eye(4)), 'out')
    assert not any('hardly separates' in text for text in clear.careful)
    assert any('is known best, to ±' in text for text in clear.sure)
    assert clear.values[0][0] == first.name and clear.values[0][2].startswith('± ')


def test_what_only_the_log_shows_is_not_to_be_simulated(both):
    data = content(both)
    late = {'effect': 'effort_delay', 'where': ['all'], 'probability': 0.9}
    steps = of_diagnosis({**data, 'also': [late]}, 'out').steps
    assert [law.anchor for law in steps[0].laws] == ['stribeck']
    assert steps[1].text.startswith('Correct how the log is made')
    assert [law.anchor for law in steps[1].laws] == ['effort_delay']


def test_a_drive_at_its_noise_floor_shows_a_bar_that_remains(both):
    page = both.read_text(encoding='utf-8')
    bars = re.findall(r'<div class="bar" aria-hidden="true">(.*?)</div>', page, re.S)[:2]
    kinds = [re.findall(r'<([ibu]) ', bar) for bar in bars]
    assert kinds == [['i', 'b', 'u'], ['b', 'u']]  # drive_1 closes; drive_2 is noise only


def many(count, **changes):
    """A result of so many parameters, the first known best, the last worst."""
    good = identified()
    one = replace(good.parameters[0], value=1.0, at_bound=False, state='identified')
    parameters = tuple(
        replace(one, name=f'link_{k}', low=1.0 - 0.05 * (k + 1), high=1.0 + 0.05 * (k + 1))
        for k in range(count)
    )
    return replace(good, parameters=parameters, correlation=np.eye(count), **changes)


def test_of_many_parameters_those_known_best_are_on_the_first_screen():
    result = many(24)
    said = of_identification(replace(result, parameters=result.parameters[::-1]), 'out')
    assert [name for name, *_ in said.values] == [f'link_{k}' for k in range(9, -1, -1)]
    assert said.sure == ('link_0 is known best, to ± 5 % (95 % intervals).',)


def test_several_parameters_at_a_bound_are_one_warning():
    result = many(9)
    ends = tuple(replace(p, at_bound=True) for p in result.parameters[:3])
    said = of_identification(replace(result, parameters=ends + result.parameters[3:]), 'out')
    (told,) = [text for text in said.careful if 'bound' in text]
    assert told.startswith('3 parameters are at or beyond a bound') and 'link_2 (1' in told


def test_a_long_headline_ends_before_its_names():
    names = ', '.join(f'shoulder_pan_joint.link_{k}' for k in range(4))
    message = f'This data does not determine 4 of 9 parameters: {names}; hold them.'
    said = of_identification(many(9, outcome=Outcome.NOT_IDENTIFIABLE, message=message), 'out')
    assert said.headline == 'This data does not determine 4 of 9 parameters.'
    assert said.sure[0] == f'Not determined: {names}; hold them.'


def test_a_solution_by_least_squares_has_no_search(tmp_path):
    write_identified(tmp_path)
    data = json.loads((tmp_path / 'result.json').read_text())
    assert 'id="search"' in write_report(tmp_path).read_text()
    data['settings']['method'] = 'algebraic'
    (tmp_path / 'result.json').write_text(json.dumps(data))
    assert 'id="search"' not in write_report(tmp_path).read_text()


def content(page):
    return json.loads((page.parent / 'diagnosis.json').read_text())


def test_the_first_screen_answers_four_questions(both):
    """What is wrong, how sure, how far it closes in the machine's unit, what to do now."""
    said = of_diagnosis(content(both), 'runs/one')
    assert said.headline == 'Stribeck friction on drive_1 is missing in the simulation.'
    assert said.sure[0] == '93 % that this is the cause, and drive_1 the place.'
    first, second = said.gaps
    assert (first.drive, first.size, first.share) == (
        'drive_1', '0.0310 → 0.0101 N m', '10.3 → 3.4 %',
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


def test_a_page_on_positions_speaks_of_positions(both):
    data = content(both)
    maps = [{**m, 'unit': 'm'} for m in data['maps']]
    settings = {**data['settings'], 'outputs': {'position': None}}
    of_positions = {**data, 'maps': maps, 'settings': settings}
    hero, _ = charts.all_of(of_positions, 'Stribeck friction on drive_1')
    assert hero.title == 'drive_1: measured minus simulated position over the velocity'
    code = of_diagnosis(of_positions, 'out').steps[-1].code
    assert '--machine MACHINE.yaml --output position --out' in code
    assert [compared(u) for u in ('N', 'N m', 'rad', 'm/s')] == [
        'effort', 'effort', 'position', 'velocity',
    ]


def test_what_was_heard_on_topics_is_no_bag(both):
    data = content(both)
    heard = {**data, 'settings': {}, 'provenance': {**data['provenance'], 'source': LIVE}}
    codes = [step.code for step in of_diagnosis(heard, 'out').steps if 'ident' in step.code]
    assert codes == [
        'ident diagnose BAG --check NEW_BAG --machine MACHINE.yaml --out out_next'
    ]


def test_a_fault_of_the_log_is_no_fault_of_the_simulation(both):
    data = content(both)
    smoothed = {'effect': 'effort_smoothing', 'where': ['all']}
    verdict = {**data['verdict'], **smoothed}
    said = of_diagnosis({**data, 'verdict': verdict}, 'out')
    assert said.headline == 'The logged effort is off, not the simulation: smoothed effort.'
    also = [{'effect': 'stribeck', 'where': ['drive_1']}]
    said = of_diagnosis({**data, 'verdict': verdict, 'also': also}, 'out')
    assert said.headline == (
        'Stribeck friction on drive_1 is missing in the simulation; '
        'the logged effort is off, too: smoothed effort.'
    )


def test_of_many_effects_the_headline_names_the_first_and_the_rest_stand_below(both):
    data = content(both)
    named = [
        {'effect': 'effort_smoothing', 'where': ['all']},
        {'effect': 'constant_force', 'where': ['wrist_2_joint']},
        {'effect': 'asymmetric_friction', 'where': ['wrist_1_joint']},
        {'effect': 'load_dependent_friction', 'where': ['shoulder_lift_joint']},
    ]
    verdict = {**data['verdict'], **named[0]}
    said = of_diagnosis({**data, 'verdict': verdict, 'also': named[1:]}, 'out')
    assert said.headline == (
        'Constant force on wrist_2_joint and 2 more effects are missing in the simulation.'
    )
    assert said.more == (
        'Also missing: asymmetric friction on wrist_1_joint and load-dependent friction on '
        'shoulder_lift_joint.',
        'The logged effort is off, too: smoothed effort.',
    )
    # Two of one drive fit into one sentence.
    late = {'effect': 'current_loop_lag', 'where': ['drive_1']}
    said = of_diagnosis({**data, 'also': [late]}, 'out')
    assert 'and current-loop lag on drive_1 are missing' in said.headline and said.more == ()


def test_where_nothing_is_found_the_headline_says_what_could_hide(both):
    data = content(both)
    verdict = {**data['verdict'], 'effect': 'none', 'where': [], 'probability': 1.0}
    evidence = {**data['evidence'], 'size': 0.1, 'material': 0.45}
    none = {**data, 'verdict': verdict, 'also': [], 'confusable': [], 'evidence': evidence}
    said = of_diagnosis(none, 'out')
    largest = max(d['noise_floor'] for d in data['gap']['per_drive'].values())
    assert said.headline == (
        'Nothing found missing: what is left is noise, in which a gap of '
        f'{0.45 * largest:.2g} N m would show.'
    )
    assert said.sure[0] == 'Over 99 % that nothing larger is missing.'
    # The sentence of the diagnosis itself, for noise that may be a gap.
    floor = SimpleNamespace(per_drive=(0.3, 0.1), low=(0.1, 0.1))
    advice = list(_hidden_by_noise(SimpleNamespace(effect='none'), floor, ('a', 'b'), 'N m'))
    assert len(advice) == 1
    said = of_diagnosis({**none, 'advice': advice}, 'out')
    assert said.headline.endswith('but slow noise may hide more.')
    assert 'noise' in said.sure[0]
    assert said.careful[0] == advice[0] and said.level == 'doubtful'


def test_numbers_that_are_known_together_only_are_given_together(both):
    data = content(both)
    wide = {n: dict(v) for n, v in data['parameters'].items()}
    (size,) = [n for n in wide if n.endswith('stribeck.torque')]
    wide[size].update(low=-9.0, high=9.0)
    name = 'drive_1.viscous_torque'
    wide[name] = {'value': 1.01, 'low': 0.9, 'high': 1.1, 'unit': 'N m s/m', 'at_bound': False}
    nominal = {**data['nominal'], name: 1.0}
    moved = {**data['moved'], name: 0.01}
    known = {**data, 'parameters': {**data['parameters'], name: wide[name]}, 'moved': moved}
    assert name not in of_diagnosis({**known, 'nominal': nominal}, 'out').steps[1].code
    loose = {**known, 'nominal': nominal, 'parameters': wide}
    law, values, *_ = of_diagnosis(loose, 'out').steps
    assert law.loose and 'not determined' in law.laws[0].numbers[0][2]
    assert values.text.startswith('Set these parameters with them')
    assert name in values.code


def test_dots_that_would_overlap_are_one():
    axis = charts._Axis(0.0, 1.0, 0.0, 100.0)
    line = {
        'heading': 'both', 'place': [0.1, 0.12, 0.5], 'mean': [1.0, 3.0, 5.0],
        'half': [0.3, 0.4, 0.1],
    }
    merged = charts._merged(line, axis)
    assert merged['place'] == pytest.approx([0.11, 0.5])
    assert merged['mean'] == pytest.approx([2.0, 5.0])
    assert merged['half'] == pytest.approx([0.25, 0.1])


def test_a_rival_brings_the_motion_that_tells_it_apart(both):
    data = content(both)
    rival = {'effect': 'backlash', 'where': ['drive_1'], 'probability': 0.4}
    said = of_diagnosis({**data, 'confusable': [data['ranking'][0], rival]}, 'out')
    assert any('cannot tell it from backlash on drive_1' in text for text in said.sure)
    assert f'backlash: {CATALOGUE["backlash"].separated_by.format(drive="drive_1")}' in (
        said.steps[-1].text
    )


def test_a_diagnosis_says_what_moves_and_what_cannot_be_seen(both):
    data = content(both)
    assert 'drive_1.coulomb_torque (−37.5 %)' in moved(data)
    assert hidden(data) == [('rod-length error', 'the machine')]
    everywhere = [{'effect': 'backlash', 'where': [d]} for d in data['gap']['per_drive']]
    assert hidden({**data, 'not_testable': everywhere}) == [('backlash', 'any drive')]


def test_warnings_that_differ_in_drive_and_figures_are_one():
    texts = [f'axis_{n}: the effort lags by {n}.5 ms; shift it.' for n in (1, 2, 3)]
    assert joined([*texts, 'state: 4 samples missing.', 'no set-point was recorded.']) == [
        f'{texts[0]} (likewise axis_2, axis_3)',
        'state: 4 samples missing.',  # begins with a name
        'No set-point was recorded.',
    ]


def finding(drive, coordinate, size, beyond):
    return {
        'drive': drive, 'coordinate': coordinate, 'size_over_floor': size, 'beyond': beyond,
        'sentence': f'{drive} {coordinate}',
    }


def test_where_lists_three_that_do_not_overlap_and_the_worst_drive(both):
    data = content(both)
    found = [
        finding('drive_1', 'velocity, odd', 3.0, 0.9),
        finding('drive_1', 'position', 2.0, 0.02),
        finding('drive_1', 'load', 1.5, 0.3),
        finding('drive_1', 'size by phase', 1.4, 0.9),
        finding('drive_2', 'time', 0.4, 0.4),
        finding('drive_3', 'time', 0.3, 0.3),
    ]
    first, rest = leading({**data, 'localisation': found})
    assert first == ['drive_1 velocity, odd', 'drive_1 load', 'drive_2 time']
    assert rest == ['drive_1 position', 'drive_1 size by phase', 'drive_3 time']
    first, _ = leading({**data, 'localisation': found[4:]})
    assert first[0].startswith('drive_1: the largest gap')


def test_the_worst_drive_and_the_named_one_have_a_map_whatever_was_found_there():
    found = diagnosed()
    assert {m['drive'] for m in to_mapping(found)['maps']} == {'drive_1'}
    worst = dict(found.per_drive, drive_2=DriveGap(0.09, 0.09, 0.01, 0.0, 0.3))
    maps = to_mapping(replace(found, per_drive=worst))['maps']
    # Nothing was found on the worst: it stands first, over its speed.
    assert (maps[0]['drive'], maps[0]['coordinate']) == ('drive_2', 'velocity')
    assert {m['drive'] for m in maps} == {'drive_1', 'drive_2'}
    noise = {**found.evidence, 'size': 0.1}
    quiet = replace(found, per_drive=worst, localisation=(), evidence=noise)
    assert to_mapping(quiet)['maps'] == []


def test_many_findings_of_one_drive_leave_room_for_another():
    (one, *_) = diagnosed().localisation
    names = ('velocity', 'position', 'load', 'time', 'jerk')
    findings = [replace(one, drive='a', coordinate=n, significant=True) for n in names]
    findings.append(replace(one, drive='b', coordinate='time', significant=True))
    assert chosen(findings) == (
        ('a', 'velocity'), ('a', 'position'), ('a', 'load'), ('b', 'time'),
    )


@pytest.mark.parametrize(
    ('again', 'said'),
    [
        ([1.0, 1.0], 'Each effect is needed again in all resamples of those data.'),
        (
            [0.99, 0.95],
            'Each effect is needed again in 95 % or more of the resamples of those data.',
        ),
        (
            [0.99, 0.61],
            'Current-loop lag on drive_2 is needed in only 61 % of the resamples of those data.',
        ),
    ],
)
def test_the_first_screen_says_how_sure_every_effect_is(both, again, said):
    late = {'effect': 'current_loop_lag', 'where': ['drive_2']}
    data = {**content(both), 'also': [late]}
    assert said in of_diagnosis({**data, 'again': again}, 'out').sure
    assert len(of_diagnosis({**data, 'again': []}, 'out').sure) == len(
        of_diagnosis({**data, 'again': again}, 'out').sure
    ) - 1


def test_the_picture_of_the_first_screen_draws_the_law_through_the_residual(both):
    data = content(both)
    hero, others = charts.all_of(data, 'Stribeck friction on drive_1')
    assert hero.title == 'drive_1: measured minus simulated effort over the velocity'
    assert hero.svg.count('class="law ') == 1 and hero.svg.count('class="dot ') > 10
    assert hero.law == (
        'what Stribeck friction on drive_1 adds to the simulation, with its parameters refitted'
    )
    # The law is what the effect takes away: the two residuals' difference.
    velocity = next(m for m in data['maps'] if m['coordinate'] == 'velocity')
    ((_, places, law),) = charts._laws(velocity)
    gone = np.subtract(velocity['before'][0]['mean'], velocity['after'][0]['mean'])
    assert law == pytest.approx(gone) and np.abs(law).max() > 0.02
    # What lags behind the motion and what depends on time are one picture, over the time.
    titles = [c.title for c in others]
    assert titles == ['drive_1: measured minus simulated effort over the time']
    assert len(data['maps']) == 3
    # Where no effect sits on its drive alone, the title says why it is shown.
    verdict = {**data['verdict'], 'where': ['all']}
    hero, _ = charts.all_of({**data, 'verdict': verdict}, 'smoothed effort')
    assert hero.title.startswith('drive_1, where the effects explain most: measured minus')
    # A drive that an effect sits on goes before one that shares an effect of the machine.
    maps = [{**m, 'drive': f'drive_{k + 2}'} for k, m in enumerate(data['maps'])]
    late = {'effect': 'stribeck', 'where': [maps[-1]['drive']]}
    both = {**data, 'maps': maps, 'verdict': verdict, 'also': [late]}
    assert charts.all_of(both, 'the effects')[0].title.startswith(f'{maps[-1]["drive"]}: measured')
    nothing, _ = charts.all_of(data, '')
    assert nothing.law == '' and 'class="law' not in nothing.svg


def test_no_line_is_drawn_where_there_are_no_data(both):
    data = content(both)
    velocity = next(m for m in data['maps'] if m['coordinate'] == 'velocity')
    drawn = charts.picture(velocity, 'Stribeck friction on drive_1').svg
    assert drawn.count('class="law ') == drawn.count('class="band ') == 1
    for line in (velocity['before'][0], velocity['after'][0]):
        count = len(line['place'])
        middle = np.linspace(0.1, 0.2, count - count // 2)
        line['place'] = [*np.linspace(-0.2, -0.1, count // 2), *middle]
    velocity['linear'] = 0.0
    drawn = charts.picture(velocity, 'Stribeck friction on drive_1').svg
    assert drawn.count('class="law ') == drawn.count('class="band ') == 2


def test_the_edge_of_the_answer_is_green_only_where_nothing_is_to_be_careful_about(both):
    """And words beside it say what its colour means."""
    data = content(both)

    def shown(**changes):
        said = of_diagnosis({**data, **changes}, '')
        return said.level, said.state

    assert shown() == ('good', 'Clear answer')
    odd = [{'gate': 'sign', 'level': 'warn', 'sentence': 'drive_1: the sign is odd.'}]
    with_reservations = 'Answer with reservations: '
    assert shown(gates=odd) == ('doubtful', f'{with_reservations}see “Be careful” below')
    assert shown(evidence={**data['evidence'], 'remaining': 1.2}) == (
        'doubtful', f'{with_reservations}part of the gap stays unexplained',
    )
    rival = {'effect': 'backlash', 'where': ['drive_1'], 'probability': 0.4}
    assert shown(confusable=[data['ranking'][0], rival]) == (
        'doubtful', f'{with_reservations}another effect explains it as well',
    )
    late = {'effect': 'current_loop_lag', 'where': ['drive_2']}
    assert shown(also=[late], again=[1.0, 0.6]) == (
        'doubtful', f'{with_reservations}not every effect is certain',
    )
    assert shown(complete=False) == ('bad', 'No clear answer yet')
    assert '<p class="state"><i></i>Clear answer</p>' in both.read_text()


def test_the_first_screen_lists_the_drives_as_the_machine_does(both):
    data = content(both)
    gaps = data['gap']['per_drive']
    assert list(gaps) == ['drive_1', 'drive_2']
    turned = {**data['gap'], 'per_drive': {n: gaps[n] for n in ('drive_2', 'drive_1')}}
    said = of_diagnosis({**data, 'gap': turned}, '')
    assert [g.drive for g in said.gaps] == ['drive_2', 'drive_1']
    # The gap of one closes, though not that of the first.
    assert said.gaps[0].after is None and said.closing
    many = {f'drive_{k}': {**gaps['drive_2'], 'before': 0.01 * k} for k in range(1, 10)}
    of_nine = of_diagnosis({**data, 'gap': {**data['gap'], 'per_drive': many}}, '')
    assert [g.drive for g in of_nine.gaps] == [f'drive_{k}' for k in range(4, 10)]


def test_only_signs_that_an_equation_uses_are_explained(both):
    (law,) = of_diagnosis(content(both), '').steps[0].laws
    assert legend([(law.equation, ['M_S', 'v_S'])]) == [('v', 'motor speed')]
    assert '<p class="note">v: motor speed; ±: 95 % interval.</p>' in both.read_text()
    # What is no word, no parameter and not explained where it stands has a meaning.
    spelled = {'u', 'omega', 'w', 'h', 'e', 'q', 'M_commanded'}  # told by the equation itself
    words = {'a', 'at', 'of', 'on', 'to', 'pi', 'in', 'or', 'sin', 'cos', 'sgn', 'exp', 'tanh'}
    for effect in CATALOGUE.values():
        signs = re.findall(r'[A-Za-z]+(?:_\w+)?', effect.equation)
        short = {s for s in signs if len(s) < 3 or '_' in s} - words - spelled
        own = {p.symbol for p in effect.parameters}
        assert {s for s in short if not re.match('d[a-z]$', s)} <= own | {*MEANINGS}, effect.id


def test_no_equation_of_a_drive_speaks_of_a_carriage():
    """A joint has none."""
    for effect in CATALOGUE.values():
        assert effect.place != 'drive' or 'carriage' not in effect.equation, effect.id
        assert '|sgn' not in effect.equation, effect.id


def test_the_numbers_are_written_into_the_files_of_a_simulator_by_one_command(both):
    data = content(both)
    codes = [step.code for step in of_diagnosis(data, 'runs/one').steps]
    assert not any('ident export' in code for code in codes)
    known = {**data, 'settings': {**data['settings'], 'machine_file': 'my.yaml'}}
    codes = [step.code for step in of_diagnosis(known, 'runs/one').steps]
    assert 'ident export runs/one --out runs/one_simulator' in codes
    result = replace(identified(), settings={**identified().settings, 'machine_file': 'my.yaml'})
    codes = [step.code for step in of_identification(result, 'runs/one').steps]
    assert 'ident export runs/one --out runs/one_simulator' in codes


def test_a_contradiction_comes_before_the_answer(both):
    data = content(both)
    grave = [{'gate': 'law', 'level': 'error', 'sentence': 'drive_1: the gain is twice that.'}]
    said = of_diagnosis({**data, 'gates': grave}, '')
    assert said.first == ('drive_1: the gain is twice that.',) and said.level == 'bad'
    assert said.state == 'Correct this first:'
    verdict = {'effect': 'bookkeeping', 'where': ['drive_1'], 'probability': 0.95,
               'sentence': 'drive_1: the gain is twice that. No effect is named.'}
    refused = of_diagnosis({**data, 'gates': grave, 'verdict': verdict, 'confusable': []}, '')
    assert refused.headline.startswith('Log and machine file contradict each other')
    assert [step.code for step in refused.steps] == [
        'ident check bags/fit --machine MACHINE.yaml'
    ]


def test_the_page_keeps_room_for_a_picture_until_it_is_drawn(both):
    text = both.read_text()
    for name in Page(both).pictures:
        (height,) = re.findall(f'<div id="{name}" [^>]*min-height: ([0-9]+)px', text)
        assert int(height) > 80, name


def test_no_line_ends_before_a_percent_sign_or_within_a_unit(both):
    said = re.findall('<(?:p|li)>(.*?)</(?:p|li)>', both.read_text())
    assert said and not any(' %' in text for text in said)
    space = '\N{NO-BREAK SPACE}'
    assert prose('a gap of 0.01 N m RMS, 3 N s/m') == (
        f'a gap of 0.01{space}N{space}m RMS, 3{space}N{space}s/m'
    )


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


def test_a_drive_behind_its_tab_takes_no_room_until_it_is_asked_for():
    figures = effort_plot(long_signals(2000, drives=6)).plot.select({'type': figure})
    sizes = {
        made.name: sum(
            len(r.data_source.data['x'])
            for r in made.select({'type': GlyphRenderer})
            if 'x' in r.data_source.data
        )
        for made in figures
    }
    assert [name for name, size in sizes.items() if size] == ['drive-0']
    assert set(sizes) == {f'drive-{d}' for d in range(6)}


def test_one_dot_stands_for_many():
    x, y = np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 1e-9, 1.0, 0.5])
    assert one_a_cell(x, y).tolist() == [1, 2, 3]
    assert one_a_cell(np.ones(3), np.ones(3)).tolist() == [2]


def test_an_identification_keeps_where_it_began(tmp_path):
    write_identified(tmp_path)
    signals = load_signals(tmp_path / 'signals.npz')
    assert signals.models == ('middle of the bounds', 'identified') and signals.judged == 1
    (log,) = signals.recordings
    began, ended = (np.nanstd(log.measured - simulated) for simulated in log.simulated)
    assert began > 5.0 * ended
    # The axis' set-point is recorded: so is how far it lags behind.
    assert np.isfinite(log.tracking).mean() > 0.9 and 0.0 < np.nanstd(log.tracking) < 0.01
    drawn = effort_plot(signals)
    hidden = {r.name for r in drawn.plot.select({'type': GlyphRenderer}) if not r.visible}
    assert hidden == {'model-0'}
    assert [b.pressed for b in drawn.choices[0].buttons] == [False, False, True]


def test_signals_come_back_as_they_were(tmp_path):
    signals = long_signals(1000)
    back = load_signals(write_signals(tmp_path / 'signals.npz', signals))
    assert (back.travel, back.judged) == (signals.travel, signals.judged)
    assert (back.unit, back.drives, back.models) == (signals.unit, signals.drives, signals.models)
    for one, two in zip(back.recordings, signals.recordings, strict=True):
        assert one.title == two.title
        assert (one.time == two.time).all()
        assert (one.measured == two.measured).all() and (one.simulated == two.simulated).all()
        assert (one.tracking == two.tracking).all()


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
    with pytest.raises(IdentError, match='is no diagnosis of version 2'):
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


def test_the_first_screen_of_an_identification_tells_the_held_out_error():
    result = identified()
    unseen = tuple(replace(x, rms=2.0 * x.rms, share=0.07) for x in result.residuals)
    told = of_identification(
        replace(result, validation=unseen, validated_on='bags/other'), 'runs/one'
    )
    assert {gap.note for gap in told.gaps} == {'held out 7 %'}
    assert told.closes[0] == 'Held out: bags/other.'
    none = of_identification(replace(result, validation=()), 'runs/one')
    assert {gap.note for gap in none.gaps} == {''} and none.closes == ()


def test_shares_that_say_nothing_are_words():
    assert percent(2.7e-11) == 'below 0.01 %'
    assert percent(280.0) == 'over 1000 %'
    assert precision(280.0) == 'not determined' and precision(0.034) == '± 3.4 %'
    assert change(280.0) == '× 280' and change(-0.375) == '−37.5 %'
    assert change(-2.98) == 'changes its sign'
    assert change(-2e-4) == change(2e-4) == '0.0 %'
    told = '<span class="shown">--out</span> a&lt;b'
    assert command('ident report --out a<b') == f'ident report {told}'
    assert prose('0.5 m/s, 1 s, 3 N, 4 sets') == '0.5\xa0m/s, 1\xa0s, 3\xa0N, 4 sets'


@pytest.mark.parametrize(
    ('value', 'half', 'text'),
    [
        (0.99962, 0.00044, '0.99962 ± 0.00044'),
        (-0.93, 0.2, '−0.93 ± 0.20'),
        (12345.0, 1234.0, '12300 ± 1200'),
        (2.4e-6, 3.1e-7, '(2.40 ± 0.31)·10⁻⁶'),
        (2.0, 0.0, '2 ± 0'),
    ],
)
def test_a_value_ends_where_its_interval_does(value, half, text):
    assert plus_minus(value, half, '1') == text
    assert plus_minus(value, half, 'N m') == f'{text} N m'


def test_no_zero_has_a_sign():
    assert number(-0.0) == '0' and change(-1e-4) == '0.0 %' and change(-4e-3, 0) == '0 %'


def test_pairs_of_numbers_have_the_same_decimals():
    assert from_to(2.481, 1.192) == '2.48 → 1.19'
    assert from_to(0.0339, 0.00997) == '0.0339 → 0.0100'
    assert from_to(231.6, 9.8) == '232 → 10'
    assert shares(0.0451, 0.0213) == '4.5 → 2.1 %'
    assert shares(0.14, 0.0012) == '14.00 → 0.12 %'


def test_equations_have_indices_powers_and_greek_letters():
    assert equation('M_S exp(-(v/v_S)^2) sgn v') == (
        'M<sub>S</sub> exp(-(v/v<sub>S</sub>)<sup>2</sup>) sgn v'
    )
    assert equation("tau M_log' = mu <x>") == 'τ M<sub>log</sub>&#39; = μ &lt;x&gt;'


def test_a_curve_breaks_where_samples_are_missing_and_a_recording_ends():
    time = np.concatenate([np.arange(100) * 1e-3, 1.0 + np.arange(100) * 1e-3])
    there = np.ones(200, dtype=bool)
    there[[10, 11]] = False  # two lost samples are no gap
    assert breaks(time, there, [200]) == [100, 200]
    there[20:60] = False
    assert breaks(time, there, [150, 200]) == [60, 100, 150, 200]


def test_the_worst_moments_are_the_largest_and_apart():
    time = np.arange(10_000) * 1e-3
    residual = np.zeros((2, 10_000))
    residual[0, 2000:2050], residual[1, 7000:7020], residual[0, 2100] = 3.0, 2.0, 9.9
    moments = worst_moments(time, residual)
    assert [drive for _, _, drive in moments] == [0, 1]
    assert moments[0][0] < 2.0 < 2.1 < moments[0][1] and moments[1][0] < 7.0 < moments[1][1]


@pytest.mark.parametrize(
    'read',
    [
        *(write_report, read_estimate),
        *(lambda x: write_tables(x, x), lambda x: write_comparison([x, x])),
    ],
)
def test_a_diagnosis_that_was_changed_is_refused(tmp_path, read):
    write_diagnosed(tmp_path)
    path = tmp_path / 'diagnosis.json'
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {'parameters': {'x': 1}, 'also': 3}))
    with pytest.raises(IdentError, match=r'diagnosis.json: is incomplete or changed \(\w+Error'):
        read(tmp_path)
