# SPDX-License-Identifier: Apache-2.0
"""What the documentation shows as printed is what the commands print.

A fenced block without a language is an output: its lines stand one after the other in what the
commands of its page print. A number may differ by one in its last digit, since processors round
differently. Two marks say otherwise:

    <!-- printed by: PAGE -->      by the commands of another page
    <!-- not printed: REASON -->   not by a command that is run here, with a reason of `REASONS`
"""

from pathlib import Path
import re

from docs_cases import Block, blocks, run_of, run_pages
import pytest

from ros2_ident.cli.main import main

NUMBER = re.compile(r'-?\d+(?:\.\d+)?(?:e[+-]?\d+)?$')
REASONS = ('takes minutes', 'after a mistake', 'needs your own files')


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
    assert {b.reason for b in blocks('') if b.mark == 'not printed'} == set(REASONS)


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


@pytest.mark.parametrize(
    ('shown', 'same'),
    [
        ('mass  95.106 ± 0.034  kg', True),
        ('mass  95.107 ± 0.034  kg', True),
        ('mass  95.108 ± 0.034  kg', False),
        ('mass  95.106 ± 0.034  g', False),
        ('mass  95.106 ± 0.034', False),
    ],
)
def test_a_last_digit_may_differ_and_nothing_else(shown: str, same: bool) -> None:
    assert agrees(shown, 'mass 95.106  ± 0.034  kg') == same
