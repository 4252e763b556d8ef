# SPDX-License-Identifier: Apache-2.0
"""From the files of a result directory to `report.html`."""

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from ros2_ident.effects import CATALOGUE
from ros2_ident.files import make_directory, write_text
from ros2_ident.identify.result import Identification
from ros2_ident.prediction import Prediction, prediction_from
from ros2_ident.report.files import (
    DIAGNOSIS,
    DIAGNOSIS_SIGNALS,
    FLEET,
    holds_results,
    intact,
    load,
    PAGE,
    SIGNALS,
)
from ros2_ident.report.page import bars, charts, numbers, plots, sentences
from ros2_ident.report.page.answer import of_diagnosis, of_identification
from ros2_ident.report.page.effort import effort_plot, MOST
from ros2_ident.report.page.look import Picture
from ros2_ident.report.page.render import render
from ros2_ident.report.page.several import write_fleet
from ros2_ident.report.signals import load_signals
from ros2_ident.words.verdict import judged_on

Facts = list[tuple[str, str]]

# How the noise floor was found, in words.
FLOORS = {
    'prediction': 'what neither the motion nor the samples before predict',
    'repeats': 'what differs between repeats of the same motion',
}


def write_report(directory: str | Path, page: str | Path | None = None) -> Path:
    """Write the page on what a result directory holds.

    Args:
        directory: Holds a result, a diagnosis, or both; or what `ident fleet` wrote.
        page: The file to write; `report.html` in the directory where None.

    Returns:
        The page.

    Raises:
        IdentError: NO_DATA where the directory holds neither, BAD_VALUES where a file in it cannot
            be read, INVALID_GOAL where the page cannot be written.
    """
    folder = Path(directory)
    if not holds_results(folder) and (folder / FLEET).exists():
        return write_fleet(folder, page)
    result, diagnosis = load(folder)
    target = folder / PAGE if page is None else Path(page)
    make_directory(target.parent)
    with intact(folder / DIAGNOSIS) if diagnosis else nullcontext():
        text = _render(folder, result, diagnosis)
    return write_text(target, text)


def _render(folder: Path, result: Identification | None, diagnosis: dict[str, Any] | None) -> str:
    context: dict[str, Any] = {
        'title': _title(result, diagnosis),
        'lead': _lead(result, diagnosis),
        'result': result,
        'diagnosis': diagnosis,
        'pictures': _pictures(folder, result, diagnosis),
        # a solution by least squares looks at no candidate but its own
        'searched': result is not None and result.settings.get('method') != 'algebraic',
        'effects': '',
        'hero': None,
        'free': _free(result, diagnosis),
        'about': [],
    }
    if result is not None:
        context |= _of_identification(result, str(folder))
    if diagnosis is not None:
        context |= _of_diagnosis(diagnosis, str(folder))
    shown = {'about': context['about'], 'search': context['searched']}
    context['contents'] = [
        (name, text)
        for name, text, part in CONTENTS
        if shown.get(name, {'result': result, 'diagnosis': diagnosis, '': True}[part])
    ]
    return render('template.html', context, plots=True)


def _free(
    result: Identification | None, diagnosis: Mapping[str, Any] | None
) -> Prediction | None:
    """Return the free runs, of a diagnosis where there is one."""
    if diagnosis is not None:
        return prediction_from(diagnosis.get('prediction'))
    return result.prediction if result is not None else None


# Section, its entry in the contents, and the part of a run it belongs to.
CONTENTS = (
    ('answer', 'Answer', ''),
    ('where', 'Where it lies', 'diagnosis'),
    ('gap', 'How far it closes', 'diagnosis'),
    ('time', 'Before and after', 'diagnosis'),
    ('values', 'With the effects', 'diagnosis'),
    ('effort', 'Effort', 'result'),
    ('parameters', 'Parameters', 'result'),
    ('search', 'Search', 'result'),
    ('correlations', 'Correlations', 'result'),
    ('about', 'The effects', 'diagnosis'),
    ('provenance', 'Provenance', ''),
)


