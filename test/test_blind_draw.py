# SPDX-License-Identifier: Apache-2.0
from collections import Counter
import json
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from ros2_ident.checks.blind import seal
from ros2_ident.checks.blind.draw import Drawer, known_kinds, outside_kinds, plan, Shares, Wanted
from ros2_ident.checks.blind.label import from_mapping, Label, MotionOrder, to_mapping
from ros2_ident.checks.blind.probe import Probe
from ros2_ident.checks.blind.run import scrubbed
from ros2_ident.checks.blind.store import Store
from ros2_ident.checks.blind.truth import SHARED
from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.models import load_machine
from ros2_ident.reference.bag_making import draw_parameters
from ros2_ident.reference.effects import draw_effect, Effect, kind_of

TRIPOD = Path(__file__).parent.parent / 'config' / 'tripod.yaml'
MACHINE = load_machine(TRIPOD)


def a_label() -> Label:
    effect = Effect('stribeck', ('drive_2',), {'torque': 0.05, 'speed': 0.03}, 'same', 0.4, 7)
    motions = MotionOrder('mixed', 8.0, 3), MotionOrder('creep', 6.0, 4, 0.5)
    return Label(5, 'single', {'tool_mass': 1.3}, motions, (effect,), (), (2.0,), {'drop': 0.0}, 9)


def test_shares_add_up() -> None:
    for cases in (1, 7, 60, 300):
        assert sum(Shares().counts(cases).values()) == cases
    assert Shares(0.0, 0.0, 1.0, 0.0, 0.0).counts(9)['none'] == 9


def test_plan_is_reproducible_and_visits_every_kind() -> None:
    wanted = plan(MACHINE, 120, 4, Shares())
    assert wanted == plan(MACHINE, 120, 4, Shares())
    assert wanted != plan(MACHINE, 120, 5, Shares())
    first = Counter(w.names[0] for w in wanted if w.sort == 'single')
    assert set(first) == set(known_kinds(MACHINE))
    assert max(first.values()) - min(first.values()) <= 1
    sizes = sorted(w.sizes[0] for w in wanted if w.sort == 'single')
    # Evenly spread in the logarithm.
    assert np.median(sizes) == pytest.approx(np.sqrt(0.3 * 8.0), rel=0.1)
    assert all(len(set(w.names[:2])) == 2 for w in wanted if w.sort == 'pair')


def test_kinds_are_those_of_the_catalogue_that_can_be_told() -> None:
    inside = known_kinds(MACHINE)
    assert 'stribeck' in inside and 'coulomb_friction' not in inside
    assert len(outside_kinds(MACHINE)) >= 8
    assert not set(inside) & set(outside_kinds(MACHINE))


def test_shared_sizes_are_quantities_of_the_generator() -> None:
    for name, (quantity, _, _) in SHARED.items():
        kind = kind_of(name)
        assert quantity in {kind.size.name, *(q.name for q in kind.others)}


def test_label_survives_json() -> None:
    label = a_label()
    assert from_mapping(json.loads(json.dumps(to_mapping(label)))) == label


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
    assert seal.manifest([sealed]) != seal.manifest([sealed, sealed])


def test_directory_of_another_run_is_refused(tmp_path) -> None:
    store = Store(tmp_path / 'run')
    what = {'command': 'x', 'cases': 4, 'seed': 1, 'shares': vars(Shares())}
    store.begin(what, TRIPOD)
    store.begin(what, TRIPOD)
    with pytest.raises(IdentError, match='another run'):
        store.begin(what | {'seed': 2}, TRIPOD)
    with pytest.raises(IdentError, match='no run'):
        Store(tmp_path / 'nothing').about()


def test_linearised_size_agrees_with_the_refit() -> None:
    rng = np.random.default_rng(3)
    parameters = draw_parameters(MACHINE, rng)
    motions = [
        MotionOrder('mixed', 3.0, 1).draw(MACHINE),
        MotionOrder('mixed', 2.0, 2).draw(MACHINE),
    ]
    probe = Probe(MACHINE, parameters, motions)
    effect = draw_effect('stribeck', rng, 0.5, ('drive_2',), MACHINE)
    linear, true = probe.linear([effect]), probe.truth([effect])
    assert linear == pytest.approx(true.size, rel=0.3)
    assert int(np.argmax(true.per_drive)) == 1
    # Without an effect the fast model leaves a small part of the noise.
    assert probe.truth([]).size < 0.05


def test_a_drawn_effect_has_about_the_size_asked_for() -> None:
    wanted = Wanted(3, 'single', ('torque_ripple', 'stribeck'), (2.0,))
    label = Drawer(MACHINE, 1, wanted).draw()
    assert label == Drawer(MACHINE, 1, wanted).draw()
    assert label.aimed[0] == pytest.approx(2.0, rel=0.5)
    assert label.motions[0].kind != label.motions[1].kind


# fmt: off
FENCED = '''
import os, sys
from pathlib import Path
from ros2_ident.checks.blind.worker import Fence
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
'''
# fmt: on


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
        'import ros2_ident.checks.blind.worker\n'
        'print([m for m in sys.modules if m.startswith("ros2_ident.reference")])'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], env=scrubbed(), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == '[]'


@pytest.mark.timeout(1800)
def test_two_cases_from_the_draw_to_the_page(tmp_path, capsys) -> None:
    words = ['blind', '--cases', '2', '--seed', '8', '--out', str(tmp_path / 'run')]
    words += ['--machine', str(TRIPOD), '--none', '1', '--single', '1', '--quiet']
    words += ['--pair', '0', '--outside', '0', '--hidden', '0']
    assert main(words) == 0
    first = capsys.readouterr().out
    assert 'sealed: 2 cases' in first
    rows = Store(tmp_path / 'run').rows()
    assert [r['error'] for r in rows] == ['', '']
    assert (tmp_path / 'run' / 'blind.md').exists()
    # Nothing is left to do: the same command only scores again.
    assert main(words) == 0
    assert capsys.readouterr().out == first
    assert main(['blind', '--rescore', str(tmp_path / 'run'), '--quiet']) == 0
