# SPDX-License-Identifier: Apache-2.0
"""Every command on every page is run as it stands, or is marked with what keeps it from that.

What a page shows as printed is what its commands print.

Commands stand in fenced blocks of `bash`. The blocks of a page are run one after the other in one
shell, in a folder that looks like the clone. A block that cannot be run has a line above it,

    <!-- not run: REASON -->

with a reason of `REASONS`. Its commands are checked, but not run: arguments of `ident` by its
parser, of scripts by their help, targets of `make` by the Makefile, names behind `ros2` by what
the package has.

Blocks of `sh` are examples of the help of `ident`, which cli/test_main.py checks. A fenced block
without a language is an output: its lines stand one after the other in what the
commands of its page print. A number may differ by one in its last digit, since processors round
differently. Two marks say otherwise:

    <!-- printed by: PAGE -->      by the commands of another page
    <!-- not printed: REASON -->   not by a command that is run here, with a reason of
                                   `NOT_PRINTED`
"""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
import re
import shutil
import subprocess

from docs_cases import Block, blocks, FENCE, PAGES, ROOT, run_of, run_pages
from forked import forked
import pytest

from ros2_ident.cli.main import main, make_parser

# What a command begins with; elsewhere than in a block of `bash` it is a mistake.
PROGRAM = re.compile(r'(ident|make|python|ros2|git|colcon|rosdep|pip|dask|eval|\.|cd) \S')
ASSIGNMENT = re.compile(r'^\w+=')


def marked() -> list[Block]:
    return [block for block in blocks('bash') if block.mark == 'not run']


@pytest.mark.parametrize('page', run_pages())
def test_the_commands_of_a_page_run_as_they_stand(page: str, clone: Path) -> None:
    done = run_of(page, clone)
    assert done.returncode == 0, f'{page}: {done.stdout[-4000:]}'


# ------------------------------------------------------------------ commands that are not run


# Why a block is not run.
REASONS = {
    'takes minutes', 'needs ros2', 'needs a cluster', 'needs your own files',
    'sets up the environment', 'makes what is there already',
}  # fmt: skip


@pytest.mark.parametrize('block', marked(), ids=lambda b: f'{b.page}-{b.text.split()[0]}')
def test_the_commands_of_a_block_that_is_not_run_are_known(block: Block) -> None:
    for words in block.commands:
        if not ASSIGNMENT.match(words[0]):
            CHECKS[words[0]](words)


def check_ident(words: list[str]) -> None:
    words = [word for word in words[1:] if not word.startswith('$')]
    args = make_parser(words).parse_args(words)
    assert args.command
    for word in words:
        if word.startswith('config/'):
            assert (ROOT / word).exists(), f'{word} is not there'