def _pictures(
    folder: Path, result: Identification | None, diagnosis: Mapping[str, Any] | None
) -> dict[str, Picture]:
    """Draw what needs a script: efforts over time, the search."""
    drawn: dict[str, Picture | None] = {}
    efforts = [folder / name for name in (SIGNALS, DIAGNOSIS_SIGNALS)]
    most = MOST // max(1, sum(path.exists() for path in efforts))
    if diagnosis is not None and efforts[1].exists():
        floor = {name: d['noise_floor'] for name, d in diagnosis['gap']['per_drive'].items()}
        drawn['gap-effort-plot'] = effort_plot(load_signals(efforts[1]), floor, most=most)
    if result is not None:
        if efforts[0].exists():
            drawn['effort-plot'] = effort_plot(load_signals(efforts[0]), most=most)
        drawn['generations-plot'] = plots.cost_over_generations(result)
        drawn['costs-plot'] = plots.cost_over_parameters(result)
    return {name: made for name, made in drawn.items() if made is not None}


def _of_identification(result: Identification, out: str) -> dict[str, Any]:
    units = {p.name: p.unit for p in result.parameters}
    answer = of_identification(result, out)
    return {
        'answer': answer,
        'correlations': plots.correlations(result),
        'identified': [answer.headline, *answer.sure, *answer.careful],
        'held': [
            (name, numbers.quantity(value, units.get(name, '')))
            for name, value in result.fixed.items()
        ],
        'identification_facts': _identification_facts(result),
    }


def _of_diagnosis(diagnosis: Mapping[str, Any], out: str) -> dict[str, Any]:
    gap, found = diagnosis['gap'], sentences.effects_found(diagnosis)
    effects = sentences.name_of(found[0]) if len(found) == 1 else 'the effects' * bool(found)
    hero, maps = charts.all_of(diagnosis, effects)
    return {
        'answer': of_diagnosis(diagnosis, out),
        'complete': diagnosis['complete'],
        'drives': gap['per_drive'],
        'effects': effects,
        'hero': hero,
        'maps': maps,
        'where': sentences.leading(diagnosis),
        'steps': bars.steps(gap),
        'ranking': bars.ranking(diagnosis['ranking'], gap['unit']),
        'gap_note': _gap_note(gap),
        'moved': sentences.moved(diagnosis),
        'hidden': sentences.hidden(diagnosis),
        'about': [about(e) for e in dict.fromkeys(_named(diagnosis))],
        'signs': numbers.legend(_laws(diagnosis)),
        'gates': [(g['gate'], g['sentence']) for g in diagnosis['gates']],
        'bad_gates': any(g['level'] != 'ok' for g in diagnosis['gates']),
        'diagnosis_facts': _diagnosis_facts(diagnosis),
    }


def _named(diagnosis: Mapping[str, Any]) -> Iterator[str]:
    """Yield the effects of a verdict and their rivals."""
    for at in (*sentences.effects_found(diagnosis), *diagnosis['confusable']):
        if at['effect'] in CATALOGUE:
            yield at['effect']


def _laws(diagnosis: Mapping[str, Any]) -> Iterator[tuple[str, list[str]]]:
    """Yield their equations, each with its own parameters' signs."""
    for effect in map(CATALOGUE.__getitem__, _named(diagnosis)):
        yield effect.equation, [p.symbol for p in effect.parameters]


def about(effect_id: str) -> dict[str, str]:
    """Return what the page says of an effect of the catalogue."""
    effect = CATALOGUE[effect_id]
    return {
        'id': effect.id,
        'title': effect.title,
        'equation': effect.equation,
        'source': effect.source,
        'confusable': ', '.join(CATALOGUE[e].title for e in effect.confusable if e in CATALOGUE),
        'motion': effect.separated_by.format(drive='the drive'),
    }


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


def _gap_note(gap: Mapping[str, Any]) -> str:
    text = f'{judged_on(gap["held_out"])} Black: 95 % intervals. '
    if len(gap['steps']) > 1:
        text += (
            '"Closes" is the share of the squared residual above the noise floor that goes, '
            'everywhere on this page. '
        )
    method = gap['noise_floor_method']
    return text + f'Noise floor: {FLOORS.get(method, method)}.'


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
    lost = ', '.join(f'{role} {numbers.percent(x)}' for role, x in quality.missing.items())
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
