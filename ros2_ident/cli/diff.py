# SPDX-License-Identifier: Apache-2.0
"""`ident diff`: what changed between two sets of logs of one machine."""

import argparse


def run(args: argparse.Namespace) -> int:
    """Compare both sides, print the answer, write the result."""
    from ros2_ident.effects import add_effect_files

    # Before the simulations are composed of the effects there are.
    add_effect_files(args.effect)
    from ros2_ident import jobs
    from ros2_ident.cli.arguments import asked
    from ros2_ident.cli.progress import Meter
    from ros2_ident.cli.runs import interrupts, page_line
    from ros2_ident.files import make_directory
    from ros2_ident.identify.settings import IdentifySettings
    from ros2_ident.words.change import sentences

    settings = IdentifySettings(threads=args.threads)
    request = jobs.Request(**asked(args), without=args.without, settings=settings)
    request = jobs.knowing(request, args.earlier)
    with interrupts(args.out) as cancel, Meter(quiet=args.quiet) as meter:
        done = jobs.compare(request, args.after, paired=args.pairs, cancel=cancel, on_step=meter)
    for text in sentences(done.result):
        print(text)
    if args.out:
        out = make_directory(args.out)
        print('written: ' + ', '.join(map(str, jobs.save(done, out))))
        print(page_line(out, wanted=not args.no_report), end='')
    return 0 if done.complete else 1
