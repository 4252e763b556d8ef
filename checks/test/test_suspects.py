# SPDX-License-Identifier: Apache-2.0
from checks.blind.store import Store
from checks.blind.suspects import draw, judged, order, ROWS
from ros2_ident.models import load_machine


def said(name, where, also=(), **more):
    verdict = {'effect': name, 'where': where}
    return {'verdict': verdict, 'also': [*also], 'confusable': [], 'parameters': {}, **more}


def test_a_case_of_each_row_is_drawn_and_judged_by_its_rule(tmp_path) -> None:
    cases = order(3)
    assert [row for row, _ in cases[: len(ROWS)]] == list(ROWS)
    assert {row: sum(r == row for r, _ in cases) for row in ROWS} == ROWS
    store = Store(tmp_path)
    labels = {}
    for case in (3, 5, 6, cases.index(('constant', 1)) + 1):
        label = draw(store, case, 3, seconds=(1.2, 1.0))
        labels[label['row'], label['machine']['machine']] = label
        assert load_machine(store.case(case) / 'machine.yaml').kind == label['machine']['machine']
        assert (store.case(case) / 'check').is_dir()
    every = labels['every', 'tripod']
    drives, name = every['machine']['drives'], every['effects'][0]['effect']
    assert len({x for k, x in every['effects'][0]['values'].items() if '.' in k}) > 2
    also = [{'effect': name, 'where': [d]} for d in drives[1:]]
    assert judged(every, said(name, drives[:1], also))
    assert not judged(every, said(name, drives[:1], also[1:]))
    for kind in ('tripod', 'servo'):
        constant = labels['constant', kind]['constant']
        true = constant['true']
        assert true != constant['stated']
        parameters = {constant['name']: {'low': 0.9 * true, 'high': 1.1 * true}}
        found = said(constant['name'], ['all'])
        assert judged(labels['constant', kind], found | {'parameters': parameters})
        assert not judged(labels['constant', kind], found)
