# SPDX-License-Identifier: Apache-2.0
"""From the files of a result directory to `report.html`."""

from collections.abc import Iterator, Mapping
from importlib.resources import files as resources
import math
from pathlib import Path
import re
from typing import Any

from bokeh.core.json_encoder import serialize_json
from bokeh.embed import json_item
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import escape, Markup

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, write_text
from ros2_ident.identify.outcome import package_version
from ros2_ident.identify.result import Identification, ParameterEstimate
from ros2_ident.report.files import (
    DIAGNOSIS,
    DIAGNOSIS_SIGNALS,
    JSON,
    load_diagnosis,
    load_result,
    PAGE,
    SIGNALS,
    YAML,
)
from ros2_ident.report.page import plots, sentences
from ros2_ident.report.page.effort import effort_plot, MOST
from ros2_ident.report.page.look import Picture
from ros2_ident.report.signals import load_signals

Facts = list[tuple[str, str]]


def write_report(directory: str | Path, page: str | Path | None = None) -> Path:
    """Write the page on what a result directory holds.

    Args:
        directory: Holds a result, a diagnosis, or both.
        page: The file to write; `report.html` in the directory where None.

    Returns:
        The page.

    Raises:
        IdentError: NO_DATA where the directory holds neither, BAD_VALUES where a file in it cannot
            be read, INVALID_GOAL where the page cannot be written.
    """
    folder = Path(directory)
    result = load_result(folder) if any((folder / n).exists() for n in (JSON, YAML)) else None
    diagnosis = load_diagnosis(folder) if (folder / DIAGNOSIS).exists() else None
    if result is None and diagnosis is None:
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{folder}: holds neither {JSON} nor {DIAGNOSIS}; give a directory that '
            '`ident identify` or `ident diagnose` wrote',
        )
    target = folder / PAGE if page is None else Path(page)
    make_directory(target.parent)
    return write_text(target, _render(folder, result, diagnosis))


