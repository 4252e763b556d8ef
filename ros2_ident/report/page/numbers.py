# SPDX-License-Identifier: Apache-2.0
"""Numbers, units and equations as people read them."""

from collections.abc import Sequence
import math
import re

from markupsafe import escape, Markup

from ros2_ident.identify.result import ParameterEstimate
from ros2_ident.recording.limits import enumerated
from ros2_ident.words.figures import interval

RAISED = str.maketrans('0123456789-', '⁰¹²³⁴⁵⁶⁷⁸⁹⁻')
# Shares below and above these are said in words: their digits tell nothing.
LEAST, MOST = 1e-4, 10.0
# Half an interval over the value from which on the value is not known.
UNKNOWN = 1.0
# Names that one sentence lists.
LISTED = 6

# Units that sentences give numbers in.
_UNITS = 'N|m|s|ms|kg|rad|Hz|A|K|V'

_GREEK = {'tau': 'τ', 'zeta': 'ζ', 'omega': 'ω', 'mu': 'μ', 'delta': 'δ', 'pi': 'π', 'dm': 'Δm'}


def number(value: float | None, digits: int = 5) -> str:
    """Return a number for people, powers of ten where it is far from one; a dash for none."""
    if value is None or not math.isfinite(value):
        return '–'
    rounded = float(f'{value:.{digits - 1}e}') + 0.0  # no negative zero
    exponent = math.floor(math.log10(abs(rounded))) if rounded else 0
    if not -5 < exponent < 7:
        text = f'{rounded / 10.0**exponent:.{digits}g}·{raised(exponent)}'
    else:
        text = f'{rounded:.{max(0, digits - 1 - exponent)}f}'
        if '.' in text:
            text = text.rstrip('0').rstrip('.')
    return text.replace('-', '−')


def some(names: Sequence[str]) -> str:
    """Return a list in words, the end of a long one as its length."""
    return enumerated(names, LISTED)


def raised(power: int) -> str:
    """Return a power of ten as it is printed; nothing for the power 0."""
    return f'10{str(power).translate(RAISED)}' if power else ''


def unit_of(unit: str) -> str:
    """Return a unit as it is printed; nothing for a ratio."""
    return '' if unit == '1' else unit.replace('^2', '²').replace('^3', '³')


def quantity(value: float | None, unit: str, digits: int = 5) -> str:
    """Return a number with its unit."""
    return f'{number(value, digits)} {unit_of(unit)}'.rstrip()


def percent(share: float | None) -> str:
    """Return a share in percent, two digits; in words where digits would say nothing."""
    if share is None or not math.isfinite(share):
        return '–'
    if 0.0 < abs(share) < LEAST:
        return 'below 0.01 %'
    if abs(share) > MOST:
        return 'over 1000 %'
    return f'{number(100.0 * share, 2)} %'


def change(share: float | None, decimals: int = 1) -> str:
    """Return by how much a value changed, as a share of it; a large one as a factor."""
    if share is None or not math.isfinite(share):
        return '–'
    if share >= 2.0:
        factor = 1.0 + share
        return f'× {number(factor, 2)}' if factor < 1000.0 else '× over 1000'
    if share <= -1.0:
        return 'changes its sign'
    if abs(100.0 * share) < 0.5 * 10.0**-decimals:
        return f'{0.0:.{decimals}f} %'
    return f'{100.0 * share:+.{decimals}f} %'.replace('-', '−')


def width(estimate: ParameterEstimate) -> float:
    """Return half the interval over the size of the value; NaN or infinity where unknown."""
    half = 0.5 * (estimate.high - estimate.low)
    return half / abs(estimate.value) if estimate.value else math.inf


def precision(estimate: ParameterEstimate) -> str:
    """Return an interval, half of it as a share of the value; in words where that exceeds it."""
    half = width(estimate)
    if math.isnan(half):
        return '–'
    if half > UNKNOWN:
        return 'not determined'
    told = interval(estimate.value, estimate.low, estimate.high)
    return f'± {percent(half)}' if told.startswith('±') else told.replace('-', '−')


def plus_minus(value: float, low: float, high: float, unit: str) -> str:
    """Return a value with half its interval, both to its second digit, or with its ends."""
    half, told = 0.5 * (high - low), interval(value, low, high)
    if told.startswith('['):
        return f'{number(value)} {told} {unit_of(unit)}'.replace('-', '−').rstrip()
    top = math.floor(math.log10(max(abs(value), half))) if half > 0.0 else 0
    if not half > 0.0 or not math.isfinite(half):
        return f'{number(value, 3)} ± {quantity(half, unit, 2)}'
    power = 0 if -5 < top < 7 else top
    decimals = power + 1 - math.floor(math.log10(half))
    ends = [f'{round(x / 10.0**power, decimals):.{max(0, decimals)}f}' for x in (value, half)]
    text = ' ± '.join(ends).replace('-', '−')
    return f'{f"({text})·{raised(power)}" if power else text} {unit_of(unit)}'.rstrip()


def from_to(before: float, after: float) -> str:
    """Return two numbers with the same decimals, three digits of the larger."""
    largest = max(abs(before), abs(after))
    if not 1e-4 <= largest < 1e7:
        return f'{number(before, 3)} → {number(after, 3)}'
    decimals = max(0, 2 - math.floor(math.log10(largest)))
    return f'{before:.{decimals}f} → {after:.{decimals}f}'.replace('-', '−')


def equation(text: str) -> Markup:
    """Return an equation of the catalogue with its indices, powers and Greek letters."""
    html = str(escape(text))
    for word, letter in _GREEK.items():
        html = re.sub(rf'(?<![A-Za-z_&]){word}(?![A-Za-z])', letter, html)
    html = re.sub(r'(\w)_(\w+)', r'\1<sub>\2</sub>', html)
    html = re.sub(r'\^(\d)', r'<sup>\1</sup>', html)
    return Markup(html)


def breaks(name: str) -> Markup:
    """Return a name that a line may break behind each dot and underscore."""
    return Markup(re.sub('([._])', r'\1<wbr>', str(escape(name))))


def prose(text: str) -> Markup:
    """Return a sentence with what stands between backticks as code.

    No line ends between a number and its unit, within a unit, or after a ±.
    """
    html = str(escape(text)).replace('^2', '²').replace('^3', '³')
    within = rf'(?<=\d) (?=%|(?:{_UNITS})\b)|(?<=\bN) (?=[ms]\b)|(?<=±) (?=\d)'
    html = re.sub(within, '\N{NO-BREAK SPACE}', html)
    return Markup(re.sub('`([^`]*)`', r'<code>\1</code>', html))
