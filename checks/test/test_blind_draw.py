# SPDX-License-Identifier: Apache-2.0
from collections import Counter
from dataclasses import replace
import gzip
import json
from pathlib import Path
import subprocess
import sys

from blind_rows import a_label
import numpy as np
import pytest

from checks.blind import command, keep, seal
from checks.blind.command import numbers
from checks.blind.draw import Drawer
from checks.blind.forms import draw_form, FORMS, suits
from checks.blind.label import from_mapping, MotionOrder, to_mapping
from checks.blind.machines import draw_machine, machine_of, read_plain
from checks.blind.planning import counts_of, forms_of, plan, Wanted
from checks.blind.probe import Probe
from checks.blind.run import scrubbed
from checks.blind.sorts import SHARES
from checks.blind.store import Store, write_json
from checks.blind.truth import make_row
from checks.program import start
from checks.reference.bag_making import draw_parameters
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import IdentError

TRIPOD = Path(__file__).parents[2] / 'config' / 'tripod.yaml'
PLAIN = read_plain(TRIPOD)
MACHINE = machine_of(PLAIN)
USUAL = {name: share for name, (share, _) in SHARES.items()}
FORMS_HERE = forms_of(MACHINE)
INSIDE = [name for name in FORMS_HERE if name in CATALOGUE]
OUTSIDE = [name for name in FORMS_HERE if name not in CATALOGUE]


def test_shares_add_up() -> None:
    for cases in (1, 7, 60, 300):
        assert sum(counts_of(USUAL, cases).values()) == cases
    assert counts_of(dict.fromkeys(USUAL, 0.0) | {'none': 1.0}, 9)['none'] == 9


def test_plan_is_reproducible_and_visits_every_effect() -> None:
    wanted = plan(INSIDE, OUTSIDE, 240, 4, USUAL)
    assert wanted == plan(INSIDE, OUTSIDE, 240, 4, USUAL)
    assert wanted != plan(INSIDE, OUTSIDE, 240, 5, USUAL)
    first = Counter(w.names[0] for w in wanted if w.sort == 'single')
    assert set(first) == set(INSIDE)
    assert max(first.values()) - min(first.values()) <= 1
    foreign = Counter(w.names[0] for w in wanted if w.sort == 'outside')
    assert set(foreign) == set(OUTSIDE)
    sizes = sorted(w.sizes[0] for w in wanted if w.sort == 'single')
    # Evenly spread in the logarithm.
    assert np.median(sizes) == pytest.approx(np.sqrt(0.3 * 8.0), rel=0.1)
    for sort, number in (('pair', 2), ('triple', 3)):
        several = [w for w in wanted if w.sort == sort]
        assert several and all(len(set(w.names[:number])) == number for w in several)
        assert all(len(w.sizes) == number for w in several)
    assert sum(w.hard for w in wanted) == pytest.approx(0.2 * 240, abs=1)
    assert len({w.sort for w in wanted[:60]}) >= 7  # the order tells nothing


def test_cases_are_read_as_numbers_and_ranges() -> None:
    assert numbers('3, 8,20-22') == (3, 8, 20, 21, 22)
    assert numbers(None) == ()
    with pytest.raises(IdentError, match='write as 3,8'):
        numbers('3;8')


def test_label_survives_json() -> None:
    label = a_label()
    assert from_mapping(json.loads(json.dumps(to_mapping(label)))) == label
    whole = replace(label, fault=None, share=None)
    assert from_mapping(json.loads(json.dumps(to_mapping(whole)))) == whole


def test_seal_hides_and_proves() -> None:
    plain = to_mapping(a_label())
    sealed = seal.close(plain, 11)
    assert b'stribeck' not in bytes.fromhex(sealed['box'])
    assert seal.unseal(sealed, 11) == plain
    assert seal.close(plain, 11)['sha256'] != sealed['sha256']  # another nonce
    with pytest.raises(IdentError, match='seal'):
        seal.unseal(sealed, 12)
    broken = sealed | {'box': ('0' if sealed['box'][0] != '0' else '1') + sealed['box'][1:]}
    with pytest.raises(IdentError, match='seal'):
        seal.unseal(broken, 11)
    assert seal.digest_of(plain, sealed['nonce']) == sealed['sha256']
    assert seal.manifest(['a']) != seal.manifest(['a', 'a'])


def test_directory_of_another_run_is_refused(tmp_path) -> None:
    store = Store(tmp_path / 'run')
    what = {'command': 'x', 'cases': 4, 'seed': 1, 'shares': USUAL}
    store.begin(what, TRIPOD)
    store.begin(what, TRIPOD)
    with pytest.raises(IdentError, match='another run'):
        store.begin(what | {'seed': 2}, TRIPOD)
    with pytest.raises(IdentError, match='no run'):
        Store(tmp_path / 'nothing').about()


