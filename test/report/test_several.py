# SPDX-License-Identifier: Apache-2.0
"""Pages on several runs: what differs is said, what does not is not."""

from dataclasses import asdict, replace

import pytest
from report_cases import identified, write_diagnosed, write_identified

from ros2_ident.arrays import plain
from ros2_ident.change.result import Change, Comparison, Size, Suspect, Visible
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.fleet.summary import write_summary
from ros2_ident.report.page import write_comparison, write_report
from ros2_ident.report.page.several import differing, strips


def drawn(runs: list) -> list:
    """Return the strips of runs that are compared with the first."""
    return strips(runs, differing(runs))


def value(middle: float, half: float | None, unit: str = 'kg') -> dict:
    known = half is not None
    return {
        'value': middle,
        'low': middle - half if known else None,
        'high': middle + half if known else None,
        'unit': unit,
    }


def test_what_differs_beyond_its_interval_comes_first():
    one = {'mass': value(2.0, 0.1), 'delay': value(0.01, 0.001, 's')}
    two = {'mass': value(2.05, 0.1), 'delay': value(0.02, 0.001, 's')}
    delay, mass = drawn([('a', one), ('b', two)])
    assert (delay.name, delay.differs, mass.name, mass.differs) == ('delay', True, 'mass', False)
    assert [m.note for m in delay.marks] == ['', '+100.0 %, differs']
    # Both stand on one scale, from the least end to the largest.
    first, second = mass.marks
    assert first.low == 0.0 and second.low + second.width == pytest.approx(100.0)
    assert first.at < second.at


def test_a_comparison_of_an_identification_with_another_and_a_diagnosis(tmp_path):
    good = identified()
    first, *rest = good.parameters
    span = first.high - first.low
    moved = replace(first, value=first.value + span, low=first.low + span, high=first.high + span)
    for name, result in (('a', good), ('b', replace(good, parameters=(moved, *rest)))):
        (tmp_path / name).mkdir()
        write_identified(tmp_path / name, result)
    page = write_comparison([tmp_path / 'a', tmp_path / 'b'])
    assert page == tmp_path / 'a' / 'comparison.html'
    text = page.read_text()
    assert f'1 of {len(good.parameters)} parameters differs: {first.name}.' in text
    assert text.index(first.name) < text.index(rest[0].name)
    write_diagnosed(tmp_path / 'c')
    out = tmp_path / 'all.html'
    where = [str(tmp_path / name) for name in 'abc']
    assert main(['report', *where, '--page', str(out)]) == 0
    assert 'Stribeck friction on drive_1 is missing in the simulation.' in out.read_text()
    assert f'Not compared, for other effects in the model: {where[2]};' in out.read_text()
    assert 'http' not in out.read_text().replace('http-equiv', '')
    apart = write_comparison([tmp_path / 'a', tmp_path / 'c']).read_text()
    assert 'The runs share no parameter.' in apart and '<code>ident diff</code>' in apart
    with pytest.raises(IdentError, match='holds neither') as caught:
        write_comparison([tmp_path / 'a', tmp_path])
    assert caught.value.code is ErrorCode.NO_DATA


def row(machine: str, number: int, mass: float, **more) -> dict:
    return {
        'name': f'{machine}_{number}',
        'machine': machine,
        'date': f'2026-01-0{number}',
        'state': 'done',
        'code': 'OK',
        'message': 'All parameters are identified.',
        'unit': 'N',
        'residual': {'axis': 0.3},
        'parameters': {'mass': value(mass, 0.1)},
        **more,
    }


def between(kind: str, after: str, before: str, more: float) -> dict:
    """Return the row of a comparison in which the mass is more, or nothing differs."""
    mass = Suspect('parameter', 'mass')
    change = Change(mass, (Size('mass', more, more - 0.1, more + 0.1, 'kg', 2.0),), 50.0, ())
    smallest = (Visible(mass, 'mass', 0.3, 'kg', 2.0),)
    found = Comparison((change,) * bool(more), 0.9, smallest, (), (1, 1), False, 5.0, True)
    return {
        'name': f'{after}~{before}',
        'kind': kind,
        'machine': after[0],
        'before': before,
        'after': after,
        'state': 'done',
        'code': 'OK',
        'message': '',
        'found': plain(asdict(found)),
    }


def test_the_page_of_a_fleet_says_who_drifted_and_who_failed(tmp_path):
    found = {'effect': 'stribeck', 'where': ['axis'], 'verdict': 'Stribeck friction <axis>.'}
    found['probability'] = 0.93
    lost = {
        'name': 'c_1',
        'machine': 'c',
        'date': '',
        'state': 'failed',
        'code': 'DAMAGED_BAG',
        'message': 'c_1: is damaged; record it again',
    }
    later = row('a', 3, 4.0, bag='bags/a 2', machine_file='a.yaml')
    rows = [row('a', 1, 2.0), row('a', 2, 3.0), later, row('b', 1, 2.0, **found), lost]
    rows += [between('drift', 'a_2', 'a_1', 1.0), between('drift', 'a_3', 'a_1', 2.0)]
    rows += [between('machine', 'a_3', 'b_1', 2.0), {**lost, 'after': 'b_1', 'before': 'a_1'}]
    write_summary(tmp_path, rows)
    text = write_report(tmp_path).read_text()
    assert 'a has drifted; a differs from the others; the simulation lacks' in text
    assert 'a, a_2 after a_1: Changed: mass by 1\xa0kg ±\xa00.1 (+50\xa0%).' in text
    assert 'b_1 could not be compared with a_1: c_1: is damaged' in text
    assert 'the simulation lacks Stribeck friction in b_1.' in text
    assert 'Stribeck friction &lt;axis&gt;. Probability: 93\xa0%.' in text
    assert 'Not every recording could be judged' in text
    assert text.count('Inspect a, for its mass.') == 1, 'once, with its latest recording'
    assert 'Correct what the table says of c_1, and run the same command again' in text
    assert 'DAMAGED_BAG' in text and 'is damaged; record it again' in text
    assert '5 recordings of 3 machines' in text and text.count(', differs') == 2
    assert 'Stribeck friction: found once (b_1: axis)' in text


def test_what_does_not_differ_does_not_on_the_page_of_a_fleet(tmp_path):
    rows = [row(name, 1, mass) for name, mass in zip('abh', [2.0, 2.0, 2.14], strict=True)]
    write_summary(tmp_path, [*rows, *(between('machine', f'{x}_1', 'a_1', 0.0) for x in 'bh')])
    text = write_report(tmp_path).read_text()
    assert 'The smallest change that would have shown: mass 0.3' in text
    assert 'No difference shows' in text and ', differs' not in text
    write_summary(tmp_path, [*rows, between('machine', 'h_1', 'a_1', 0.14)])
    text = write_report(tmp_path).read_text()
    assert 'h differs from the others' in text and text.count(', differs') == 1
    assert 'To be inspected' in text
    write_summary(tmp_path, rows[:1])
    assert 'Nothing to compare' in write_report(tmp_path).read_text()
    old = (tmp_path / 'fleet.json').read_text().replace('"version": 2', '"version": 1')
    (tmp_path / 'fleet.json').write_text(old)
    with pytest.raises(IdentError, match='no fleet of this version; run `ident fleet` again'):
        write_report(tmp_path)
