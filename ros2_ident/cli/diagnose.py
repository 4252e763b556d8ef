# SPDX-License-Identifier: Apache-2.0
"""`ident diagnose`: where the gap to the log lies, what causes it, how far it closes."""

import argparse
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import asked
from ros2_ident.cli.runs import carry_out
from ros2_ident.errors import ErrorCode

if TYPE_CHECKING:
    from ros2_ident.gap.result import Diagnosis


def run(args: argparse.Namespace) -> int:
    """Diagnose, write the result, print it."""
    from ros2_ident.effects import add_effect_files

    # Before the simulations are composed of the effects there are.
    add_effect_files(args.effect)
    from ros2_ident import jobs
    from ros2_ident.gap.verdict import REFUSED
    from ros2_ident.identify.settings import IdentifySettings
    from ros2_ident.search import Budget

    if args.resume and not args.out:
        raise ErrorCode.INVALID_GOAL.error(
            '--resume goes on by a file in the directory for the results; give --out, too'
        )
    budget = Budget(seconds=args.seconds or None)
    request = jobs.Request(
        **asked(args),
        outputs={args.output: None} if args.output else None,
        without=args.without,
        settings=IdentifySettings(budget=budget, threads=args.threads),
    )
    request = jobs.knowing(request, args.earlier)
    done = carry_out(args, request, jobs.diagnose, print_diagnosis)
    return 0 if done.complete and done.result.effect not in REFUSED else 1


def print_diagnosis(d: 'Diagnosis') -> None:
    """Print a diagnosis on standard output, the answer first."""
    from ros2_ident.cli.table import alarming, free_run
    from ros2_ident.gap.verdict import REFUSED
    from ros2_ident.words.figures import compared, figure, interval
    from ros2_ident.words.finding import where
    from ros2_ident.words.verdict import advice, sentence

    said = f'verdict: {sentence(d)} (probability {d.probability:.2f})'
    print(alarming(said) if d.effect in REFUSED else said)
    for ranked in d.confusable[1:]:
        print(
            f'  not to be told from: {ranked.at.effect} on {ranked.at.where} '
            f'({ranked.probability:.2f})'
        )
    for k, gate in enumerate(d.gates):
        if gate.level != 'ok' and k != d.facts.leads:
            print(f'{gate.level}: {gate.sentence}')
    for finding in d.localisation[:5]:
        print(f'where: {where(finding)}')
    print(f'gap on held-out data ({d.held_out}), RMS in {d.unit}:')
    for step in d.steps:
        print(f'  {step.gap.value:9.4g}  [{step.gap.low:.4g}, {step.gap.high:.4g}]  {step.label}')
    print(f'  {float((d.floor.per_drive**2).mean() ** 0.5):9.4g}  noise floor ({d.floor.method})')
    if len(d.per_drive) > 1:
        shares = {'all': d.evidence['share_of_output']}
        shares |= {name: g.share_of_output for name, g in d.per_drive.items()}
        told = ', '.join(f'{name} {figure(100.0 * x)} %' for name, x in shares.items())
        print(f'gap above the noise, share of the {compared(d.unit)}: {told}')
    if len(d.steps) > 1:
        s = d.share_closed
        print(f'share of the explainable gap closed: {s.value:.3f} [{s.low:.3f}, {s.high:.3f}]')
    print(free_run(d.prediction), end='')
    for name, v in d.parameters.items():
        moves = abs(d.moved.get(name, 0.0)) >= 0.01
        before = f'  {d.nominal[name]:.5g} before' if moves else ''
        bound = v.at_bound or v.end == 'upper' or (v.end and v.lower_bound)
        end = '  at its bound' if bound else ''
        told = interval(v.value, v.low, v.high)
        print(f'  {name:45s} {v.value:12.5g} {told} {v.unit}{before}{end}')
    for text in advice(d):
        print(f'advice: {text}')
    print(f'{d.seconds:.0f} s, seed {d.seed}')