def kept_run(tmp_path: Path) -> tuple[Store, Path]:
    """Return a run of one sealed and scored case, and where it is kept."""
    store = Store(tmp_path / 'run')
    what = {'command': 'x', 'cases': 1, 'seed': 4, 'shares': {}}
    store.begin(what, TRIPOD)
    plain = to_mapping(replace(a_label(), case=1))
    store.seal(1, seal.close(plain, 4))
    store.close_seals(1)
    kept = tmp_path / 'kept'
    keep.keep_seals(store, kept)
    assert 'not opened yet' in keep.verify(kept)[-1]
    row = {**make_row(plain, store.case(1), store.clean(1)), 'ranking': [{}] * 30}
    keep.keep_all(store, kept, [row])
    return store, kept


def test_what_is_kept_can_be_verified_by_anybody(tmp_path) -> None:
    store, kept = kept_run(tmp_path)
    said = keep.verify(kept)
    assert store.about()['manifest'] in said[0]
    assert 'the figures are those of the table' in said[-1]
    assert start('checks.blind', command, ['--verify', str(kept)]) == 0
    (row,) = (json.loads(line) for line in (kept / 'table.jsonl').read_text().splitlines())
    assert len(row['ranking']) == 5


@pytest.mark.parametrize(
    ('file', 'old', 'new', 'match'),
    [
        ('table.jsonl', '"rho": 2.1', '"rho": 3.1', 'row of case 1'),
        ('table.jsonl', 'stribeck', 'backlash', 'row of case 1'),
        ('figures.json', ' of 1"', ' of 7"', 'figures'),
        ('seals.json', '"manifest": "', '"manifest": "0', 'digest'),
    ],
)
def test_what_was_changed_afterwards_is_found(tmp_path, file, old, new, match) -> None:
    _, kept = kept_run(tmp_path)
    text = (kept / file).read_text()
    assert old in text
    (kept / file).write_text(text.replace(old, new))
    with pytest.raises(IdentError, match=match):
        keep.verify(kept)


def test_another_label_than_the_sealed_one_is_found(tmp_path) -> None:
    store, kept = kept_run(tmp_path)
    packed = gzip.decompress((kept / keep.LABELS).read_bytes()).decode()
    (kept / keep.LABELS).write_bytes(gzip.compress(packed.replace('2.1', '2.2').encode()))
    with pytest.raises(IdentError, match='label of case 1'):
        keep.verify(kept)
    write_json(kept / 'seals.json', {'manifest': 'another', 'seals': []})
    with pytest.raises(IdentError, match='another run'):
        keep.keep_all(store, kept, [])


def test_linearised_size_agrees_with_the_refit() -> None:
    rng = np.random.default_rng(3)
    parameters = draw_parameters(MACHINE, rng)
    motions = [
        MotionOrder('mixed', 3.0, 1).draw(MACHINE),
        MotionOrder('mixed', 2.0, 2).draw(MACHINE),
    ]
    probe = Probe(MACHINE, parameters, motions, 0.01)
    effect = draw_form(FORMS['stribeck.exponential'], MACHINE, 'drive_2', 0.6, 3)
    linear, true = probe.linear([effect]), probe.truth([effect])
    assert linear == pytest.approx(true.size, rel=0.3)
    assert int(np.argmax(true.per_drive)) == 1
    # Without an effect the fast model leaves a small part of the noise.
    assert probe.truth([]).size < 0.05
    # Half the noise, twice the size.
    finer = Probe(MACHINE, parameters, motions, 0.005)
    assert finer.linear([effect]) == pytest.approx(2.0 * linear)


def test_a_drawn_case_is_what_was_wanted() -> None:
    wanted = Wanted(3, 'single', ('torque_ripple', 'stribeck'), (2.0,), True)
    label, effects = Drawer(PLAIN, 1, wanted).draw()
    (part,) = label.effects
    assert part.effect == 'torque_ripple' and part.rho == pytest.approx(2.0, rel=0.5)
    assert label.motions[0].kind != label.motions[1].kind
    assert label.rho_small <= 0.4 and label.imperfections
    assert {p.where for p in label.imperfections} >= set(MACHINE.drives)
    assert part.effect not in {p.effect for p in label.imperfections}
    assert len(effects) == 1 + len(label.imperfections)
    assert label.share is not None and 0.9 < label.share < 1.0
    assert label.rough.hard and label.machine != PLAIN


def test_deltas_are_drawn_about_the_one_of_the_file() -> None:
    plain = read_plain(TRIPOD.with_name('delta.yaml'))
    drawn = [draw_machine(plain, np.random.default_rng(seed), False) for seed in range(20)]
    assert len({m['geometry']['arm_length'] for m in drawn}) == 20
    for other in drawn:
        machine_of(other)  # no gain out of range, nothing left out
        share = [other['geometry'][n] / plain['geometry'][n] for n in ('arm_length', 'rod_length')]
        assert share[0] / share[1] == pytest.approx(1.0, abs=0.09)
        drive, boxes = other['drive'], other['parameters']
        load = sum(boxes['tool_mass'][:2]) / 6.0 * other['geometry']['arm_length'] ** 2
        motor = 0.5 * sum(boxes['drive_inertia'][:2]) * drive['gear_factor'] ** 2
        loop = other['controller']['velocity_gain'] * drive['gear_factor']
        assert 99.0 < loop / (motor + drive['arm_inertia'] + load) < 201.0  # rad/s


