# SPDX-License-Identifier: Apache-2.0
"""From the files of a result directory to `report.html`."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
import math
from pathlib import Path
from typing import Any

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.result import Diagnosis
from ros2_ident.gap.where.localise import Finding
from ros2_ident.identify.result import Identification
from ros2_ident.report.diagnosis import Written
from ros2_ident.report.estimate import load
from ros2_ident.report.files import CHANGE, DIAGNOSIS_SIGNALS, FLEET, holds_results, PAGE, SIGNALS
from ros2_ident.report.page import charts, numbers
from ros2_ident.report.page.answer import of_diagnosis, of_identification
from ros2_ident.report.page.effort import effort_plot, MOST
from ros2_ident.report.page.render import Picture, write_page
from ros2_ident.report.page.several import write_difference, write_fleet
from ros2_ident.report.schema import intact
from ros2_ident.report.signals import load_signals
from ros2_ident.words import verdict as words
from ros2_ident.words.finding import where

# Effects of which the page says how probable they are.
RANKED = 8
# Places of the gap that are told at once, and the share of a drive's gap that a further one has to
# explain beyond the drive's leading one.
LEADING, FURTHER = 3, 0.1
# How the noise floor was found, in words.
FLOORS = {
    'prediction': 'what neither the motion nor the samples before predict',
    'repeats': 'what differs between repeats of the same motion',
}


def write_report(directory: str | Path, page: str | Path | None = None) -> Path:
    """Write the page on what a result directory holds.

    Args:
        directory: Where `ident identify`, `diagnose` (or both), `fleet` or `diff` wrote.
        page: The file to write; `report.html` in the directory where None.

    Raises:
        IdentError: NO_DATA where the directory holds neither, BAD_VALUES where a file in it cannot
            be read, INVALID_GOAL where the page cannot be written.
    """
    folder = Path(directory)
    for name, write in ((FLEET, write_fleet), (CHANGE, write_difference)):
        if not holds_results(folder) and (folder / name).exists():
            with intact(folder / name):
                return write(folder, page)
    result, diagnosis = load(folder)
    with intact(folder):  # what was read fits its types, and may still not fit together
        context = _context(folder, result, diagnosis)
        return write_page(Path(page or folder / PAGE), 'template.html', context, plots=True)


def _context(folder: Path, result: Identification | None, w: Written | None) -> dict[str, Any]:
    prediction = None if result is None else result.prediction
    there = {'identification': result, 'diagnosis': w}
    title = ' and '.join(name for name, of in there.items() if of).capitalize()
    source = next(of.provenance.source for of in (result, w) if of)
    context: dict[str, Any] = {
        'title': f'{title}: {"/".join(Path(source).parts[-2:])}' if source else title,
        'lead': _lead(result, w),
        'result': result,
        'diagnosis': None if w is None else w.found,
        'pictures': _pictures(folder, result, w),
        # a solution by least squares looks at no candidate but its own
        'searched': result is not None and result.settings.get('method') != 'algebraic',
        'hero': None,
        'free': prediction if w is None else w.found.prediction,
        'about': [],
    }
    if result is not None:
        units = {p.name: p.unit for p in result.parameters}
        answer, p = of_identification(result, str(folder)), result.provenance
        missing = {role: numbers.percent(x) for role, x in result.quality.missing.items()}
        context |= {
            'answer': answer,
            'identified': answer,
            'correlated': charts.correlated(result),
            'held': [(x, numbers.quantity(v, units.get(x, ''))) for x, v in result.fixed.items()],
            'identification_facts': [*_flat({
                **asdict(p), 'seed': result.seed, 'time_taken': f'{result.seconds:.3g} s',
                'candidates_simulated': result.evaluations, 'search_ended': result.search_stop,
                'refinement': result.refinement, 'samples_missing': missing, **result.settings,
            })],
        }  # fmt: skip
    if w is not None:
        context |= _of_diagnosis(w, str(folder))
    return context


def _pictures(
    folder: Path, result: Identification | None, w: Written | None
) -> dict[str, Picture]:
    """Draw what needs a script: efforts over time, the search."""
    drawn: dict[str, Picture | None] = {}
    efforts = [folder / name for name in (SIGNALS, DIAGNOSIS_SIGNALS)]
    most = MOST // max(1, sum(path.exists() for path in efforts))
    if w is not None and efforts[1].exists():
        floor = {name: g.noise_floor for name, g in w.found.per_drive.items()
                 if math.isfinite(g.noise_floor)}  # fmt: skip
        drawn['gap-effort-plot'] = effort_plot(load_signals(efforts[1]), floor, most=most)
    if result is not None:
        if efforts[0].exists():
            drawn['effort-plot'] = effort_plot(load_signals(efforts[0]), most=most)
        drawn['costs-plot'] = charts.cost_over_parameters(result)
    return {name: made for name, made in drawn.items() if made is not None}


def _of_diagnosis(w: Written, out: str) -> dict[str, Any]:
    d = w.found
    found = words.named(d)
    effects = found[0].title if len(found) == 1 else 'the effects' * bool(found)
    hero, maps = charts.all_of(w, effects)
    shown = dict.fromkeys(at.effect for at in (*found, *(r.at for r in d.confusable)))
    about = [CATALOGUE[e] for e in shown if e in CATALOGUE]
    return {
        'answer': of_diagnosis(w, out),
        'hero': hero,
        'maps': maps,
        'where': _leading(d),
        'bars': _steps(d),
        'ranking': _ranking(d),
        'noise': FLOORS[d.floor.method],
        'about': about,
        'catalogue': CATALOGUE,
        'words': words,
        'checks': [(g.gate, g.sentence) for g in d.gates],
        'diagnosis_facts': [*_flat({
            **asdict(w.provenance), 'judged_on': w.check_source or 'blocks of the same',
            'check_sha256': w.check_sha256, 'seed': d.seed, 'time_taken': f'{d.seconds:.3g} s',
            **w.settings,
        })],
    }  # fmt: skip


def _lead(result: Identification | None, w: Written | None) -> str:
    created = next(of.provenance.created for of in (result, w) if of)
    when = created.replace('T', ' ').replace('+00:00', ' UTC')
    if result is not None:
        quality = result.quality
        return (
            f'{result.model.replace("_", " ")}, {", ".join(result.drives)}; '
            f'{quality.duration:.3g} s in {quality.segments} '
            f'{"recording" if quality.segments == 1 else "recordings"}, {quality.samples} effort '
            f'samples; {when}'
        )
    assert w is not None
    return f'{", ".join(w.found.per_drive)}; {when}'


def _leading(d: Diagnosis) -> tuple[list[str], list[str]]:
    """Return where the gap lies: the findings that matter and do not overlap, then the rest."""
    told: list[Finding] = []
    for f in d.localisation:
        if f.drive not in [x.drive for x in told] or f.beyond >= FURTHER:
            told.append(f)
    told = sorted(told, key=lambda f: -f.over_floor)[:LEADING]
    missing = [drive for drive in words.worst(d) if all(f.drive != drive for f in told)]
    lost = [f'{x}: the largest gap; it follows no coordinate of the motion' for x in missing]
    return lost + [*map(where, told)], [where(f) for f in d.localisation if f not in told]


def _flat(settings: Mapping[str, Any], before: str = '') -> Iterator[tuple[str, str]]:
    """Yield what a file says, label and value."""
    for name, value in settings.items():
        label = f'{before}{name}'.replace('_', ' ')
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f'{name}: ')
        elif isinstance(value, list):
            yield label, ', '.join(str(x) for x in value) or 'none'
        else:
            yield label, 'none' if value in (None, '', {}) else str(value)


@dataclass(frozen=True)
class Bar:
    """A row of a chart: its length, and the ends of its interval, are 0 to 1."""

    name: str
    length: float
    text: str
    style: str = ''
    ends: tuple[float, float] | None = None


def _steps(d: Diagnosis) -> list[Bar]:
    """Return the residual before, with one effect after another, and the noise floor."""
    known = [s for s in d.steps if math.isfinite(s.gap.value)]
    floor = d.floor.together
    if not known or not floor > 0.0:
        return []
    longest = max(floor, *(max(s.gap.value, s.gap.high) for s in known))
    unit, out = numbers.unit_of(d.unit), []
    for k, step in enumerate(known):
        gap = step.gap
        name = 'nominal simulation' if k == 0 else f'with {step.label}'
        text = f'{numbers.number(gap.value, 3)} {unit}'
        if k:
            text += f' ({numbers.change(gap.value / known[k - 1].gap.value - 1.0, 0)})'
        ends = (gap.low / longest, gap.high / longest)
        style = 'last' if k == len(known) - 1 > 0 else ''
        shown = ends if all(map(math.isfinite, ends)) else None
        out.append(Bar(name, gap.value / longest, text.replace('-', '−'), style, shown))
    text = f'{numbers.number(floor, 3)} {unit}'
    return [*out, Bar('noise floor', floor / longest, text, 'floor')]


def _ranking(d: Diagnosis) -> list[Bar]:
    """Return how probable each effect is, and what it leaves of the residual."""
    out = []
    for k, r in enumerate([r for r in d.ranking if math.isfinite(r.probability)][:RANKED]):
        text = f'{100.0 * r.probability:.0f} %' if r.probability >= 0.01 else 'below 1 %'
        if math.isfinite(r.gap_after):
            text += f', leaves {numbers.number(r.gap_after, 3)} {numbers.unit_of(d.unit)}'
        style = 'other' if k else 'first'
        out.append(Bar(r.at.title, min(1.0, r.probability), text, style))
    return out