def _render(
    folder: Path, result: Identification | None, diagnosis: dict[str, Any] | None
) -> str:
    environment = Environment(
        loader=PackageLoader('ros2_ident.report.page', '.'),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters |= {
        'item': _item,
        'number': sentences.number,
        'percent': sentences.percent,
        'signed': _signed,
        'prose': _prose,
        'unit': sentences.unit_of,
        'width': sentences.width,
        'places': _places,
    }
    drawn: dict[str, Picture | None] = {}
    note = ''
    facts: dict[str, Facts] = {
        'held': [], 'gates': [], 'identification_facts': [], 'diagnosis_facts': [],
    }
    efforts = [folder / name for name in (SIGNALS, DIAGNOSIS_SIGNALS)]
    most = MOST // max(1, sum(path.exists() for path in efforts))
    if result is not None:
        if efforts[0].exists():
            drawn['effort-plot'] = effort_plot(load_signals(efforts[0]), most=most)
        drawn['generations-plot'] = plots.cost_over_generations(result)
        drawn['costs-plot'] = plots.cost_over_parameters(result)
        drawn['correlations-plot'] = plots.correlations(result)
        units = {p.name: p.unit for p in result.parameters}
        facts['held'] = [
            (name, sentences.quantity(value, units.get(name, '')))
            for name, value in result.fixed.items()
        ]
        facts['identification_facts'] = _identification_facts(result)
    if diagnosis is not None:
        gap = diagnosis['gap']
        drawn['waterfall-plot'] = plots.waterfall(gap)
        drawn['ranking-plot'] = plots.ranking(diagnosis['ranking'], gap['unit'])
        drawn['maps-plot'] = plots.residual_maps(diagnosis.get('maps', []))
        if efforts[1].exists():
            floor = {name: d['noise_floor'] for name, d in gap['per_drive'].items()}
            drawn['gap-effort-plot'] = effort_plot(load_signals(efforts[1]), floor, most=most)
        note = _waterfall_note(gap)
        facts['gates'] = [(g['gate'], g['sentence']) for g in diagnosis['gates']]
        facts['diagnosis_facts'] = _diagnosis_facts(diagnosis)
    page: str = environment.get_template('template.html').render(
        title=_title(result, diagnosis),
        lead=_lead(result, diagnosis),
        version=package_version(),
        result=result,
        diagnosis=diagnosis,
        answer=sentences.of_identification(result) if result else (),
        verdict=sentences.of_diagnosis(diagnosis) if diagnosis else (),
        drives=diagnosis['gap']['per_drive'] if diagnosis else {},
        pictures={name: made for name, made in drawn.items() if made is not None},
        waterfall_note=note,
        bad_gates=any(g['level'] != 'ok' for g in diagnosis['gates']) if diagnosis else False,
        css=Markup(_asset('page.css')),
        script=Markup(_asset('page.js')),
        library=Markup(Resources(mode='inline', components=['bokeh']).render()),
        **facts,
    )
    return page


def _item(picture: Picture, name: str) -> Markup:
    """Return a plot as JSON that may stand inside a script element."""
    text = serialize_json(json_item(picture.plot, name))  # type: ignore[arg-type]
    return Markup(text.replace('<', '\\u003c'))


def _asset(name: str) -> str:
    return (resources('ros2_ident.report.page') / name).read_text(encoding='utf-8')


def _prose(text: str) -> Markup:
    """Return a sentence with what stands between backticks as code; no line ends before a %."""
    html = str(escape(text)).replace('^2', '²').replace('^3', '³')
    html = re.sub(r'(?<=\d) %', '\N{NO-BREAK SPACE}%', html)
    return Markup(re.sub('`([^`]*)`', r'<code>\1</code>', html))


def _signed(share: float | None) -> str:
    return '–' if share is None else f'{100.0 * share:+.1f} %'.replace('-', '−')


def _places(p: ParameterEstimate) -> tuple[float, float, float] | None:
    """Return left end and width of the interval and the place of the value, % of the bounds."""
    span = p.upper_bound - p.lower_bound
    if not math.isfinite(p.value) or span <= 0.0:
        return None

    def at(value: float, otherwise: float) -> float:
        share = (value - p.lower_bound) / span if math.isfinite(value) else otherwise
        return round(100.0 * min(1.0, max(0.0, share)), 2)

    here = at(p.value, 0.0)
    low, high = at(p.low, here / 100.0), at(p.high, here / 100.0)
    return low, round(high - low, 2), here


def _title(result: Identification | None, diagnosis: Mapping[str, Any] | None) -> str:
    parts = [
        word
        for word, there in (('Identification', result), ('diagnosis', diagnosis))
        if there is not None
    ]
    source = _source(result, diagnosis)
    text = ' and '.join(parts).capitalize()
    return f'{text}: {"/".join(Path(source).parts[-2:])}' if source else text


def _source(result: Identification | None, diagnosis: Mapping[str, Any] | None) -> str:
    if result is not None:
        return result.provenance.source
    return str((diagnosis or {}).get('provenance', {}).get('source', ''))


def _lead(result: Identification | None, diagnosis: Mapping[str, Any] | None) -> str:
    if result is not None:
        quality = result.quality
        return (
            f'{result.model.replace("_", " ")}, {", ".join(result.drives)}; '
            f'{quality.duration:.3g} s in {quality.segments} '
            f'{"recording" if quality.segments == 1 else "recordings"}, {quality.samples} effort '
            f'samples; {_when(result.provenance.created)}'
        )
    assert diagnosis is not None
    created = diagnosis.get('provenance', {}).get('created', '')
    return f'{", ".join(diagnosis["gap"]["per_drive"])}; {_when(created)}'


def _when(created: str) -> str:
    return created.replace('T', ' ').replace('+00:00', ' UTC')


def _waterfall_note(gap: Mapping[str, Any]) -> str:
    where = {
        'check bag': 'on a recording that was held out from fitting',
        'blocks': 'on every second block of a second, held out from fitting',
    }.get(gap['held_out'], gap['held_out'])
    text = f'Judged {where}; whiskers are 95 % intervals. '
    if len(gap['steps']) > 1 and gap['share_closed'] is not None:
        low, high = gap['share_closed_low'], gap['share_closed_high']
        text += (
            f'Of what is above the noise floor, {sentences.percent(gap["share_closed"])} closes '
            f'({sentences.percent(low)} to {sentences.percent(high)}). '
        )
    return text + f'Noise floor from: {gap["noise_floor_method"]}.'


def _flat(settings: Mapping[str, Any], before: str = '') -> Iterator[tuple[str, str]]:
    for name, value in settings.items():
        label = f'{before}{name}'.replace('_', ' ')
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f'{name}: ')
        elif isinstance(value, list):
            yield label, ', '.join(str(x) for x in value) or 'none'
        else:
            yield label, 'none' if value in (None, '', {}) else str(value)


def _identification_facts(result: Identification) -> Facts:
    p, quality = result.provenance, result.quality
    lost = ', '.join(f'{role} {sentences.percent(x)}' for role, x in quality.missing.items())
    return [
        ('recording', p.source),
        ('SHA-256 of it', p.sha256 or 'live data'),
        ('SHA-256 of the machine file', p.machine_sha256 or 'made in memory'),
        ('package version', p.package_version),
        ('platform', p.platform),
        ('ended', _when(p.created)),
        ('seed', str(result.seed)),
        ('candidates simulated', str(result.evaluations)),
        ('time taken', f'{result.seconds:.3g} s'),
        ('search ended', result.search_stop),
        ('refinement', result.refinement or 'none'),
        ('samples missing', lost or 'none'),
        *_flat(result.settings),
    ]


def _diagnosis_facts(diagnosis: Mapping[str, Any]) -> Facts:
    p = diagnosis.get('provenance', {})
    return [
        ('recording', p.get('source', '–')),
        ('SHA-256 of it', p.get('sha256') or '–'),
        ('judged on', p.get('check_source') or 'blocks of the same'),
        *([('SHA-256 of that', p['check_sha256'])] if p.get('check_sha256') else []),
        ('SHA-256 of the machine file', p.get('machine_sha256') or '–'),
        ('package version', p.get('package_version', '–')),
        ('platform', p.get('platform', '–')),
        ('ended', _when(p.get('created', '–'))),
        ('seed', str(diagnosis['seed'])),
        ('time taken', f'{diagnosis["seconds"]:.3g} s'),
        *_flat(diagnosis.get('settings', {})),
    ]
