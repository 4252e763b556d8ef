# SPDX-License-Identifier: Apache-2.0
import errno
import os
from pathlib import Path
import re
import shutil

from identify_cases import AXIS_FILE, ROOT
import pytest

from ros2_ident import files
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.report.files import OF_DIAGNOSIS, OF_RESULT
from ros2_ident.report.signals import read_arrays

BAG = ROOT / 'bags/axis_reversals'
SEARCH = ['--population', '32', '--survivors', '4', '--generations', '2', '--no-report', '--quiet']


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def content(folder: Path) -> dict[str, bytes]:
    return {str(x.relative_to(folder)): x.read_bytes() for x in folder.rglob('*') if x.is_file()}


def fill(new: Path) -> None:
    new.mkdir()
    (new / 'a').write_text('new')


def write_file(path: Path) -> None:
    files.write_text(path, f'{files.mark("test")} new')


def write_directory(path: Path) -> None:
    with files.replacing_directory(path, replace=True) as new:
        fill(new)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    (tmp_path / 'file').write_text(f'{files.mark("test")} old')
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'folder' / 'a').write_text('old')
    return tmp_path


@pytest.mark.parametrize(
    ('write', 'name', 'step'),
    [
        (write_file, 'file', 'fsync'),
        (write_file, 'file', 'replace'),
        (write_directory, 'folder', 'fsync'),
        (write_directory, 'folder', 'rename'),
    ],
)
def test_where_a_step_fails_the_old_stays_and_nothing_else(old, monkeypatch, write, name, step):
    before = content(old)
    monkeypatch.setattr(os, step, full)
    with pytest.raises(IdentError, match='No space left on device.*make room there') as caught:
        write(old / name)
    assert caught.value.code is ErrorCode.INVALID_GOAL
    assert content(old) == before
    assert sorted(x.name for x in old.iterdir()) == ['file', 'folder']


# ---------------------------------------------------------------- the overlay


@pytest.fixture
def command(tmp_path):
    words = ['identify', str(BAG), '--machine', str(AXIS_FILE), '--out', str(tmp_path)]
    return [*words, *SEARCH, '--no-refine']


def test_a_recorded_bag_at_the_overlays_place_is_kept(tmp_path, command, capsys):
    place = tmp_path / 'overlay'
    shutil.copytree(BAG, place)
    command[1] = str(place)
    assert main(command) == 2
    assert 'is what is read and will not be replaced; give another' in capsys.readouterr().err
    command[1] = str(BAG)
    assert main(command) == 2
    assert 'is no overlay that ident wrote and will not be replaced' in capsys.readouterr().err
    diagnose = ['diagnose', str(BAG), *command[2:6], '--quiet']
    assert main(diagnose) == 2
    assert 'is no overlay that ident wrote' in capsys.readouterr().err
    assert content(place) == content(BAG)
    # said before the search, so nothing else is there
    assert [x.name for x in tmp_path.iterdir()] == ['overlay']
    main([*command, '--no-overlay'])
    assert content(place) == content(BAG)


@pytest.mark.parametrize('harm', ['another file', 'a link', 'no metadata'])
def test_an_overlay_that_was_changed_is_kept(tmp_path, command, capsys, harm):
    main(command)
    place = tmp_path / 'overlay'
    if harm == 'another file':
        (place / 'notes.txt').write_text('mine')
    elif harm == 'a link':
        place.rename(tmp_path / 'elsewhere')
        place.symlink_to(tmp_path / 'elsewhere')
    else:
        (place / 'metadata.yaml').unlink()
    before = content(tmp_path)
    assert main(command) == 2
    assert 'is no overlay that ident wrote' in capsys.readouterr().err
    assert content(tmp_path) == before


