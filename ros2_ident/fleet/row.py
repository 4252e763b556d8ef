# SPDX-License-Identifier: Apache-2.0
"""What is found in one bag of a fleet, and the key of everything that it depends on."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
import hashlib
import importlib
import json
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.fleet.entries import Entry, Wish

if TYPE_CHECKING:
    from ros2_ident.gap.diagnosis import Diagnosis
    from ros2_ident.identify.result import Identification

Row = dict[str, Any]
# Ids, each with its place.
Effects = Sequence[Sequence[str]]


def key_of(entry: Entry, wish: Wish) -> str:
    """Return a digest of what a row depends on.

    That is what the list says, the settings, the sources of everything that has a part in a
    result, the versions of the libraries, and the bytes of the machine file (or of the module that
    makes the model) and of the bags.
    """
    from ros2_ident.identify.problem import sources
    from ros2_ident.recording.storage import digest, storage_files

    total = hashlib.sha256(f'{json.dumps(asdict(entry), default=dict)}{wish!r}'.encode())
    total.update(sources().encode())
    described = _maker_file(entry.model) if entry.model else entry.machine_file
    total.update(Path(described).read_bytes())
    for bag in filter(None, (entry.bag, *entry.more, entry.check)):
        total.update(digest(storage_files(bag)[0]).encode())
    return total.hexdigest()


def run_entry(entry: Entry, wish: Wish, asked: str = '', known: Row | None = None) -> Row:
    """Identify and diagnose one bag; an error is part of the row.

    Args:
        entry: What to run.
        wish: How.
        asked: What `identify.problem.sources` has to return here; empty for anything.
        known: A row whose parameters alone are fitted anew, beside those of its `common` effects.
    """
    row: Row = {**(known or {}), **asdict(entry), 'labels': dict(entry.labels), 'key': ''}
    try:
        if asked:
            from ros2_ident.identify.problem import require_sources

            require_sources(asked)
        row['key'] = key_of(entry, wish)
        row.update(
            _found(entry, wish)
            if known is None
            else _values(*_job(entry, wish)[0](known['common']))
        )
    except IdentError as error:
        row.update(state='failed', code=error.code.name, message=error.message)
    except OSError as error:
        row.update(
            state='failed',
            code=ErrorCode.NO_DATA.name,
            message=f'{error.filename or entry.bag}: cannot be read ({error.strerror}); correct '
            'the path in the list',
        )
    except Exception as error:
        # A defect in one bag's run shall not cost the others theirs.
        row.update(
            state='failed',
            code=ErrorCode.INTERNAL.name,
            message=f'{type(error).__name__}: {error}; run this bag alone and report what it says',
        )
    return row


def _found(entry: Entry, wish: Wish) -> Row:
    fit, diagnosis = _job(entry, wish)
    result, _ = fit(())
    found: Row = {
        'state': 'done',
        'code': result.outcome.error_code.name,
        'message': result.message,
        'warnings': list(result.quality.warnings),
        'model': result.model,
        'residual': {x.drive: x.rms for x in result.residuals},
        'unit': result.cost.unit,
        **_values(result),
    }
    if not wish.diagnosed:
        return found
    verdict = diagnosis()
    return {
        **found,
        'effect': verdict.effect,
        'where': list(verdict.where),
        'also': [{'effect': x.effect, 'where': x.where} for x in verdict.also],
        'probability': verdict.probability,
        'verdict': verdict.sentence,
        'gap': {
            name: {
                'before': g.before,
                'after': g.after,
                'share_before': g.before / g.torque_rms,
                'share_after': g.after / g.torque_rms,
            }
            for name, g in verdict.per_drive.items()
            if g.torque_rms > 0.0
        },
        'complete': verdict.complete,
    }


def _values(result: 'Identification', beside: Effects = ()) -> Row:
    values = {
        p.name: {'value': p.value, 'low': p.low, 'high': p.high, 'unit': p.unit}
        for p in result.parameters
    }
    return {'parameters': values, 'beside': list(beside)}


def _job(
    entry: Entry, wish: Wish
) -> 'tuple[Callable[[Effects], tuple[Identification, Effects]], Callable[[], Diagnosis]]':
    """Return what identifies a bag with those effects it can have, and what diagnoses it."""
    from ros2_ident import jobs
    from ros2_ident.gap.case import recordings_from
    from ros2_ident.gap.diagnose import diagnose
    from ros2_ident.identify.run import identify
    from ros2_ident.models import EffectAt, load_machine

    def able(asked: Effects, model: Any) -> 'tuple[list[EffectAt], Effects]':
        known = {(at.effect, at.where) for at in model.extensions()} if asked else set()
        beside = [at for at in asked if tuple(at) in known]
        return [EffectAt(*at) for at in beside], beside

    if entry.model:
        make = _maker(entry.model)
        models = recordings_from(make(entry.bag)).models
        check = make(entry.check) if entry.check else ()

        def fit(asked: Effects) -> 'tuple[Identification, Effects]':
            effects, beside = able(asked, models[0])
            extended = [m.extended(effects) for m in models] if effects else models
            return identify(model=extended, fixed=wish.fixed, seed=wish.seed), beside

        return fit, lambda: diagnose(
            model=models, check_model=check, fixed=wish.fixed, seed=wish.seed
        )
    request = jobs.Request(
        load_machine(entry.machine_file),
        bags=(entry.bag, *entry.more),
        check=(entry.check,) if entry.check else (),
        topics=wish.topics,
        conditions=wish.conditions,
        fixed=wish.fixed,
        settings=wish.settings,
        seed=wish.seed,
        machine_file=entry.machine_file,
    )
    logs = jobs.read(request)

    def fit_bag(asked: Effects) -> 'tuple[Identification, Effects]':
        effects, beside = able(asked, request.problem(logs.fit).models[0])
        return jobs.identify(replace(request, effects=tuple(effects)), logs).result, beside

    return fit_bag, lambda: jobs.diagnose(request, logs).result


def _maker(model: str) -> Any:
    """Return the function that `module:function` names.

    Raises:
        IdentError: INVALID_GOAL where there is none.
    """
    module, _, name = model.partition(':')
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'the model {model!r} is not found ({error}); write module:function, and put the '
            'module where Python looks for it, as by PYTHONPATH',
        ) from None


def _maker_file(model: str) -> str:
    """Return the source file of the module that makes a model."""
    return str(sys.modules[_maker(model).__module__].__file__)