def check_make(words: list[str]) -> None:
    targets = re.findall(r'^([a-z]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    assert set(words[1:2]) <= set(targets), words


@cache
def help_of(*command: str) -> str:
    done = subprocess.run(
        [*forked(), *command, '--help'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def check_python(words: list[str]) -> None:
    if words[1] == '-m':
        path = ROOT / words[2].replace('.', '/')
        there = path.with_suffix('.py').exists() or (path / '__main__.py').exists()
        assert there or words[2] == 'pytest', words
        return
    assert (ROOT / words[1]).is_file(), words
    options = {word for word in words[2:] if word.startswith('--')}
    assert options <= set(re.findall(r'--[\w-]+', help_of(words[1]))), words


def check_ros2(words: list[str]) -> None:
    from ros2_ident.ros.parameters import BY_NAME

    if words[1:3] == ['run', 'robot_state_publisher']:
        return  # of another package
    if words[1] in ('run', 'launch'):
        assert words[2] == 'ros2_ident'
        name = words[3]
        programs = re.findall(r"f'(\w+) = \{NAME\}", (ROOT / 'setup.py').read_text())
        assert name in programs if words[1] == 'run' else (ROOT / 'launch' / name).is_file()
    for before, word in zip(words, words[1:], strict=False):
        if before == '-p' and not word.startswith('qos_overrides'):
            assert word.split(':=')[0] in BY_NAME, word
        if word.startswith('/identifier/'):
            text = (ROOT / 'docs/node.md').read_text()
            assert f'`~/{word.removeprefix("/identifier/")}`' in text, word
        if word.startswith('ros2_ident_msgs/'):
            folder, kind, name = word.split('/')
            assert (ROOT / 'msg_defs' / kind / f'{name}.{kind}').is_file(), word


def check_pip(words: list[str]) -> None:
    extra = re.fullmatch(r'\.\[(\w+)\]', words[-1])
    assert extra is not None and f"'{extra[1]}': " in (ROOT / 'setup.py').read_text(), words


CHECKS: dict[str, Callable[[list[str]], None]] = {
    'ident': check_ident,
    'make': check_make,
    'pip': check_pip,
    'python': check_python,
    'ros2': check_ros2,
    # nothing of this package is in them
    **dict.fromkeys(
        ('cd', 'git', 'ln', 'rosdep', 'colcon', 'dask', 'xacro', '.'), lambda words: None
    ),
}


# ------------------------------------------------------------------ nothing slips through


def outside_of_bash() -> Iterator[tuple[str, str]]:
    """Lines that look like commands and do not stand in a block of `bash`."""
    for page in PAGES:
        text = page.read_text(encoding='utf-8')
        name = page.relative_to(ROOT).as_posix()
        for match in FENCE.finditer(text):
            if match['language'] == '':
                yield from ((name, line) for line in match['text'].splitlines())
        for line in FENCE.sub('', text).splitlines():
            if line.startswith('    '):
                yield name, line.strip()


def test_every_command_stands_in_a_block_of_bash() -> None:
    for page, line in outside_of_bash():
        assert not PROGRAM.match(line), f'{page}: {line!r}; write ```bash'


def test_the_shell_and_the_marks_are_seen() -> None:
    assert 'docs/tutorial.md' in run_pages()
    assert {block.reason for block in marked()} == REASONS
    assert shutil.which('bash')


# ------------------------------------------------------------------ what is printed


NUMBER = re.compile(r'-?\d+(?:\.\d+)?(?:e[+-]?\d+)?$')
NOT_PRINTED = ('after a mistake', 'needs your own files')


def last_digit(number: str) -> float:
    """Return what one in the last digit of a number is worth."""
    mantissa, _, exponent = number.partition('e')
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition('.')[2]))


def word_agrees(shown: str, printed: str) -> bool:
    if shown == printed:
        return True
    shown, printed = shown.strip('[],()'), printed.strip('[],()')
    if not (NUMBER.match(shown) and NUMBER.match(printed)):
        return False
    return abs(float(shown) - float(printed)) < 1.5 * last_digit(shown)


def agrees(shown: str, printed: str) -> bool:
    a, b = shown.split(), printed.split()
    return len(a) == len(b) and all(map(word_agrees, a, b))


def stands_in(shown: list[str], printed: list[str]) -> bool:
    """Tell whether lines stand one after the other among others."""
    starts = range(len(printed) - len(shown) + 1)
    return any(all(map(agrees, shown, printed[i : i + len(shown)])) for i in starts)


def outputs() -> list[Block]:
    return [block for block in blocks('') if block.mark != 'not printed']


@pytest.mark.parametrize('block', outputs(), ids=lambda b: f'{b.page}-{b.text.split()[0]}')
def test_an_output_is_what_is_printed(block: Block, clone: Path) -> None:
    page = block.reason if block.mark == 'printed by' else block.page
    assert page in run_pages(), f'{block.page}: no command of {page} is run; mark the block'
    printed = run_of(page, clone).stdout
    assert stands_in(block.text.splitlines(), printed.splitlines()), (
        f'{block.page} shows\n{block.text}and {page} prints\n{printed[-6000:]}'
    )


def test_marks_have_a_reason_that_is_known() -> None:
    assert {b.reason for b in blocks('') if b.mark == 'not printed'} <= set(NOT_PRINTED)


def test_a_misspelt_key_is_told_as_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    made = ['new-machine', '--kind', 'linear_axis', '--drives', 'x_axis', '--out', 'a.yaml']
    assert main(made) == 0
    file = Path('a.yaml')
    file.write_text(file.read_text().replace('velocity_gain:', 'velocity_gian:'))
    assert main(['check', '--machine', 'a.yaml']) == 1
    (block,) = (b for b in blocks('') if b.reason == 'after a mistake')
    printed = ''.join(capsys.readouterr()).replace('a.yaml', 'build/my_axis.yaml')
    assert block.text.strip() in printed.splitlines(), printed
