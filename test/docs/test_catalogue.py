# SPDX-License-Identifier: Apache-2.0
"""The page on the effects says what the catalogue says."""

from pathlib import Path
import re

import effects_page
import pytest
import reference_pages

from ros2_ident.effects import CATALOGUE

ROOT = Path(__file__).parents[2]


def test_the_page_is_made_from_the_catalogue() -> None:
    for path, text in effects_page.generated(ROOT).items():
        assert path.read_text(encoding='utf-8') == text, (
            f'{path.name} is out of date; run python tools/effects_page.py'
        )


def test_reference_pages_are_made_from_the_code() -> None:
    for path, text in reference_pages.generated(ROOT).items():
        assert path.read_text(encoding='utf-8') == text, (
            f'{path.name} is out of date; run python tools/reference_pages.py'
        )


@pytest.mark.parametrize('effect', CATALOGUE.values(), ids=lambda effect: effect.id)
def test_an_entry_holds_what_a_reader_needs(effect) -> None:
    text = effects_page.row(effect).replace('\\|', '|')
    assert effects_page.what_it_is(effect).endswith('.')
    for part in (effect.equation, effect.source, *effect.confusable):
        assert part in text
    for parameter in effect.parameters:
        assert f'`{parameter.name}`' in text
        assert parameter.meaning in text
        assert f'[{parameter.low:g}, {parameter.high:g}]' in text
    assert '{drive}' not in text


@pytest.mark.parametrize('effect', CATALOGUE.values(), ids=lambda e: e.id)
def test_the_symbols_of_an_effect_stand_in_its_equation(effect) -> None:
    for parameter in effect.parameters:
        if parameter.symbol:
            assert re.search(rf'(?<![A-Za-z]){parameter.symbol}(?![A-Za-z])', effect.equation)
    symbols = [p.symbol for p in effect.parameters if p.symbol]
    assert len(set(symbols)) == len(symbols)