@pytest.mark.parametrize('name', ['identify', 'diagnose'])
def test_two_runs_do_not_write_to_one_directory(tmp_path, command, capsys, name):
    """The second one removed the first one's checkpoint, and left its files among the other's."""
    words = command if name == 'identify' else ['diagnose', *command[1:6], '--quiet']
    checkpoint = tmp_path / f'{name}.checkpoint'
    checkpoint.write_bytes(b'ros2_ident journal 1')
    with files.sole_writer(tmp_path):
        assert main(words) == 2
    assert 'another run writes its results there; wait for its end' in capsys.readouterr().err
    assert content(tmp_path) == {checkpoint.name: b'ros2_ident journal 1'}
    with files.sole_writer(tmp_path):  # and when it has ended, the next one may
        pass


@pytest.mark.parametrize('name', [*OF_RESULT, *OF_DIAGNOSIS])
@pytest.mark.parametrize('what', ['a directory where', 'no file that ident wrote'])
def test_what_is_not_ours_is_kept_and_said_before_the_search(
    tmp_path, command, capsys, name, what
):
    foreign = tmp_path / name
    if 'directory' in what:
        foreign.mkdir()
    else:
        foreign.write_text('mine, about ros2_ident.')
    before = content(tmp_path)
    words = command if name in OF_RESULT else ['diagnose', *command[1:6], '--quiet']
    assert main(words) == 2
    said = capsys.readouterr().err
    assert f'{foreign}: is {what}' in said
    assert 'move it away, or give another place for the results' in said
    assert content(tmp_path) == before
    assert [x.name for x in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ('words', 'name'),
    [
        (['excite', '{}', '--machine', str(AXIS_FILE)], 'excite.json'),
        (['simulate', '{}', '--machine', str(AXIS_FILE)], 'notes.txt'),
        (['fleet', str(BAG.parent), '--machine', str(AXIS_FILE), '--out', '{}'], 'fleet.json'),
        (['new-machine', '--kind', 'servo', '--drives', 'a', '--out', '{}/my.yaml'], 'my.yaml'),
    ],
)
def test_no_command_writes_over_what_it_did_not_write(tmp_path, capsys, words, name):
    (tmp_path / name).write_text('time,a,b\n0,1,2\n')
    before = content(tmp_path)
    assert main([word.replace('{}', str(tmp_path)) for word in words]) == 2
    said = capsys.readouterr().err
    assert f'{tmp_path if words[0] == "simulate" else tmp_path / name}: ' in said
    assert 'give another' in said
    assert content(tmp_path) == before


def test_what_is_read_is_not_replaced_even_where_ident_wrote_it(tmp_path):
    path = files.write_text(tmp_path / 'robot.xml', f'<!-- {files.mark("export")} -->')
    files.require_ours([path])
    with pytest.raises(IdentError, match=r'robot.xml: is what is read and will not be replaced'):
        files.require_ours([path], [path])


def test_a_pipe_is_told_from_nothing_and_not_waited_for(tmp_path, monkeypatch, capsys):
    """It was said not to exist, or read until the run was killed."""
    monkeypatch.chdir(tmp_path)
    for name in ('pipe', 'pipe.csv', 'result.json', 'history.npz'):
        os.mkfifo(name)
    Path('zero.mcap').symlink_to('/dev/zero')
    Path('log.csv').write_text('t,q\n0,1\n')
    machine = ['--machine', str(AXIS_FILE)]
    for words, said in (
        (['check', 'pipe'], 'pipe: is no regular file or folder; give the path of a bag'),
        (['check', 'pipe.csv'], 'pipe.csv: is no regular file or folder; give the path of a bag'),
        (['check', 'zero.mcap'], 'zero.mcap: is no regular file or folder; give'),
        (['check', 'log.csv', '--columns', 'pipe'], 'pipe: cannot be read (it is no regular'),
        (['check', '--machine', 'pipe'], 'pipe: cannot be read (it is no regular file)'),
        (['identify', str(BAG), *machine, '--out', 'pipe'], 'pipe: is no folder; give another'),
        (['report', '.'], 'result.json: cannot be read (it is no regular file)'),
        (['predict', str(BAG), '--from', 'pipe'], 'pipe: cannot be read (it is no regular file)'),
    ):
        assert main(words) == 2
        assert said in capsys.readouterr().err
    with pytest.raises(IdentError, match='history.npz: is damaged .*it is no regular file'):
        read_arrays(Path('history.npz'), '')