def test_lengths_of_a_form_are_angles_where_a_drive_turns() -> None:
    delta = machine_of(read_plain(TRIPOD.with_name('delta.yaml')))
    metre = 2.0 * np.pi / 0.08 / 30.0  # rad, for which the motor turns as far
    torque, force = 3.0 / 6.0, 3.0 * 30.0 / (6.0 * 2.0 * np.pi / 0.08)
    expected = {
        '1': 1.0, 's': 1.0, 'm': metre, 'm/s': metre, '1/m': 1.0 / metre, 'N m': torque,
        'N': force, 'N/m': force / metre, 'N/m^1.5': force / metre**1.5,
        'N m s/m': torque / metre, 'N m s^2/m^2': torque / metre**2,
    }  # fmt: skip
    seen = set()
    for form in FORMS.values():
        if not (suits(form, delta) and suits(form, MACHINE)):
            continue
        turning, straight = (draw_form(form, m, 'drive_1', 0.4, 3) for m in (delta, MACHINE))
        for number in (form.size, *form.others):
            # What belongs to the structure stays as it is.
            wanted = expected.get(number.unit) if form.place == 'drive' else None
            if wanted is not None and straight.values[number.name]:
                ratio = turning.values[number.name] / straight.values[number.name]
                assert ratio == pytest.approx(wanted), (form.name, number.unit)
                seen.add(number.unit)
            elif number.unit == 'm':
                assert turning.values[number.name] == straight.values[number.name]
    assert {'m', 'm/s', 'N m', 'N'} <= seen


def test_what_the_logger_hides_is_not_counted_as_seen() -> None:
    wanted = Wanted(7, 'single', ('encoder_quantisation',), (2.0,), False)
    drawer = Drawer(PLAIN, 77, wanted)
    step = draw_form(FORMS['encoder.steps'], drawer.machine, 'drive_3', 0.4, 2)
    drawer.rough = replace(drawer.rough, smoothing=3, period=1e-3)
    drawer.logger = []
    plain = drawer._size([step])
    drawer.logger = drawer._logger()
    assert drawer._size([step]) < 0.7 * plain


FENCED = """
import os, sys
from pathlib import Path
from checks.blind.worker import Fence
root = Path(sys.argv[1])
fence = Fence(root)
fence.open_to = (str(root / 'cases' / 'a'),)
sys.addaudithook(fence)
print((root / 'cases' / 'a' / 'bag').read_text())
for name in ('sealed/1.json', 'cases/ab/bag', 'run.json'):
    try:
        (root / name).read_text()
        print('read', name)
    except PermissionError:
        print('refused')
for what in (lambda: os.listdir(root), lambda: open(f'/proc/{os.getppid()}/cmdline')):
    try:
        what()
        print('told')
    except PermissionError:
        print('refused')
"""


def test_the_diagnosing_process_reads_its_own_case_only(tmp_path) -> None:
    for name in ('cases/a/bag', 'cases/ab/bag', 'sealed/1.json', 'run.json'):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    done = subprocess.run(
        [sys.executable, '-c', FENCED, str(tmp_path)],
        env=scrubbed(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ['cases/a/bag', *['refused'] * 5]


def test_the_diagnosis_knows_nothing_of_the_generator() -> None:
    code = (
        'import sys, ros2_ident.gap.diagnose, ros2_ident.cli.diagnose\n'
        'import checks.blind.worker\n'
        'print([m for m in sys.modules if m.startswith("checks.reference")])'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], env=scrubbed(), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == '[]'


@pytest.mark.timeout(1800)
def test_a_case_from_the_draw_to_the_page(tmp_path, capsys) -> None:
    words = ['--cases', '1', '--seed', '8', '--out', str(tmp_path / 'run')]
    words += ['--machine', str(TRIPOD.with_name('emps.yaml')), '--quiet']
    words += ['--none', '0', '--single', '1']
    for sort in ('pair', 'triple', 'ideal', 'outside', 'hidden', 'fault'):
        words += [f'--{sort}', '0']
    words += ['--keep', str(tmp_path / 'kept')]
    assert start('checks.blind', command, [*words, '--draw-only']) == 0
    assert 'sealed: 1 case' in capsys.readouterr().out
    assert Store(tmp_path / 'run').answered(1) is None
    assert len(keep.verify(tmp_path / 'kept')) == 2
    assert start('checks.blind', command, words) == 0
    first = capsys.readouterr().out
    assert 'sealed: 1 case' in first
    rows = Store(tmp_path / 'run').rows()
    assert [r['error'] for r in rows] == ['']
    assert (tmp_path / 'run' / 'blind.md').exists()
    assert len(keep.verify(tmp_path / 'kept')) == 4
    # Nothing is left to do: the same command only scores again.
    assert start('checks.blind', command, words) == 0
    assert capsys.readouterr().out == first
    assert start('checks.blind', command, ['--rescore', str(tmp_path / 'run'), '--quiet']) == 0