def test_a_file_takes_the_place_of_its_own_kind_only(tmp_path):
    path = tmp_path / 'file'
    path.touch()  # what is empty is no loss
    for text in ('# format=ros2_ident.export\n', '# format=ros2_ident.export 2\n'):
        files.write_text(path, text)
    with pytest.raises(IdentError, match='is a file of another kind .export. and will not be rep'):
        files.write_text(path, '# format=ros2_ident.table\n')
    with pytest.raises(IdentError, match='is a file of another kind'):
        files.write_text(path, 'without a mark')
    (tmp_path / 'link').symlink_to(tmp_path / 'none')
    os.mkfifo(tmp_path / 'pipe')
    for name in ('link', 'pipe'):
        with pytest.raises(IdentError, match='is no file that ident wrote'):
            files.write_text(tmp_path / name, text)
        with pytest.raises(IdentError, match='is no file that ident wrote'):
            files.remove_file(tmp_path / name)
    assert path.read_text() == text
    assert sorted(x.name for x in tmp_path.iterdir()) == ['file', 'link', 'pipe']


@pytest.mark.parametrize('name', ['identify', 'diagnose'])
def test_the_answer_is_printed_whatever_becomes_of_the_files(
    tmp_path, command, capsys, monkeypatch, name
):
    words = command
    if name == 'diagnose':
        words = ['diagnose', *command[1:6], '--quiet', '--seconds', '0.01', '--no-overlay']
    monkeypatch.setattr(os, 'replace', full)
    assert main(words) == 2
    said = capsys.readouterr()
    answer = {'identify': 'emps_axis.moving_mass', 'diagnose': 'verdict: '}
    assert answer[name] in said.out
    assert 'written' not in said.out
    path = tmp_path / {'identify': 'result.json', 'diagnose': 'diagnosis.json'}[name]
    assert f'{path}: cannot be written (No space left on device); make room there' in said.err
    assert (tmp_path / f'{name}.checkpoint').exists()


class Killed(BaseException):
    """The end of a process, as far as one process can play it."""


def test_a_kill_leaves_nothing_old_beside_something_new(tmp_path, command, monkeypatch):
    """The process dies behind each step that puts a file or a directory into its place."""
    out, steps, dead = tmp_path / 'out', 10**9, False
    command[command.index('--out') + 1] = str(out)
    main([x for x in command if x != '--no-report'])
    old = content(out)
    assert {'report.html', 'result.json', 'overlay/overlay.mcap'} <= set(old)

    def dying(real):
        def call(*arguments, **options):
            nonlocal steps, dead
            if dead:
                raise Killed
            real(*arguments, **options)
            if real in (replace, rename):
                steps -= 1
                if steps < 0:
                    dead = True
                    raise Killed

        return call

    replace, rename = os.replace, os.rename
    for name in ('replace', 'rename', 'unlink', 'rmdir'):
        monkeypatch.setattr(os, name, dying(getattr(os, name)))
    looked = 0
    while True:
        shutil.copytree(tmp_path / 'out', again := tmp_path / f'again_{looked}')
        steps, dead = looked, False
        words = [x if x != str(out) else str(again) for x in command]
        try:
            main([*words, '--seed', '7'])
        except Killed:
            pass
        else:
            break
        found = content(again)
        found = {k: v for k, v in found.items() if not re.search('partial|checkpoint', k)}
        new = {k for k, v in found.items() if v != old.get(k)}
        left = set(found) - new - {'overlay/metadata.yaml'}  # it names no run
        assert not new or not left, (looked, left)
        looked += 1
    assert looked > 4
